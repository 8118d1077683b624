"""Which units the networks of a state space have: no one kind bends as every system does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from model_zoo.hidden.shooting import Spaces
from model_zoo.hidden.units import UNITS
from sysid_evo.arrays import Array

SPREAD = 0.7
"""Deviation of the weights into the units at the start."""
STEEPER = 2.0
"""Times as much into units that see the controls alone, which are few."""


@dataclass(frozen=True)
class Unit:
    """A unit of a kind in `UNITS`; with ``controls`` it sees the controls alone, as a dead band at the input does."""

    kind: str
    controls: bool = False


SMOOTH, SHARP, KINKED, CUBIC, GATE = (Unit(kind) for kind in ("smooth", "sharp", "kinked", "cubic", "gate"))
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
"""The units of a network take turns; None is no unit, for a smaller network is told by fewer data."""


def networks(linear: Spaces, mixtures: list[Mixture], hidden: int, rng: np.random.Generator) -> Spaces:
    """Return one space for each mixture that steps as the ``linear`` one, with units that have no weight yet."""
    n, seen, count = linear.n, linear.outer.shape[2], len(mixtures)
    inner: Array = SPREAD * rng.standard_normal((count, hidden, seen))
    kinds = np.zeros((count, hidden), dtype=np.int64)
    for s, mixture in enumerate(mixtures):
        for h in range(hidden):
            unit = mixture[h % len(mixture)]
            if unit is None:
                inner[s, h] = 0.0
                continue
            kinds[s, h] = UNITS.index(unit.kind)
            if unit.controls:
                inner[s, h] *= np.where(np.arange(seen) < n, 0.0, STEEPER)
    outer = np.concatenate([linear.outer, np.zeros((1, n, hidden))], axis=2).repeat(count, axis=0)
    return Spaces(outer, inner, linear.pace, kinds, linear.flow)
