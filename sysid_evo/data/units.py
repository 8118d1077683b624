"""The units a log may be written in, and what turns them into SI units."""

from __future__ import annotations

import math

SI_UNITS: dict[str, tuple[str, float]] = {
    "m": ("m", 1.0),
    "cm": ("m", 1e-2),
    "mm": ("m", 1e-3),
    "rad": ("rad", 1.0),
    "deg": ("rad", math.pi / 180.0),
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
    "ns": ("s", 1e-9),
    "m/s": ("m/s", 1.0),
    "cm/s": ("m/s", 1e-2),
    "mm/s": ("m/s", 1e-3),
    "km/h": ("m/s", 1.0 / 3.6),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", math.pi / 180.0),
    "rpm": ("rad/s", math.pi / 30.0),
    "m/s^2": ("m/s^2", 1.0),
    "g": ("m/s^2", 9.80665),
}


def to_si(unit: str) -> tuple[str, float]:
    """Return the SI unit of ``unit`` and the factor to it; an unknown unit is kept, with factor 1."""
    return SI_UNITS.get(unit, (unit, 1.0))


def units_of(si_unit: str) -> tuple[str, ...]:
    """Return every known unit that becomes ``si_unit``."""
    return tuple(unit for unit, (target, _) in SI_UNITS.items() if target == si_unit)
