"""Bring states of any system to a value, and keep them there."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.registry import register_task
from sysid_evo.system import System
from sysid_evo.tasks.following import Following
from sysid_evo.tasks.goals import Goal, Names, Numbers, goals_of


@register_task("set_point")
class SetPoint(Following):
    """Every trial draws a value for each of ``channels`` (default: the first state) and holds it to the end.

    Values are uniform from ``low`` to ``high``: by default the middle half of the channel's limits, or 1 either side
    of neutral. ``tolerance`` is by default a twentieth of that, ``still`` (per second) infinite. A trial begins at
    rest, ``spread`` off at most, and is over once an error exceeds ``end``. Each is one number, or a list with one
    for each channel, in its unit. See `Following` for the score, the observations and ``effort``.
    """

    name: ClassVar[str] = "set_point"

    def __init__(
        self,
        *,
        channels: Names = "",
        low: Numbers = None,
        high: Numbers = None,
        tolerance: Numbers = None,
        still: Numbers = math.inf,
        spread: Numbers = 0.0,
        end: Numbers = math.inf,
        effort: float = 0.0,
        horizon: int = 300,
    ) -> None:
        super().__init__(effort=effort, horizon=horizon)
        self.channels, self.low, self.high = channels, low, high
        self.tolerance, self.still, self.spread, self.end = tolerance, still, spread, end

    def goals_on(self, system: System) -> tuple[Goal, ...]:
        return goals_of(
            self.name,
            system,
            self.channels,
            self.low,
            self.high,
            self.tolerance,
            still=self.still,
            spread=self.spread,
            end=self.end,
        )

    def references(self, rng: np.random.Generator) -> Array:
        return np.array([[rng.uniform(goal.low, goal.high) for goal in self.goals]])
