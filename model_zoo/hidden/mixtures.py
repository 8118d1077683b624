"""Which units the networks of a state space have: no one kind bends as every system does."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from model_zoo.hidden.shooting import Spaces
from model_zoo.hidden.units import UNITS
from sysid_evo.arrays import Array, IntArray

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
    count = len(mixtures)
    several = replace(
        linear,
        outer=linear.outer.repeat(count, axis=0),
        inner=linear.inner.repeat(count, axis=0),
        kinds=linear.kinds.repeat(count, axis=0),
    )
    return widened(several, mixtures, hidden, rng)


def widened(spaces: Spaces, mixtures: list[Mixture], further: int, rng: np.random.Generator) -> Spaces:
    """Return spaces that step as these do, with ``further`` units each, of so many mixtures, without weight yet."""
    count, n, seen = len(spaces), spaces.n, spaces.inner.shape[2]
    inner: Array = SPREAD * rng.standard_normal((count, further, seen))
    kinds = np.zeros((count, further), dtype=np.int64)
    for s, mixture in enumerate(mixtures):
        for h in range(further):
            unit = mixture[h % len(mixture)]
            if unit is None:
                inner[s, h] = 0.0
                continue
            kinds[s, h] = UNITS.index(unit.kind)
            if unit.controls:
                inner[s, h] *= np.where(np.arange(seen) < n, 0.0, STEEPER)
    return _appended(spaces, inner, kinds)


def padded(spaces: Spaces, further: int) -> Spaces:
    """Return the same spaces with ``further`` units that are nothing, so that they stand beside wider ones."""
    kinds = np.zeros((len(spaces), further), dtype=np.int64)
    return _appended(spaces, np.zeros((len(spaces), further, spaces.inner.shape[2])), kinds)


def _appended(spaces: Spaces, inner: Array, kinds: IntArray) -> Spaces:
    """Return the spaces with units (S, h) whose weights into the states are 0."""
    return replace(
        spaces,
        outer=np.concatenate([spaces.outer, np.zeros((len(spaces), spaces.n, kinds.shape[1]))], axis=2),
        inner=np.concatenate([spaces.inner, inner], axis=1),
        kinds=np.concatenate([spaces.kinds, kinds], axis=1),
    )
