"""Page 8, calibrate-bias: the gyro at rest, what was fitted to it, and what the fit leaves. One column per axis."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..calibration.records import Allan, Axis, Calibration, Rest
from ..records import Array, Bools, Result
from . import style, ticks
from .drive import AXES, Drive, real
from .frame import new_page, padded, row_name
from .page import DASHED, Page, Panel
from .words import THIN, duration, number, short_duration, two_digits

NAME = "08-calibrate-bias.png"
HEIGHT = 7.15
COLUMNS, WIDTH = (1.2, 3.53, 5.86), 1.88
BIAS, REST, ALLAN, LAGS = (1.13, 0.85), (2.09, 0.55), (3.32, 1.75), (5.72, 0.72)  # top and height of the rows
ENVELOPE_S, MEAN_S = 1.0, 10.0  # the light and the dark line are means over these
MOST_MEANS = 60  # of a drive
MOSTLY = 0.9  # share of its duration that a log rests which is said to be at rest
DEG, DEG_H, DEG_ROOT_H, DEG_H_ROOT_H = (math.degrees(1.0) * k for k in (1.0, 3600.0, 60.0, 3600.0 * 60.0))
FLOOR = math.sqrt(2.0 * math.log(2.0) / math.pi)  # Allan deviation of flicker noise over its B
SETTLED = 3.0  # time constants after which 5 % of a warm-up is left


def draw(calibration: Calibration, result: Result, theme: str = "light") -> Page:
    """The page; ``result`` holds what a header says of a log (file, duration, version), without any pass."""
    drive = Drive(result)
    page = new_page(
        drive, theme, HEIGHT, titles(calibration), _notes(calibration, drive),
        f"Gyro bias with its fit, residual, Allan deviation with fitted noise, and autocorrelation of the residual for "
        f"three axes over {duration(calibration.at_rest)} at rest.", status(calibration),
    )  # fmt: skip
    span, length = _span(calibration), mean_length(calibration)
    allan_limits = _allan_limits(calibration)
    lags = _lag_limits(calibration)
    for k, axis in enumerate(calibration.axes):
        _bias(page, axis, k, span, length)
        _residual(page, axis, k, span, length)
        _allan(page, axis, k, *allan_limits)
        _autocorrelation(page, axis, k, lags)
    means_of = f"{MEAN_S:g} s means" if calibration.static else "stop means"
    row_name(page, page.panels[0], "bias", "°/s", "grey: 1 s,", means_of)
    return page


def mean_length(calibration: Calibration) -> float:
    """Length of the means that are told from the noise: 10 s at rest; of a drive a stop, or parts of a long one."""
    return MEAN_S if calibration.static else max(MEAN_S, calibration.duration / MOST_MEANS)


def status(calibration: Calibration) -> str:
    """WARN where the residual of an axis is not white: the model does not explain all that is seen."""
    return "PASS" if all(axis.whiteness.white for axis in calibration.axes) else "WARN"


def titles(calibration: Calibration) -> list[str]:
    """Noise and bias instability of the worst axis, and whether anything is left to explain."""
    noise = [axis.noise for axis in calibration.axes]
    seen = [n.B for n in noise if n.B is not None]
    density = f"Noise {two_digits(max(n.N for n in noise) * DEG)} °/s/√Hz"
    head = f"{density}, bias instability {two_digits(max(seen) * DEG_H)} °/h" if seen else density
    unfit = [name for name, axis in zip(AXES, calibration.axes, strict=True) if not axis.whiteness.white]
    if unfit:
        return [f"{head}; the residual is not yet white", f"{density}; the residual is not yet white"]
    return [f"{head}; the residual is white", density]


def _notes(calibration: Calibration, drive: Drive) -> list[str]:
    count = real((drive.report.get("input") or {}).get("samples"))
    samples = f"{number(count)} samples at " if math.isfinite(count) else ""
    rests = calibration.static and calibration.at_rest >= MOSTLY * calibration.duration
    rest = "at rest" if rests else f"{duration(calibration.at_rest)} of it at rest"
    notes = [duration(calibration.duration), rest, f"{samples}{calibration.rate_hz:.4g} Hz", "worst axis"]
    times = [t for t in (warm_up(axis) for axis in calibration.axes) if t is not None]
    return [*notes, f"warm-up over after {short_duration(SETTLED * max(times))}"] if times else notes


def warm_up(axis: Axis) -> float | None:
    """Time constant of an exponential bias, s; None for any other model."""
    names = axis.model.names
    return float(axis.model.values[names.index("T")]) if axis.model.name == "exponential" else None


def _span(calibration: Calibration) -> tuple[float, float]:
    t = np.concatenate([axis.rest.t for axis in calibration.axes])
    low, high = min(0.0, float(t.min())), max(float(t.max()), calibration.duration)
    return low, max(high, low + 1.0)


def parted(rest: Rest) -> Bools:
    """True at i where no line runs from block i to i + 1: another stop, or a hole."""
    step = np.diff(rest.t)
    usual = float(np.median(step)) if step.size else 1.0
    return np.append((np.diff(rest.stop) != 0) | (step > 5.0 * usual), False)


@dataclass(frozen=True, slots=True)
class Means:
    """Means of rates over equal parts of stops: time, mean and sigma (m,), deg/s, and where no line runs on."""

    t: Array
    mean: Array
    sigma: Array
    parted: Bools


def means(rest: Rest, values: Array, length_s: float) -> Means:
    """Means of the blocks' ``values`` (n,) over equal parts of about ``length_s`` of each stop, a block at least."""
    step = float(np.median(np.diff(rest.t))) if rest.t.size > 1 else length_s
    each = max(1, round(length_s / step))
    first = []
    for rows in np.split(np.arange(rest.t.size), np.flatnonzero(parted(rest)[:-1]) + 1):
        first += [part[0] for part in np.array_split(rows, max(1, round(rows.size / each)))]
    at = np.array(first)
    count = np.diff(np.append(at, rest.t.size))
    t, mean = (np.add.reduceat(v, at) / count for v in (rest.t, values))
    sigma = np.sqrt(np.add.reduceat((rest.sigma * DEG) ** 2, at)) / count
    return Means(t, mean, sigma, np.append(np.diff(np.cumsum(parted(rest))[at - 1]) != 0, False))


