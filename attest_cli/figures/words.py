"""Numbers, times and names as they stand on a page. Everything that comes from a log passes ``clean``."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime

THIN = "\u00a0"  # a fifth of an em in Source Sans: thousands, and between number and per cent
MINUS = "−"
UNKNOWN = "\ufffd"
_MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
_COUNTS = ("No", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine", "Ten", "Eleven", "Twelve")
_HIDDEN = ("Cc", "Cf", "Cs", "Co", "Cn", "Mn", "Me", "Mc")


def clean(text: object, longest: int = 60) -> str:
    """Text from a log, safe to draw: NFC, one line, no control, bidi, private, combining signs, cut to ``longest``."""
    lines = " ".join(unicodedata.normalize("NFC", str(text)[:4096]).split())
    out: list[str] = []
    for char in lines:
        hidden = unicodedata.category(char) in _HIDDEN
        if not hidden:
            out.append(char)
        elif not out or out[-1] != UNKNOWN:  # a run of hidden signs is one mark
            out.append(UNKNOWN)
    return cut("".join(out), longest)


def cut(text: str, longest: int) -> str:
    """At most ``longest`` signs, then an ellipsis."""
    return text if len(text) <= longest else text[:longest].rstrip() + "…"


def number(value: float, decimals: int = 0, *, sign: bool = False) -> str:
    """A number with true minus and thin spaces between thousands; ``sign`` puts + before positive ones."""
    if not math.isfinite(value):
        return "–"
    text = f"{abs(value):,.{decimals}f}".replace(",", THIN)
    zero = not any(char in "123456789" for char in text)
    if zero:
        return "0" if sign else text
    if value < 0:
        return MINUS + text
    return "+" + text if sign else text


def two_digits(value: float, *, up: bool = False) -> str:
    """A sigma to two significant digits; ``up`` rounds away from zero so that "below" stays true."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    step = 10.0 ** (math.floor(math.log10(abs(value)) + 1e-9) - 1)
    rounded = math.ceil(abs(value) / step - 1e-9) * step if up else round(abs(value) / step) * step
    return number(math.copysign(rounded, value), min(max(sigma_decimals(rounded), 0), 7))


def sigma_decimals(sigma: float, digits: int = 2) -> int:
    """Decimals that leave ``digits`` significant digits of a sigma; never below 0."""
    if not math.isfinite(sigma) or sigma == 0.0:
        return 0
    return max(0, digits - 1 - math.floor(math.log10(abs(sigma)) + 1e-9))


def percent(share: float) -> str:
    """A share as per cent; 100 % only when it is all, 0 % only when it is none."""
    if not math.isfinite(share):
        return "–"
    value = 100.0 * share
    for decimals in (0, 1, 2, 3):
        text = f"{value:.{decimals}f}"
        if (float(text) < 100.0 or share >= 1.0) and (float(text) > 0.0 or share <= 0.0):
            return text + THIN + "%"
    return ("> 99.999" if share > 0.5 else "< 0.001") + THIN + "%"


def duration(seconds: float) -> str:
    """``21 min 24 s``, ``24 h 0 min``, ``45 s``, ``0.4 s``."""
    if not math.isfinite(seconds):
        return "unknown duration"
    if seconds < 10.0:
        return f"{seconds:.1f} s" if seconds != round(seconds) else f"{seconds:.0f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 4 * 3600:
        minutes, rest = divmod(whole, 60)
        return f"{minutes} min {rest} s" if rest else f"{minutes} min"
    hours, minutes = divmod(round(seconds / 60.0), 60)
    return f"{hours} h {minutes} min"


def short_duration(seconds: float) -> str:
    """One unit only: ``21 min``, ``24 h``, ``45 s``."""
    if seconds < 90.0:
        return duration(round(seconds)) if seconds >= 10.0 else duration(seconds)
    return f"{round(seconds / 60.0)} min" if seconds < 4 * 3600 else f"{round(seconds / 3600.0)} h"


def clock(seconds: float, decimals: int = 0, *, hours: bool = False) -> str:
    """``3:05``, ``8:12:40``: minutes and seconds; hours where asked for or from four hours on."""
    sign = MINUS if seconds < 0 else ""
    scale = 10**decimals
    ticks = round(abs(seconds) * scale)
    whole, part = divmod(ticks, scale)
    tail = f".{part:0{decimals}d}" if decimals else ""
    minutes, secs = divmod(whole, 60)
    if hours or minutes >= 240:
        hour, minutes = divmod(minutes, 60)
        return f"{sign}{hour}:{minutes:02d}:{secs:02d}{tail}"
    return f"{sign}{minutes}:{secs:02d}{tail}"


def date(iso: object) -> str:
    """``2026-11-21T14:03:12Z`` as ``21 Nov 2026 14:03:12 UTC``; empty when there is none."""
    if not iso:
        return ""
    try:
        moment = datetime.fromisoformat(str(iso))
    except ValueError:
        return clean(iso, 30)
    moment = moment if moment.tzinfo is None else moment.astimezone(UTC)
    return f"{moment.day} {_MONTHS[moment.month - 1]} {moment.year} {moment:%H:%M:%S} UTC"


def counted(count: int, noun: str) -> str:
    """``No stop``, ``One stop``, ``Seven stops``, ``38 stops``."""
    word = _COUNTS[count] if 0 <= count < len(_COUNTS) else number(count)
    return f"{word} {noun}" + ("s" if count > 1 else "")


def listed(words: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def first_fit(candidates: Iterable[str], longest: int = 90) -> str:
    """The first candidate of at most ``longest`` signs; the last one cut when none is short enough."""
    last = ""
    for last in candidates:
        if len(last) <= longest:
            return last
    return cut(last, longest - 1)
