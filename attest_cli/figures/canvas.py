"""A page made into pixels: Agg for lines and fills, Pillow for text, 256 colours with the style colours exact."""

from __future__ import annotations

import io
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import style
from .page import Marks, Shape, Text

if TYPE_CHECKING:
    from .page import Align, Kind, Page

Pixels = NDArray[np.uint8]
COMPRESSION = 3  # half of the time of level 6 for 15 % more bytes
_ANCHOR = {"left": "ls", "middle": "ms", "right": "rs"}


def rasterise(page: Page) -> bytes:
    """The PNG of a page: shapes in their order, texts on top, then the palette."""
    import matplotlib as mpl
    from PIL import Image

    size = (round(page.width * style.DPI), round(page.height * style.DPI))
    with mpl.rc_context({"path.simplify": False, "agg.path.chunksize": 0}):
        image = Image.fromarray(_shapes(page, size))
    for text in page.texts:
        _write(image, page, text)
    exact = sorted({style.rgb(page.colour(c)) for c in [*page.colours.values(), *_used(page)]})
    index, palette = to_palette(np.asarray(image), style.rgb(page.colour("paper")), exact)
    out = Image.fromarray(index)
    out.putpalette(palette.tobytes())
    file = io.BytesIO()
    out.save(file, "PNG", dpi=(style.DPI, style.DPI), compress_level=COMPRESSION)
    return file.getvalue()


def _used(page: Page) -> set[str]:
    names = {i.colour for i in page.items if isinstance(i, Shape)}
    return {name for name in names if name.startswith("#")}


def _shapes(page: Page, size: tuple[int, int]) -> Pixels:
    """All shapes on paper, (height, width, 4), opaque."""
    from matplotlib.transforms import Affine2D, Bbox

    width, height = size
    renderer = _renderer(width, height)
    to_pixels = Affine2D().scale(style.DPI, -style.DPI).translate(0.0, height)
    page_box = Shape((_outline(page.width, page.height),), "paper", fill=True)
    for item in [page_box, *page.items]:
        gc = renderer.new_gc()
        if isinstance(item, Marks):
            _marks(renderer, gc, to_pixels, page, item)
            continue
        gc.set_joinstyle("round")
        gc.set_capstyle("butt")
        gc.set_linewidth(item.width)
        gc.set_foreground(page.colour(item.colour))
        if item.dash:
            gc.set_dashes(0, list(item.dash))
        if item.clip is not None:
            left, top, across, down = (v * style.DPI for v in item.clip)
            gc.set_clip_rectangle(Bbox.from_extents(left, height - top - down, left + across, height - top))
        face = tuple(v / 255.0 for v in style.rgb(page.colour(item.colour))) if item.fill else None
        renderer.draw_path(gc, _path(item), to_pixels, face)
    return np.asarray(renderer.buffer_rgba())


def _renderer(width: int, height: int) -> Any:
    from matplotlib.backends.backend_agg import RendererAgg

    make: Any = RendererAgg  # its constructor has no types
    return make(width, height, style.DPI)


def _path(shape: Shape) -> Any:
    from matplotlib.path import Path

    points, codes = [], []
    for run in shape.runs:
        code = np.full(run.shape[0], Path.LINETO, dtype=Path.code_type)
        code[0] = Path.MOVETO
        points.append(run)
        codes.append(code)
        if shape.fill:
            points.append(run[:1])
            codes.append(np.array([Path.CLOSEPOLY], dtype=Path.code_type))
    return Path(np.concatenate(points), np.concatenate(codes))


def _outline(width: float, height: float) -> NDArray[np.float64]:
    return np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])


@lru_cache(maxsize=8)
def _marker(kind: Kind) -> Any:
    """Marker outline within one unit, y down."""
    from matplotlib.path import Path

    if kind == "circle":
        return Path.unit_circle().transformed(_scaled(0.5))
    if kind in ("cross", "heavy-cross"):
        ends = [(-0.5, -0.5), (0.5, 0.5), (-0.5, 0.5), (0.5, -0.5)]
        return Path(ends, [Path.MOVETO, Path.LINETO, Path.MOVETO, Path.LINETO])
    corners = {
        "square": [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)],
        "up": [(-0.5, -0.45), (0.5, -0.45), (0.0, 0.45)],
        "down": [(-0.5, 0.45), (0.5, 0.45), (0.0, -0.45)],
    }[kind]
    return Path([*corners, corners[0]], closed=True)


def _scaled(factor: float) -> Any:
    from matplotlib.transforms import Affine2D

    return Affine2D().scale(factor)


