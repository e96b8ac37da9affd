"""The canvas: mapping to inches, exact colours, fixed size, equal bytes."""

from __future__ import annotations

import io
import struct

import numpy as np
import pytest
from PIL import Image

from attest_cli.figures import style
from attest_cli.figures.canvas import to_palette
from attest_cli.figures.page import Marks, Page, Shape

NONE = np.zeros(0, dtype=bool)


def pixels(page: Page) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(page.png())).convert("RGB"))


def test_panel_maps_data_to_inches():
    panel = Page(2.0, "light", "t").panel((1.0, 0.5, 4.0, 1.0), (0.0, 8.0), (-1.0, 1.0))
    assert panel.x([0.0, 8.0]).tolist() == [1.0, 5.0]
    assert panel.y([-1.0, 0.0, 1.0]).tolist() == [1.5, 1.0, 0.5]
    log = Page(2.0, "light", "t").panel((1.0, 0.5, 4.0, 1.0), (0.0, 8.0), (0.1, 10.0), log=True)
    assert log.y([0.1, 1.0, 10.0]) == pytest.approx([1.5, 1.0, 0.5])


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_every_colour_of_the_style_is_exact(theme):
    page = Page(3.0, theme, "t")
    rng = np.random.default_rng(1)
    for k, name in enumerate(style.THEMES[theme]):
        page.rectangle((0.2 + 0.3 * k, 0.2, 0.25, 0.5), name)
        t = np.linspace(0.0, 1.0, 200)
        panel = page.panel((0.2, 1.0, 7.0, 1.5), (0.0, 1.0), (-3.0, 3.0))
        panel.series(t, rng.standard_normal(200), np.zeros(200, dtype=bool), name, 1.0)
        page.text(0.2 + 0.3 * k, 2.9, "abc", colour=name)
    image = pixels(page)
    for k, name in enumerate(style.THEMES[theme]):
        left = round((0.2 + 0.3 * k) * style.DPI)
        assert (image[40:105, left + 4 : left + 34] == style.rgb(style.THEMES[theme][name])).all(), name


def test_size_is_the_size_said_and_the_file_has_no_past():
    page = Page(5.3, "light", "t")
    page.text(1.0, 1.0, "σ ±2°")
    data = page.png()
    image = Image.open(io.BytesIO(data))
    assert image.size == (1280, 848)
    assert image.mode == "P"
    assert "transparency" not in image.info
    kinds, at = [], 8
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        kinds.append(kind)
        at += 12 + length
    assert set(kinds) == {b"IHDR", b"PLTE", b"pHYs", b"IDAT", b"IEND"}


def test_two_runs_give_the_same_bytes():
    def draw() -> bytes:
        page = Page(2.0, "dark", "t")
        page.panel((1.0, 0.5, 4.0, 1.0), (0.0, 8.0), (-1.0, 1.0)).points([1, 2, 3], [0, 0.5, 1], fill="forward")
        page.text(1.0, 1.0, "halo", halo=True)
        return page.png()

    assert draw() == draw()


def test_palette_keeps_exact_colours_and_comes_near_to_the_rest():
    rng = np.random.default_rng(5)
    ramp = rng.integers(0, 256, (80, 100, 4), dtype=np.uint8)
    ramp[..., 3] = 255
    ramp[:20] = (255, 255, 255, 255)
    ramp[20:25] = (17, 17, 17, 255)
    index, palette = to_palette(ramp, (255, 255, 255), [(17, 17, 17), (255, 255, 255), (213, 94, 0)])
    back = palette[index].astype(int)
    assert (back[:20] == 255).all()
    assert (back[20:25] == 17).all()
    assert np.abs(back - ramp[..., :3]).mean() < 25.0


def test_series_is_parted_at_nan_and_break_and_reduced():
    page = Page(2.0, "light", "t")
    panel = page.panel((1.0, 0.5, 1.0, 1.0), (0.0, 1.0), (-1.0, 1.0))
    t = np.linspace(0.0, 1.0, 10_000)
    y = np.sin(500.0 * t)
    y[5000] = np.nan
    breaks = np.zeros(t.size, dtype=bool)
    breaks[2000] = True
    panel.series(t, y, breaks, "forward", 1.0)
    (shape,) = page.items
    assert isinstance(shape, Shape)
    assert len(shape.runs) == 3
    assert sum(run.shape[0] for run in shape.runs) <= 2 * 160 + 6
    assert shape.clip == (1.0, 0.5, 1.0, 1.0)


def test_a_lonely_sample_is_a_dot():
    page = Page(2.0, "light", "t")
    panel = page.panel((1.0, 0.5, 1.0, 1.0), (0.0, 1.0), (-1.0, 1.0))
    panel.series(np.array([0.5]), np.array([0.0]), np.zeros(1, dtype=bool))
    (mark,) = page.items
    assert isinstance(mark, Marks)
    assert mark.centres.tolist() == [[1.5, 1.0]]


def test_text_is_drawn_where_it_is_asked_for():
    reach = []
    for words in ("HH", "HHHHHH"):
        page = Page(1.0, "light", "t")
        page.text(4.0, 0.5, words, align="right")
        rows, columns = np.nonzero(pixels(page)[..., 0] < 128)
        assert columns.max() == pytest.approx(4.0 * style.DPI, abs=3)
        assert rows.max() == pytest.approx(0.5 * style.DPI, abs=1.5)
        reach.append(int(columns.max() - columns.min()))
    four = style.text_width("HHHHHH", style.LABEL) - style.text_width("HH", style.LABEL)
    assert (reach[1] - reach[0]) / style.DPI == pytest.approx(four, abs=1.5 / style.DPI)
