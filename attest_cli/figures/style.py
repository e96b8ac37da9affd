"""Colours, sizes and the font of the pages: one colour, one meaning, on every page."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont

DPI = 160
TEXT_SCALE = 3  # text is drawn this many times larger and reduced: even spacing, no hinting to whole pixels
WIDTH_IN = 8.0

_LIGHT = {
    "paper": "#FFFFFF",
    "ink": "#111111",
    "text": "#111111",
    "mute": "#5C6066",
    "grid": "#E6E7E8",
    "stop": "#F1ECDD",
    "band": "#C4C7CB",
    "band1": "#B1B4B9",
    "band2": "#D0D3D6",
    "gap": "#C9CCCF",
    "forward": "#D55E00",
    "backward": "#1769C0",
    "truth": "#007F4E",
    "measurement": "#7A7F86",
    "limit": "#A4001D",
    "x": "#CC5A71",
    "y": "#8A8A1C",
    "z": "#3B2E8C",
    "pass": "#007F4E",
    "warn": "#B86E00",
    "fail": "#A4001D",
}
_DARK = {
    "paper": "#0F1318",
    "ink": "#FFFFFF",
    "text": "#ECEEF0",
    "mute": "#9AA3AD",
    "grid": "#222A32",
    "stop": "#262419",
    "band": "#4A525B",
    "band1": "#59626C",
    "band2": "#3C444C",
    "gap": "#39414A",
    "forward": "#FF8A3D",
    "backward": "#5DB4F0",
    "truth": "#34D39A",
    "measurement": "#A0A8B0",
    "limit": "#FF5A6E",
    "x": "#FF8FA3",
    "y": "#D0D050",
    "z": "#A79BFF",
    "pass": "#34D39A",
    "warn": "#F0B040",
    "fail": "#FF5A6E",
}
THEMES: Mapping[str, Mapping[str, str]] = {"light": _LIGHT, "dark": _DARK}
"""Theme -> colour name -> hex. ``band1``/``band2`` are the +-1 sigma and +-2 sigma fields where both are drawn."""

# type sizes in points on the page
TITLE, KEY, ROW, LABEL, TICK, NOTE, NUMBER, TABLE, FOOTER = 12.0, 14.0, 10.0, 8.0, 7.5, 7.0, 6.8, 7.2, 6.2

_NARROW = 1.08  # Source Sans is small on its body; DejaVu is large on its own
_WIDE = 0.85


def rgb(hex_colour: str) -> tuple[int, int, int]:
    """``#RRGGBB`` as three integers."""
    return int(hex_colour[1:3], 16), int(hex_colour[3:5], 16), int(hex_colour[5:7], 16)


def mix(a: str, b: str, share: float) -> str:
    """Colour a ``share`` of the way from a to b."""
    parts = (round(p + share * (q - p)) for p, q in zip(rgb(a), rgb(b), strict=True))
    return "#" + "".join(f"{part:02X}" for part in parts)


@lru_cache(maxsize=1)
def font_files() -> tuple[str, str, float]:
    """Regular and semibold font file, and the factor on all sizes: Source Sans, else the DejaVu Sans of matplotlib."""
    try:
        from font_source_sans_pro import font_files_ttf as found

        return str(found["SourceSansPro"]), str(found["SourceSansProSemibold"]), _NARROW
    except (ImportError, KeyError):
        import matplotlib as mpl

        folder = Path(mpl.get_data_path()) / "fonts" / "ttf"
        return str(folder / "DejaVuSans.ttf"), str(folder / "DejaVuSans-Bold.ttf"), _WIDE


@lru_cache(maxsize=64)
def font(size_pt: float, bold: bool = False) -> FreeTypeFont:
    """The font at ``size_pt`` points on a page of ``DPI``, ``TEXT_SCALE`` times enlarged.

    Laid out by Pillow itself: Raqm takes longer and is not everywhere.
    """
    from PIL import ImageFont

    regular, semibold, factor = font_files()
    file, size = semibold if bold else regular, size_pt * factor * TEXT_SCALE * DPI / 72.0
    return ImageFont.truetype(file, size, layout_engine=ImageFont.Layout.BASIC)


@lru_cache(maxsize=4096)
def text_width(text: str, size_pt: float, bold: bool = False) -> float:
    """Width of one line of text in inches."""
    return float(font(size_pt, bold).getlength(drawable(text))) / (TEXT_SCALE * DPI)


@lru_cache(maxsize=1)
def _no_glyph() -> bytes:
    return bytes(font(TICK).getmask("\U0010fffe"))


@lru_cache(maxsize=1024)
def _has_glyph(char: str) -> bool:
    return char.isspace() or bytes(font(TICK).getmask(char)) != _no_glyph()


def drawable(text: str) -> str:
    """The text with a question mark for each sign that the font cannot draw."""
    if text.isascii():
        return text
    return "".join(char if char.isascii() or _has_glyph(char) else "?" for char in text)
