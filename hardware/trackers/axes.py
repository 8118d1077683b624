"""From a tracker's axes to the plane that the robot drives in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hardware.arguments import choice, number
from sysid_evo.arrays import Array


@dataclass(frozen=True)
class Axes:
    """How a tracker sees the plane: which of its axes points ``up``, and how many m its unit of length is.

    With z up, x and y are the tracker's; with y up they are its x and -z, so that both are right-handed.
    The heading is where the x axis of the body's own frame points, plus ``heading_offset`` rad.
    """

    up: Literal["y", "z"] = "z"
    scale: float = 1.0
    heading_offset: float = 0.0

    def __post_init__(self) -> None:
        choice("tracker: up", self.up, ("y", "z"))
        number("tracker: scale", self.scale, above=0.0)
        number("tracker: heading_offset", self.heading_offset)

    def planar(self, position: Sequence[float], rotation: Sequence[float]) -> Array:
        """Return x, y in m and heading in [-pi, pi) of a body at ``position`` turned by ``rotation`` (x, y, z, w)."""
        qx, qy, qz, qw = (float(value) for value in rotation)
        forward = (
            1.0 - 2.0 * (qy * qy + qz * qz),
            2.0 * (qx * qy + qz * qw),
            2.0 * (qx * qz - qy * qw),
        )
        x, y = self._plane(position)
        heading = math.atan2(*self._plane(forward)[::-1]) + self.heading_offset
        turned = math.remainder(heading, 2.0 * math.pi)
        return np.array([self.scale * x, self.scale * y, -math.pi if turned == math.pi else turned])

    def _plane(self, vector: Sequence[float]) -> tuple[float, float]:
        return float(vector[0]), float(vector[1]) if self.up == "z" else -float(vector[2])