def _bias(page: Page, axis: Axis, k: int, span: tuple[float, float], mean_s: float) -> None:
    """Means over a second and over ``mean_s``, and the fitted bias with 2 sigma."""
    rest, model = axis.rest, axis.model
    fit, two = model.fitted * DEG, 2.0 * model.sigma * DEG
    fine, coarse = (means(axis.fine, axis.fine.rate * DEG, length) for length in (ENVELOPE_S, mean_s))
    low, high = (np.quantile(fine.mean, q) for q in (0.002, 0.998))
    below, above = np.median(fit - 1.5 * two), np.median(fit + 1.5 * two)  # wider than the means of a short log
    limits = padded(float(min(low, fit.min(), below)), float(max(high, fit.max(), above)), 0.08)
    panel = page.panel((COLUMNS[k], BIAS[0], WIDTH, BIAS[1]), span, limits)
    at = ticks.linear(*limits, 4)
    panel.grid(at[0])
    panel.band(rest.t, fit - two, fit + two, np.zeros(fit.size, dtype=np.bool_), "band")
    panel.series(fine.t, fine.mean, fine.parted, "gap", 0.6)
    _draw_means(panel, coarse, "measurement", 0.8)
    panel.series(rest.t, fit, np.zeros(fit.size, dtype=np.bool_), AXES[k], 1.5)
    panel.y_axis(at)
    page.line([(panel.left, panel.bottom), (panel.right, panel.bottom)])
    page.text(panel.left, BIAS[0] - 0.09, AXES[k], size=11.0, colour=AXES[k], bold=True)
    page.text(panel.left + 0.15, BIAS[0] - 0.09, model_words(axis), size=style.TICK, colour="mute")


def _draw_means(panel: Panel, found: Means, colour: str, width: float) -> None:
    """A line; where most means stand alone, as at short stops, points with bars of 2 sigma."""
    alone = np.append(True, found.parted[:-1]) & (found.parted | (np.arange(found.t.size) == found.t.size - 1))
    panel.series(found.t, np.where(alone, np.nan, found.mean), found.parted, colour, width)
    if not alone.any():
        return
    t, mean, two = found.t[alone], found.mean[alone], 2.0 * found.sigma[alone]
    for x, low, high in zip(panel.x(t).tolist(), (mean - two).tolist(), (mean + two).tolist(), strict=True):
        ends = [float(panel.y(min(max(v, panel.y_limits[0]), panel.y_limits[1]))) for v in (low, high)]
        panel.page.line([(x, ends[0]), (x, ends[1])], colour, 0.9)
    seen = panel.inside(mean)
    panel.points(t[seen], mean[seen], "circle", 3.0 if t.size <= 40 else 2.0, fill="paper", edge=colour, width=0.8)


