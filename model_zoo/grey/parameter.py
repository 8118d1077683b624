"""What is unknown in physics: numbers between bounds, and states that nobody measures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidArgument
from sysid_evo.system import Channel

DECADE = 10.0
"""Positive bounds that many times apart are searched on a logarithmic scale."""


@dataclass(frozen=True)
class Parameter:
    """A number to be found from ``low`` to ``high``, with a first ``guess`` and a ``unit``.

    With ``spread`` the guess is knowledge, as of a measurement: a normal prior of that standard deviation.
    """

    name: str
    guess: float
    low: float
    high: float
    unit: str = ""
    spread: float | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise InvalidArgument(
                f"parameter {self.name!r}: expected finite bounds low < high, got {self.low} and {self.high}; "
                "give wide ones if you know little"
            )
        if not self.low <= self.guess <= self.high:
            raise InvalidArgument(
                f"parameter {self.name!r}: expected a guess within [{self.low:g}, {self.high:g}], got {self.guess:g}"
            )
        if self.spread is not None and not self.spread > 0.0:
            raise InvalidArgument(f"parameter {self.name!r}: expected a spread > 0, got {self.spread}")

    @property
    def logarithmic(self) -> bool:
        """Whether it is searched on a logarithmic scale."""
        return self.low > 0.0 and self.high >= DECADE * self.low


@dataclass(frozen=True)
class Hidden:
    """A state that is not measured: its ``unit``, where it is at rest (``initial``), and between what it may be."""

    name: str
    unit: str = ""
    initial: float = 0.0
    low: float = -1.0
    high: float = 1.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low <= self.initial <= self.high):
            raise InvalidArgument(
                f"hidden state {self.name!r}: expected finite low <= initial <= high, "
                f"got {self.low}, {self.initial}, {self.high}"
            )

    @property
    def channel(self) -> Channel:
        """The state as a channel of a system that has it."""
        return Channel(self.name, self.unit, low=self.low, high=self.high, neutral=self.initial)


@dataclass(frozen=True)
class Box:
    """The bounds of n parameters as the unit cube, in which they are searched: (..., n) to (..., n)."""

    parameters: tuple[Parameter, ...]

    @classmethod
    def of(cls, parameters: Sequence[Parameter]) -> Box:
        """Return the cube of these; raise `InvalidArgument` if two have the same name."""
        names = [parameter.name for parameter in parameters]
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise InvalidArgument(f"parameters: names must differ, repeated: {', '.join(repeated)}")
        return cls(tuple(parameters))

    @property
    def _ends(self) -> tuple[Array, Array, Array]:
        logarithmic = np.array([p.logarithmic for p in self.parameters], dtype=bool)
        low, high = (np.array([getattr(p, end) for p in self.parameters], dtype=float) for end in ("low", "high"))
        return (
            logarithmic,
            np.where(logarithmic, np.log(np.where(logarithmic, low, 1.0)), low),
            np.where(logarithmic, np.log(np.where(logarithmic, high, 1.0)), high),
        )

    def values(self, places: Array) -> Array:
        """Return the parameters at these places of the cube."""
        logarithmic, low, high = self._ends
        there = low + np.asarray(places) * (high - low)
        return np.where(logarithmic, np.exp(np.where(logarithmic, there, 0.0)), there)

    def places(self, values: Array) -> Array:
        """Undo `values`."""
        logarithmic, low, high = self._ends
        values = np.asarray(values, dtype=float)
        there = np.where(logarithmic, np.log(np.where(logarithmic, values, 1.0)), values)
        return np.asarray(np.clip((there - low) / (high - low), 0.0, 1.0))

    def slopes(self, places: Array) -> Array:
        """Return by how much each parameter grows along its side of the cube, (..., n)."""
        logarithmic, low, high = self._ends
        return (high - low) * np.where(logarithmic, self.values(places), 1.0)