def _marks(renderer: Any, gc: Any, to_pixels: Any, page: Page, marks: Marks) -> None:
    from matplotlib.path import Path

    stroke = marks.width or (0.32 * marks.size if marks.kind == "heavy-cross" else 0.0)
    gc.set_linewidth(stroke)
    gc.set_foreground(page.colour(marks.edge or marks.fill))
    gc.set_snap(False)
    face = tuple(v / 255.0 for v in style.rgb(page.colour(marks.fill))) if marks.fill else None
    scale = _scaled(marks.size * style.DPI / 72.0)
    renderer.draw_markers(gc, _marker(marks.kind), scale, Path(marks.centres), to_pixels, face)


def _write(image: Any, page: Page, text: Text) -> None:
    """Paste a text at its place to a third of a pixel, over its halo."""
    many, words = style.TEXT_SCALE, style.drawable(text.text)
    column, row = (divmod(round(v * style.DPI * many), many) for v in (text.x, text.y))
    halo = [(2 * many, "paper")] if text.halo else []
    for width, colour in (*halo, (0, text.colour)):
        mask, left, top = _lettered(words, text.size, text.bold, text.align, (column[1], row[1]), width)
        image.paste(page.colour(colour), (column[0] + left, row[0] + top), mask)


@lru_cache(maxsize=2048)
def _lettered(
    words: str, size: float, bold: bool, align: Align, phase: tuple[int, int], stroke: int
) -> tuple[Any, int, int]:
    """Mask of a text that begins ``phase`` enlarged pixels into its pixel, and where its corner lies from there.

    Drawn enlarged and reduced: at its place to a third of a pixel, with even spacing. Pages share most of their words.
    """
    from PIL import Image, ImageDraw

    many, font, anchor = style.TEXT_SCALE, style.font(size, bold), _ANCHOR[align]
    left, top, right, bottom = (round(v) for v in font.getbbox(words, anchor=anchor, stroke_width=stroke))
    corner = [(v + w) // many - 1 for v, w in zip(phase, (left, top), strict=True)]
    extent = [many * ((v + w) // many + 2 - c) for v, w, c in zip(phase, (right, bottom), corner, strict=True)]
    mask = Image.new("L", (extent[0], extent[1]))
    inner = (phase[0] - many * corner[0], phase[1] - many * corner[1])
    ImageDraw.Draw(mask).text(inner, words, font=font, fill=255, anchor=anchor, stroke_width=stroke)
    return mask.reduce(many), corner[0], corner[1]


def to_palette(rgba: Pixels, paper: tuple[int, int, int], exact: list[tuple[int, int, int]]) -> tuple[Pixels, Pixels]:
    """Opaque pixels (h, w, 4) as an index image (h, w) and a palette (256, 3): ``exact`` colours stay as they are, the
    rest go to the most used bins of 4 bits per channel at the mean of each bin, or to the nearest entry.
    """
    packed = np.ascontiguousarray(rgba).view("<u4")[..., 0]  # alpha, blue, green, red from the highest byte
    keys = np.array(sorted(_packed(colour) for colour in exact), dtype=np.uint32)
    palette = np.zeros((256, 3), dtype=np.uint8)
    palette[: keys.size] = np.column_stack((keys & 255, (keys >> 8) & 255, (keys >> 16) & 255))
    paper_key = np.uint32(_packed(paper))
    index = np.full(packed.shape, np.searchsorted(keys, paper_key), dtype=np.uint8)
    other = np.flatnonzero(packed != paper_key)
    values = packed.ravel()[other]
    place = np.minimum(np.searchsorted(keys, values), keys.size - 1)
    blended = keys[place] != values
    rest = values[blended]
    if rest.size:
        place[blended] = _binned(rest, palette, keys.size)
    index.ravel()[other] = place.astype(np.uint8)
    return index, palette


def _packed(colour: tuple[int, int, int]) -> int:
    red, green, blue = colour
    return (255 << 24) | (blue << 16) | (green << 8) | red


def _binned(values: NDArray[np.uint32], palette: Pixels, taken: int) -> NDArray[np.int64]:
    """Palette index of each blended colour; fills the free entries of the palette."""
    red, green, blue = values & 255, (values >> 8) & 255, (values >> 16) & 255
    bins = ((red >> 4) << 8) | ((green >> 4) << 4) | (blue >> 4)
    counts = np.bincount(bins, minlength=4096)
    occupied = np.argsort(-counts, kind="stable")[: np.count_nonzero(counts)]
    sums = [np.bincount(bins, weights=channel, minlength=4096)[occupied] for channel in (red, green, blue)]
    means = np.column_stack(sums) / counts[occupied, None]
    own = occupied[: 256 - taken]
    palette[taken : taken + own.size] = np.rint(means[: own.size])
    entries = palette[: taken + own.size].astype(np.float64)
    lut = np.zeros(4096, dtype=np.int64)
    lut[own] = np.arange(taken, taken + own.size)
    late = means[own.size :]
    if late.size:
        far = (late**2).sum(1)[:, None] - 2.0 * late @ entries.T + (entries**2).sum(1)
        lut[occupied[own.size :]] = np.argmin(far, axis=1)
    return np.asarray(lut[bins])