def model_words(axis: Axis) -> str:
    """The fitted bias in a few words: ``0.110 °/s, starts +0.020, τ 9.7 min``."""
    model, rest = axis.model, axis.rest
    fit = model.fitted * DEG
    end, change = float(fit[-1]), float(fit[0] - fit[-1])
    decimals = _decimals(float(np.median(rest.sigma)) * DEG / math.sqrt(MEAN_S))
    value = f"{number(end, decimals)} °/s"
    if model.name == "exponential":
        return f"{value}, starts {number(change, decimals, sign=True)}, τ {_time(warm_up(axis) or 0.0)}"
    if model.name == "ramp":
        hours = max(float(rest.t[-1] - rest.t[0]), 1.0) / 3600.0
        return f"{value}, {'+' if change < 0 else '−'}{two_digits(abs(change) / hours)} °/s per h"
    if model.name == "temperature" and rest.temperature is not None:
        low, high = float(rest.temperature.min()), float(rest.temperature.max())
        return f"{value} at {number(rest.temperature[-1], 1)} °C, from {number(low)} to {number(high)} °C"
    if model.name == "random-walk":
        return f"{value}, walks over {two_digits(float(np.ptp(fit)))}"
    return f"{value}, constant"


def _decimals(sigma: float) -> int:
    return min(max(0, -math.floor(math.log10(sigma))) if sigma > 0.0 else 6, 6)


def _time(seconds: float) -> str:
    return f"{seconds / 60.0:.1f} min" if seconds >= 60.0 else f"{seconds:.0f} s"


def _residual(page: Page, axis: Axis, k: int, span: tuple[float, float], mean_s: float) -> None:
    """What the fit leaves of the means, with the 2 sigma of the noise alone."""
    rest = axis.rest
    left = means(rest, (rest.rate - axis.model.fitted) * DEG, mean_s)
    two = 2.0 * left.sigma
    limit = ticks.rounded_up(max(1.4 * float(np.median(two)), 1.05 * float(np.quantile(np.abs(left.mean), 0.995))))
    panel = page.panel((COLUMNS[k], REST[0], WIDTH, REST[1]), span, (-limit, limit))
    panel.band(left.t, -two, two, left.parted, "band2")
    panel.across(0.0, "grid")
    _draw_means(panel, left, "ink", 0.7)
    panel.y_axis(_three(limit), inset=0.03)
    panel.x_axis(ticks.time(*span, 4), ticks.time_label(*span))
    if k == 0:
        page.text(0.20, panel.top + 0.5 * panel.height + 0.04, "minus fit", size=8.5, bold=True)
        page.text(0.20, panel.top + 0.5 * panel.height + 0.205, "°/s", size=style.NOTE, colour="mute")


def told(allan: Allan) -> Bools:
    """Points that say something: known to a factor of 3, or the first ones."""
    return np.asarray((allan.high <= 3.0 * allan.deviation) | (np.arange(allan.tau.size) < 3))


def _three(limit: float) -> ticks.Ticks:
    """Minus, 0 and plus at the largest 1, 2 or 5 inside the limit."""
    power = 10.0 ** math.floor(math.log10(limit))
    step = max(k * power for k in (1.0, 2.0, 5.0) if k * power <= limit * (1.0 + 1e-9))
    return ticks.symmetric(step)


def _allan_limits(calibration: Calibration) -> tuple[tuple[float, float], tuple[float, float]]:
    """Decades of averaging time and limits of the deviation, deg/h, shared by the three axes."""
    shown = [(axis.allan, told(axis.allan)) for axis in calibration.axes]
    tau = np.concatenate([allan.tau[rows] for allan, rows in shown])
    dev = np.concatenate([allan.deviation[rows] for allan, rows in shown]) * DEG_H
    dev = dev[dev > 0.0]
    across = math.log10(float(tau.min())), math.log10(float(tau.max()))
    low, high = (float(v) for v in (dev.min(), dev.max())) if dev.size else (1.0, 10.0)
    return (across[0], max(across[1], across[0] + 1.0)), (low / 3.0, high * 1.6)


