"""Raw observations and actions of an environment, for controllers that run in a loop around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid_evo.system import Channel
from sysid_evo.types import Array


@dataclass(frozen=True)
class RawValue:
    """One observation of a task from raw ones.

    Without ``places`` it is 1. With one it is (value - centre) / scale, or with an ``angle``, "sine" or "cosine", that
    of the value in rad. With two, its own and another, it is a sine or cosine: its own, divided by the length of both.
    """

    places: tuple[int, ...] = ()
    centre: float = 0.0
    scale: float = 1.0
    angle: str = ""

    def of(self, raw: Array) -> Array:
        """Return the observation (B,) for raw ones (B, n)."""
        if not self.places:
            return np.ones(len(raw))
        own = raw[:, self.places[0]]
        if len(self.places) == 2:
            return own / np.hypot(own, raw[:, self.places[1]])
        if self.angle:
            return np.sin(own) if self.angle == "sine" else np.cos(own)
        return (own - self.centre) / self.scale


@dataclass(frozen=True)
class RawInterface:
    """Raw ``observations`` and actions of an environment.

    ``values`` are the observations of its task. ``levels`` are the raw actions for each control's levels, None for a
    control without levels. An action has the type ``kind``: an "integer", or an "array" or "integers" of the ``shape``.
    """

    observations: tuple[Channel, ...]
    values: tuple[RawValue, ...]
    levels: tuple[tuple[int, ...] | None, ...]
    kind: str
    shape: tuple[int, ...]

    def observed(self, raw: Array) -> Array:
        """Return the observations of the task (B, m) for raw ones (B, n)."""
        return np.stack([value.of(raw) for value in self.values], axis=1)

    def actions(self, controls: Array, channels: Sequence[Channel]) -> Array:
        """Return the raw actions (B, nu) for ``controls`` (B, nu) in the units of ``channels``."""
        columns = []
        for column, channel, numbers in zip(controls.T, channels, self.levels, strict=True):
            if numbers is None or channel.levels is None:
                columns.append(column)
            else:
                places = np.abs(np.subtract.outer(column, np.array(channel.levels))).argmin(axis=1)
                columns.append(np.array(numbers, dtype=np.float64)[places])
        return np.stack(columns, axis=1)
