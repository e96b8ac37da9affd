"""Quantities as people write them: ``"0.3 deg/sqrt(hr)"`` -> the number in the unit a setting is kept in."""

from __future__ import annotations

import math
import re

_G = 9.80665  # standard gravity, m/s^2: what data sheets mean by g

_DEG = math.pi / 180.0

# name -> (factor to SI, exponents of angle, length, time, magnetic flux density, temperature)
_UNITS: dict[str, tuple[float, tuple[float, ...]]] = {
    "rad": (1.0, (1, 0, 0, 0, 0)),
    "mrad": (1e-3, (1, 0, 0, 0, 0)),
    "urad": (1e-6, (1, 0, 0, 0, 0)),
    "deg": (_DEG, (1, 0, 0, 0, 0)),
    "mdeg": (_DEG * 1e-3, (1, 0, 0, 0, 0)),
    "arcmin": (_DEG / 60, (1, 0, 0, 0, 0)),
    "arcsec": (_DEG / 3600, (1, 0, 0, 0, 0)),
    "dps": (_DEG, (1, 0, -1, 0, 0)),
    "mdps": (_DEG * 1e-3, (1, 0, -1, 0, 0)),
    "rpm": (math.pi / 30.0, (1, 0, -1, 0, 0)),
    "m": (1.0, (0, 1, 0, 0, 0)),
    "mm": (1e-3, (0, 1, 0, 0, 0)),
    "cm": (1e-2, (0, 1, 0, 0, 0)),
    "km": (1e3, (0, 1, 0, 0, 0)),
    "g": (_G, (0, 1, -2, 0, 0)),
    "mg": (_G * 1e-3, (0, 1, -2, 0, 0)),
    "ug": (_G * 1e-6, (0, 1, -2, 0, 0)),
    "s": (1.0, (0, 0, 1, 0, 0)),
    "ms": (1e-3, (0, 0, 1, 0, 0)),
    "us": (1e-6, (0, 0, 1, 0, 0)),
    "ns": (1e-9, (0, 0, 1, 0, 0)),
    "min": (60.0, (0, 0, 1, 0, 0)),
    "h": (3600.0, (0, 0, 1, 0, 0)),
    "Hz": (1.0, (0, 0, -1, 0, 0)),
    "kHz": (1e3, (0, 0, -1, 0, 0)),
    "T": (1.0, (0, 0, 0, 1, 0)),
    "mT": (1e-3, (0, 0, 0, 1, 0)),
    "uT": (1e-6, (0, 0, 0, 1, 0)),
    "nT": (1e-9, (0, 0, 0, 1, 0)),
    "Gauss": (1e-4, (0, 0, 0, 1, 0)),
    "mGauss": (1e-7, (0, 0, 0, 1, 0)),
    "degC": (1.0, (0, 0, 0, 0, 1)),
    "1": (1.0, (0, 0, 0, 0, 0)),
    "%": (1e-2, (0, 0, 0, 0, 0)),
}
_ALIASES = {
    "hr": "h", "hour": "h", "sec": "s", "second": "s", "minute": "min", "°": "deg", "degree": "deg", "degrees": "deg",
    "radians": "rad", "°C": "degC", "Gs": "Gauss", "gauss": "Gauss", "mG": "mGauss", "hz": "Hz",
}  # fmt: skip

_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*", re.DOTALL)
_POWER = r"(?:\^(-?\d(?:\.\d+)?))?"
_FACTOR = re.compile(rf"(sqrt\(|√\(?)?([A-Za-z°%]+|1){_POWER}\)?{_POWER}")  # root, name, power inside, power outside
_TIDY = str.maketrans({"µ": "u", "μ": "u", "²": "^2", "·": "*", " ": "", "−": "-"})


def unit(text: str) -> tuple[float, tuple[float, ...]]:
    """Factor to SI and exponents (angle, length, time, flux density, temperature) of a unit such as ``ug/sqrt(Hz)``.

    Raises
    ------
    ValueError
        If the unit is not understood.
    """
    tidy = re.sub(r"(?<=[A-Za-z])(?=\d)", "^", text.translate(_TIDY).replace("**", "^"))  # s2 -> s^2
    scale, dims = 1.0, [0.0] * 5
    for sign, part in re.findall(r"(^|[*/])([^*/]*)", tidy):
        match = _FACTOR.fullmatch(part)
        name = "" if match is None else _ALIASES.get(match[2], match[2])
        if match is None or name not in _UNITS or part.count("(") != part.count(")"):
            raise ValueError(f"unit {text!r} is not known")
        power = float(match[3] or 1) * float(match[4] or 1) * (0.5 if match[1] else 1.0)
        power = -power if sign == "/" else power
        factor, exponents = _UNITS[name]
        scale *= factor**power
        dims = [d + power * e for d, e in zip(dims, exponents, strict=True)]
    return scale, tuple(dims)


def convert(value: str, target: str) -> float:
    """A quantity such as ``"0.3 deg/sqrt(hr)"`` as a number in ``target``; a bare number is in ``target`` already.

    Raises
    ------
    ValueError
        If it is no number, or its unit is unknown or measures something else.
    """
    match = _QUANTITY.fullmatch(value)
    if match is None:
        raise ValueError(f"should be a number or a quantity in {target}")
    number, name = float(match[1]), match[2]
    if not name:
        return number
    scale, dims = unit(name)
    target_scale, target_dims = unit(target)
    if any(abs(a - b) > 1e-9 for a, b in zip(dims, target_dims, strict=True)):
        raise ValueError(f"unit {name!r} does not measure what {target} does")
    return number if scale == target_scale else number * scale / target_scale
