"""Lead states of any system along a reference that changes."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from sysid_evo.angles import TURN
from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import register_task
from sysid_evo.system import System
from sysid_evo.tasks.following import Following
from sysid_evo.tasks.goals import Goal, Names, Numbers, goals_of

KINDS = ("sine", "steps", "random_walk")
PERIODS = 4.0
"""Periods of the reference that fit into a trial, where no period is given."""


@register_task("track_reference")
class TrackReference(Following):
    """Follow a reference in each of ``channels``, drawn anew for every trial, between ``low`` and ``high``.

    ``kind`` is "sine" (amplitude from a third to all of the range, period from ``period`` to twice that, any phase),
    "steps" (a new value at random times, ``period`` s apart on average), or "random_walk" (it crosses the range in
    about one ``period``, and is reflected at its ends). ``period`` is by default a quarter of the trial. The
    controller is shown the error of now, not what comes. All else is as for `SetPoint`.
    """

    name: ClassVar[str] = "track_reference"
    changes = True
    starts_at_target = True

    def __init__(
        self,
        *,
        channels: Names = "",
        kind: str = "sine",
        period: float | None = None,
        low: Numbers = None,
        high: Numbers = None,
        tolerance: Numbers = None,
        spread: Numbers = 0.0,
        effort: float = 0.0,
        horizon: int = 300,
    ) -> None:
        super().__init__(effort=effort, horizon=horizon)
        if kind not in KINDS or (period is not None and not period > 0.0):
            raise InvalidArgument(
                f"track_reference: expected kind {', '.join(KINDS)} and period > 0 s, got {kind!r} and {period}"
            )
        self.channels, self.low, self.high = channels, low, high
        self.kind, self.period, self.tolerance, self.spread = kind, period, tolerance, spread

    def goals_on(self, system: System) -> tuple[Goal, ...]:
        return goals_of(self.name, system, self.channels, self.low, self.high, self.tolerance, spread=self.spread)

    def references(self, rng: np.random.Generator) -> Array:
        dt = self.system.dt
        period = self.horizon * dt / PERIODS if self.period is None else self.period
        draw = {"sine": _sine, "steps": _steps, "random_walk": _random_walk}[self.kind]
        shares = [draw(self.horizon + 1, period / dt, rng) for _ in self.goals]
        return np.stack(
            [goal.low + (goal.high - goal.low) * share for goal, share in zip(self.goals, shares, strict=True)], axis=1
        )


def _sine(samples: int, period: float, rng: np.random.Generator) -> Array:
    """Return a sine within 0 and 1, (samples,); ``period`` is in samples."""
    amplitude, turn = 0.5 * rng.uniform(1.0 / 3.0, 1.0), TURN / (period * rng.uniform(1.0, 2.0))
    return np.asarray(0.5 + amplitude * np.sin(turn * np.arange(samples) + rng.uniform(0.0, TURN)))


def _steps(samples: int, period: float, rng: np.random.Generator) -> Array:
    """Return values from 0 to 1 that jump at random times, (samples,)."""
    jumps = rng.random(samples) < 1.0 / period
    return np.asarray(rng.random(samples)[np.maximum.accumulate(np.where(jumps, np.arange(samples), 0))])


def _random_walk(samples: int, period: float, rng: np.random.Generator) -> Array:
    """Return a random walk that is reflected at 0 and 1, (samples,)."""
    walk = rng.random() + np.cumsum(rng.standard_normal(samples)) / np.sqrt(period)
    return np.asarray(1.0 - np.abs(walk % 2.0 - 1.0))