def _allan(page: Page, axis: Axis, k: int, across: tuple[float, float], limits: tuple[float, float]) -> None:
    """Allan deviation with its 95 % band, and the lines of N, B and K with their values on them."""
    panel = page.panel((COLUMNS[k], ALLAN[0], WIDTH, ALLAN[1]), across, limits, log=True)
    whole = list(range(math.ceil(across[0] - 1e-9), math.floor(across[1] + 1e-9) + 1))
    at = ticks.log(*limits, 6)
    panel.grid(at[0])
    for v in whole:
        x = float(panel.x(v))
        page.line([(x, panel.top), (x, panel.bottom)], "grid")
    rows = told(axis.allan)
    tau, on = np.log10(axis.allan.tau[rows]), np.zeros(int(rows.sum()), dtype=np.bool_)
    tint = style.mix(page.colour(AXES[k]), page.colour("paper"), 0.8)
    panel.band(tau, axis.allan.low[rows] * DEG_H, axis.allan.high[rows] * DEG_H, on, tint)
    panel.series(tau, axis.allan.deviation[rows] * DEG_H, on, AXES[k], 1.5)
    _noise_lines(panel, axis)
    panel.y_axis(at if k == 0 else (at[0], [""] * len(at[0])))
    named = whole[:: -(-len(whole) // 4)] if len(whole) > 1 else whole
    panel.x_axis(([float(v) for v in whole], [_power(v) if v in named else "" for v in whole]), "averaging time, s")
    if k == 0:
        row_name(page, panel, "Allan", "deviation", "°/h, log")


def _power(exponent: int) -> str:
    return ticks.log(10.0**exponent, 10.0 ** (exponent + 1), 2)[1][0]


def _noise_lines(panel: Panel, axis: Axis) -> None:
    noise, (first, last) = axis.noise, panel.x_limits
    x = np.array([first, last])
    tau, on = 10.0**x, np.zeros(2, dtype=np.bool_)
    panel.series(x, noise.N * DEG_H / np.sqrt(tau), on, "ink", 0.7, DASHED)
    named = first + 0.36 * (last - first)
    words = f"N{THIN} {two_digits(noise.N * DEG_ROOT_H)} °/√h"
    panel.label(named, noise.N * DEG_H / 10.0 ** (0.5 * named), words, shift=(0.06, -0.06), halo=True)
    if noise.B is not None:
        floor = FLOOR * noise.B * DEG_H
        panel.series(x, np.full(2, floor), on, "ink", 0.7, DASHED)
        words = f"0.664 B, B{THIN} {two_digits(noise.B * DEG_H)} °/h"
        panel.label(first, floor, words, shift=(0.05, -0.05), halo=True)
    corner = panel.right - 0.05, panel.bottom - 0.08
    if noise.K is None:
        panel.page.text(*corner, "K not seen", colour="mute", align="right", halo=True)
        return
    panel.series(x, noise.K * DEG_H * np.sqrt(tau / 3.0), on, "ink", 0.7, DASHED)
    words = f"K{THIN} {two_digits(noise.K * DEG_H_ROOT_H)} °/h/√h"
    width = style.text_width(words, style.LABEL)
    enters = float(panel.x(2.0 * math.log10(panel.y_limits[0] / (noise.K * DEG_H)) + math.log10(3.0)))  # at the bottom
    if enters - width > panel.left + 0.05:
        corner = min(enters, corner[0]), corner[1]
    else:  # no room left of where the line comes in: right below it
        starts = last - (width + 0.1) * (last - first) / panel.width
        below = float(panel.y(noise.K * DEG_H * math.sqrt(10.0**starts / 3.0))) + 0.15
        corner = corner[0], min(max(below, panel.top + 0.15), corner[1])
    panel.page.text(*corner, words, align="right", halo=True)


def _lag_limits(calibration: Calibration) -> tuple[float, float]:
    """Limits that hold every autocorrelation and most of its band."""
    rho = np.concatenate([axis.whiteness.rho for axis in calibration.axes])
    band = np.concatenate([axis.whiteness.band for axis in calibration.axes])
    reach = float(np.median(band)) if band.size else 0.0
    low, high = float(rho.min(initial=-reach)), float(rho.max(initial=reach))
    return min(-0.16, 1.2 * low), max(0.28, 1.2 * high)


def _autocorrelation(page: Page, axis: Axis, k: int, limits: tuple[float, float]) -> None:
    """Stems over the lag with the band of white noise; a residual that is not white is marked."""
    found = axis.whiteness
    lag = found.lag_s * np.arange(1.0, found.rho.size + 1.0)
    end = float(lag[-1]) + found.lag_s if lag.size else 1.0
    panel = page.panel((COLUMNS[k], LAGS[0], WIDTH, LAGS[1]), (0.0, end), limits)
    if lag.size:
        panel.band(lag, -found.band, found.band, np.zeros(lag.size, dtype=np.bool_), "band2")
        width = min(max(0.6 * WIDTH * 72.0 / lag.size, 0.4), 1.6)
        zero = float(panel.y(0.0))
        for x, y in zip(panel.x(lag).tolist(), panel.y(found.rho).tolist(), strict=True):
            page.line([(x, zero), (x, y)], AXES[k], width)
    panel.across(0.0)
    at = ticks.linear(*panel.y_limits, 4)
    panel.y_axis(at if k == 0 else (at[0], [""] * len(at[0])))
    panel.x_axis(ticks.linear(0.0, end, 4), "lag, s")
    if k == 0:
        row_name(page, panel, "residual", "autocorrel.")
    if k == len(COLUMNS) - 1:
        page.text(panel.right, panel.top - 0.07, "grey: 95 % band if white", size=style.NOTE, colour="mute",
                  align="right")  # fmt: skip
    if not found.white:
        page.marks([(panel.right - 0.58, panel.top + 0.07)], "up", 5.0, fill="warn")
        page.text(panel.right, panel.top + 0.105, "not white", size=style.TICK, colour="warn", align="right", halo=True)
