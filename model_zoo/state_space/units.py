"""Hidden units of state spaces: functions, slopes, and the mixtures that are tried."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from sysid_evo.types import Array, IntArray

UNITS = ("smooth", "kinked", "sharp", "cubic", "gate")

SHARP_WIDTH = 0.1
"""Width of the kink of a sharp unit; that of a kinked one is 1."""
BOUND = 3.0
"""A cube is constant beyond this input, so that nothing diverges."""


def values(kinds: IntArray, s: Array) -> Array:
    """Return the outputs of units of these ``kinds`` for inputs ``s`` (..., h).

    They are tanh s, (sqrt(s^2 + w^2) - w) / 2 with a width w of 1 or `SHARP_WIDTH`, s^3 / 3, or s times the output of
    the unit before it; cubes and gates clip s to `BOUND`. The kinks are the smooth ramp of Barron (2021) without s / 2,
    which belongs to the linear part.
    """
    out = np.empty_like(s)
    for h, kind in enumerate(kinds):
        own = s[..., h]
        if UNITS[kind] == "smooth":
            out[..., h] = np.tanh(own)
        elif UNITS[kind] == "cubic":
            out[..., h] = np.clip(own, -BOUND, BOUND) ** 3 / 3.0
        elif UNITS[kind] == "gate":
            out[..., h] = out[..., h - 1] * np.clip(own, -BOUND, BOUND)
        else:
            width = 1.0 if UNITS[kind] == "kinked" else SHARP_WIDTH
            out[..., h] = 0.5 * (np.sqrt(own**2 + width**2) - width)
    return out


def slopes(kinds: IntArray, s: Array) -> Array:
    """Return the derivatives (..., h, h) of `values` by all inputs."""
    found = values(kinds, s)
    out = np.zeros((*s.shape, s.shape[-1]))
    for h, kind in enumerate(kinds):
        own = s[..., h]
        if UNITS[kind] == "smooth":
            out[..., h, h] = 1.0 - found[..., h] ** 2
        elif UNITS[kind] == "cubic":
            out[..., h, h] = np.where(np.abs(own) < BOUND, own**2, 0.0)
        elif UNITS[kind] == "gate":
            out[..., h, h] = np.where(np.abs(own) < BOUND, found[..., h - 1], 0.0)
            out[..., h, h - 1] = out[..., h - 1, h - 1] * np.clip(own, -BOUND, BOUND)
        else:
            width = 1.0 if UNITS[kind] == "kinked" else SHARP_WIDTH
            out[..., h, h] = 0.5 * own / np.sqrt(own**2 + width**2)
    return out


@dataclass(frozen=True)
class Unit:
    """A unit of a kind in `UNITS`; with ``controls`` it depends on controls alone, as a dead band of the input does."""

    kind: str
    controls: bool = False


SMOOTH, KINKED, SHARP, CUBIC, GATE = (Unit(kind) for kind in UNITS)

SHARP_INPUT = Unit("sharp", controls=True)
Mixture: TypeAlias = tuple[Unit | None, ...]
MIXTURES: tuple[Mixture, ...] = (
    (SMOOTH,),
    (SHARP_INPUT, GATE, SHARP_INPUT, GATE, None, None),
    (SMOOTH, SHARP),
    (SHARP,),
    (SHARP_INPUT, SMOOTH),
    (SHARP, GATE, SHARP, GATE, None, None),
    (SMOOTH, SMOOTH, SMOOTH, None, None, None),
    (SHARP_INPUT, GATE, SHARP_INPUT, GATE, SMOOTH, SMOOTH),
    (SMOOTH, KINKED, CUBIC),
)
"""The units of a network repeat the mixture; None is no unit, since a smaller network needs fewer data."""
