"""Units of logs and their conversion to SI units.

A unit is a product of known symbols: ``m/s^2``, ``N m``, ``deg/s``, ``1/s``. Unknown symbols are
refused, so that typing errors are found. A unit of your own is written in brackets, ``[ticks]``,
and is not converted. Empty means without unit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

from sysid_evo.errors import InvalidArgument, closest

SYMBOLS: dict[str, tuple[dict[str, int], float]] = {
    "m": ({"m": 1}, 1.0),
    "km": ({"m": 1}, 1e3),
    "cm": ({"m": 1}, 1e-2),
    "mm": ({"m": 1}, 1e-3),
    "um": ({"m": 1}, 1e-6),
    "rad": ({"rad": 1}, 1.0),
    "mrad": ({"rad": 1}, 1e-3),
    "deg": ({"rad": 1}, math.pi / 180.0),
    "rev": ({"rad": 1}, 2.0 * math.pi),
    "s": ({"s": 1}, 1.0),
    "ms": ({"s": 1}, 1e-3),
    "us": ({"s": 1}, 1e-6),
    "ns": ({"s": 1}, 1e-9),
    "min": ({"s": 1}, 60.0),
    "h": ({"s": 1}, 3600.0),
    "Hz": ({"Hz": 1}, 1.0),
    "kHz": ({"Hz": 1}, 1e3),
    "rpm": ({"rad": 1, "s": -1}, math.pi / 30.0),
    "g": ({"m": 1, "s": -2}, 9.80665),
    "kg": ({"kg": 1}, 1.0),
    "N": ({"N": 1}, 1.0),
    "mN": ({"N": 1}, 1e-3),
    "kN": ({"N": 1}, 1e3),
    "Nm": ({"N": 1, "m": 1}, 1.0),
    "J": ({"J": 1}, 1.0),
    "W": ({"W": 1}, 1.0),
    "kW": ({"W": 1}, 1e3),
    "Pa": ({"Pa": 1}, 1.0),
    "kPa": ({"Pa": 1}, 1e3),
    "bar": ({"Pa": 1}, 1e5),
    "mbar": ({"Pa": 1}, 1e2),
    "l": ({"m": 3}, 1e-3),
    "V": ({"V": 1}, 1.0),
    "mV": ({"V": 1}, 1e-3),
    "A": ({"A": 1}, 1.0),
    "mA": ({"A": 1}, 1e-3),
    "T": ({"T": 1}, 1.0),
    "uT": ({"T": 1}, 1e-6),
    "K": ({"K": 1}, 1.0),
    "degC": ({"degC": 1}, 1.0),
    "%": ({"%": 1}, 1.0),
}
"""Every known symbol: its SI units with their powers, and the factor to them; ``g`` is the acceleration.

Degrees Celsius and per cent are not converted.
"""

_FACTOR = re.compile(r"([A-Za-z%]+)(?:\^?(-?\d+))?")


def to_si(unit: str) -> tuple[str, float]:
    """Return the SI unit of ``unit`` and the factor to it.

    Raises `InvalidArgument`, with a suggestion, if a symbol in ``unit`` is not known.
    """
    unit = unit.strip()
    if unit.startswith("[") and unit.endswith("]"):
        return unit[1:-1].strip(), 1.0
    powers: dict[str, int] = {}
    scale = 1.0
    for i, part in enumerate(unit.split("/")):
        for text in re.split(r"[\s*·]+", part.strip()) if part.strip() not in ("", "1") else ():
            symbol, power = _symbol(text, unit)
            power = power if i == 0 else -power
            units, factor = SYMBOLS[symbol]
            scale *= factor**power
            for name, exponent in units.items():
                powers[name] = powers.get(name, 0) + exponent * power
    return written(powers), scale


def units_of(si_unit: str) -> tuple[str, ...]:
    """Return common units that convert to ``si_unit``."""
    usual = ("m/s", "cm/s", "mm/s", "km/h", "rad/s", "deg/s", "m/s^2", *SYMBOLS)
    return tuple(dict.fromkeys(unit for unit in usual if to_si(unit)[0] == si_unit))


def _symbol(text: str, unit: str) -> tuple[str, int]:
    """Return symbol and power of one factor of ``unit``, such as ``s^2``."""
    match = _FACTOR.fullmatch(text)
    if match is not None and match[1] in SYMBOLS:
        return match[1], int(match[2] or 1)
    named = text if match is None else match[1]
    close = closest(named, SYMBOLS, cutoff=0.5)
    hint = f" Did you mean {unit.replace(named, close)!r}?" if close else ""
    raise InvalidArgument(
        f"expected a unit made of known symbols, got {unit!r}: {named!r} is not one.{hint} "
        f'Known: {", ".join(SYMBOLS)}. Write a unit of your own in brackets: "[{unit.strip("[]")}]"'
    )


def written(powers: dict[str, int]) -> str:
    """Return ``{"m": 1, "s": -2}`` as ``m/s^2``."""

    def power(name: str, exponent: int) -> str:
        return name if exponent == 1 else f"{name}^{exponent}"

    above = " ".join(power(name, exponent) for name, exponent in powers.items() if exponent > 0)
    below = "".join(f"/{power(name, -exponent)}" for name, exponent in powers.items() if exponent < 0)
    return f"{above or '1'}{below}" if below else above


MOST_DECIMALS = 6
"""Numbers that need more decimals are written with an exponent."""


def spelled(value: float, among: Iterable[float] = (), *, digits: int = 3) -> str:
    """Return the value of a channel as text: 1100, 0.5, 0.00314, if possible without an exponent.

    ``digits`` is the number of significant digits of the largest value in ``among`` (default: of ``value``): if that is
    3.14, a value of 3e-6 is 0. Digits before the decimal point are never rounded.
    """
    size = max(map(abs, among), default=0.0) or abs(value)
    decimals = digits - 1 - math.floor(math.log10(size)) if 0.0 < size < math.inf else 0
    if decimals > MOST_DECIMALS:
        return f"{value:.{digits}g}"
    text = f"{value:z.{max(0, decimals)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def spelled_range(low: float, high: float) -> str:
    """Return ``-0.5 to 2``, or one number if both have the same text."""
    return " to ".join(dict.fromkeys(spelled(end, (low, high)) for end in (low, high)))


def spelled_time(seconds: float) -> str:
    """Return a duration in a common unit."""
    if seconds < 0.9995:
        return f"{1e3 * seconds:.0f} ms"
    size, unit = next(
        (size, unit)
        for size, unit in ((1.0, "s"), (60.0, "min"), (3600.0, "h"))
        if seconds < 120.0 * size or unit == "h"
    )
    return f"{seconds / size:.2g} {unit}" if seconds < 10.0 * size else f"{seconds / size:.0f} {unit}"
