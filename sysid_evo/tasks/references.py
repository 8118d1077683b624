"""Tasks for any system: hold states at a value, follow a reference, swing up an angle, balance it."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np

from sysid_evo.angles import TURN
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.registry.registry import register_task
from sysid_evo.system import System
from sysid_evo.tasks.in_space import PATHS, SpaceReference, SpaceState, check_in_space, path_scene
from sysid_evo.tasks.task import Scene, TaskState
from sysid_evo.tasks.tracking import Goal, Names, Numbers, TrackingTask, goals_of, numbers, places
from sysid_evo.types import Array


@register_task("set_point")
class SetPoint(TrackingTask):
    """Hold each of ``channels`` (default: the first state) at a random target that is constant during a trial.

    Targets are uniform from ``low`` to ``high``: by default the middle half of the channel's limits, or neutral +- 1.
    ``tolerance`` is by default a twentieth of that, ``rate_tolerance`` (per second) infinite. A trial begins at rest,
    at most ``start_spread`` away, and is over once an error exceeds ``abort_error``. Each is one number, or a list with
    one for each channel, in its unit. See `TrackingTask` for the score, the observations and ``effort``.
    """

    name: ClassVar[str] = "set_point"

    def __init__(
        self,
        *,
        channels: Names = "",
        low: Numbers = None,
        high: Numbers = None,
        tolerance: Numbers = None,
        rate_tolerance: Numbers = math.inf,
        start_spread: Numbers = 0.0,
        abort_error: Numbers = math.inf,
        effort: float = 0.0,
        horizon: int = 300,
    ) -> None:
        super().__init__(effort=effort, horizon=horizon)
        self.channels, self.low, self.high = channels, low, high
        self.tolerance = tolerance
        self.limits = {"rate_tolerance": rate_tolerance, "start_spread": start_spread, "abort_error": abort_error}

    def goals_on(self, system: System) -> tuple[Goal, ...]:
        return goals_of(self.name, system, self.channels, self.low, self.high, self.tolerance, **self.limits)

    def references(self, rng: np.random.Generator) -> Array:
        return np.array([[rng.uniform(goal.low, goal.high) for goal in self.goals]])


KINDS = ("sine", "steps", "random_walk")
PERIODS = 4.0
"""Periods of the reference in a trial, if no period is given."""


@register_task("track_reference")
class TrackReference(TrackingTask):
    """Follow a random reference between ``low`` and ``high`` in each of ``channels``, new in every trial.

    ``kind`` is "sine" (amplitude from a third to all of the range, period from ``period`` to twice that, any phase),
    "steps" (a new value at random times, ``period`` s apart on average), or "random_walk" (it crosses the range in
    about one ``period``, and is reflected at its ends). ``period`` is by default a quarter of the trial. The
    controller observes the present error only. All else is as for `SetPoint`.

    A rigid body in space follows a "helix" or a "figure_of_eight" with its position, see `SpaceReference`: ``low`` and
    ``high`` (m) are the edges of its path, -1 and 1 by default, and ``tolerance`` is 0.2 m.
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
        start_spread: Numbers = 0.0,
        effort: float = 0.0,
        horizon: int = 300,
    ) -> None:
        super().__init__(effort=effort, horizon=horizon)
        if kind not in (*KINDS, *PATHS) or (period is not None and not period > 0.0):
            raise InvalidArgument(
                f"track_reference: expected kind {', '.join((*KINDS, *PATHS))} and period > 0 s, "
                f"got {kind!r} and {period}"
            )
        self.channels, self.low, self.high = channels, low, high
        self.kind, self.period, self.tolerance, self.start_spread = kind, period, tolerance, start_spread

    def bind(self, system: System) -> Any:
        """Return this task on ``system``; `SpaceReference` for a path in space."""
        if self.kind not in PATHS:
            return super().bind(system)
        self.check_system(system)
        (low,) = numbers("track_reference: low", self.low, 1, [-1.0])
        (high,) = numbers("track_reference: high", self.high, 1, [1.0])
        (tolerance,) = numbers("track_reference: tolerance", self.tolerance, 1, [0.2])
        return SpaceReference(
            kind=self.kind, period=self.period, size=0.5 * (high - low), tolerance=tolerance, horizon=self.horizon
        ).bind(system)

    def check_system(self, system: System) -> None:
        if self.kind not in PATHS:
            super().check_system(system)
            return
        check_in_space(f"track_reference(kind={self.kind})", system)
        if self.channels or self.effort or self.start_spread:
            raise InvalidArgument(
                f"track_reference: expected no channels, effort or start_spread for kind {self.kind}, "
                "which is a path of the position"
            )

    def scene(self, task_state: TaskState, trial: int) -> Scene:
        """Return the targets at every sample, or the path in space."""
        if isinstance(task_state, SpaceState):
            return path_scene(task_state, trial)
        return super().scene(task_state, trial)

    def goals_on(self, system: System) -> tuple[Goal, ...]:
        return goals_of(
            self.name, system, self.channels, self.low, self.high, self.tolerance, start_spread=self.start_spread
        )

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


class Upright(TrackingTask):
    """Base class of `SwingUp` and `Balance`: one periodic state, by default the first, and its ``target``.

    The target is by default half a period from neutral: upright, if neutral is hanging.
    """

    def __init__(
        self,
        channel: str = "",
        target: float | None = None,
        tolerance: float = 0.5,
        rate_tolerance: float = 3.0,
        start_spread: float = 0.2,
        effort: float = 0.0,
        horizon: int = 300,
    ) -> None:
        super().__init__(effort=effort, horizon=horizon)
        self.channel, self.target = channel, target
        self.tolerance, self.rate_tolerance, self.start_spread = tolerance, rate_tolerance, start_spread

    abort_error = math.inf

    def goals_on(self, system: System) -> tuple[Goal, ...]:
        name = self.channel or next((state.name for state in system.states if state.period), "")
        if not name:
            raise IncompatibleTask(
                f"{self.name} needs a periodic state such as an angle; the states of "
                f"{system.name or 'this system'} are {', '.join(system.state_names) or 'none'}. Give it a period, or "
                "name the state with channel="
            )
        (place,) = places(self.name, (name,), system)
        state = system.states[place]
        usual = state.neutral + 0.5 * (state.period or 0.0)
        target = usual if self.target is None else self.target
        return (
            Goal(
                state, place, target, target, self.tolerance, self.rate_tolerance, self.start_spread, self.abort_error
            ),
        )

    def references(self, rng: np.random.Generator) -> Array:
        return np.array([[goal.low for goal in self.goals]])


@register_task("swing_up")
class SwingUp(Upright):
    """Bring an angle from rest to the top and keep it there.

    ``channel`` is a periodic state (default: the first), ``target`` its value at the top (half a period from neutral).
    Trials begin at rest, at most ``start_spread`` rad away. See `TrackingTask` for the score with ``tolerance`` (rad)
    and ``rate_tolerance`` (rad/s: spinning through the top scores little), the observations and ``effort``.
    """

    name: ClassVar[str] = "swing_up"


@register_task("balance")
class Balance(Upright):
    """Keep an angle at the top.

    Trials begin at most ``start_spread`` rad away and are over once the error exceeds ``abort_error`` rad.
    ``channel``, ``target``, ``tolerance``, ``rate_tolerance`` and ``effort`` are as for `SwingUp`.
    """

    name: ClassVar[str] = "balance"
    starts_at_target = True

    def __init__(
        self,
        *,
        channel: str = "",
        target: float | None = None,
        tolerance: float = 0.1,
        rate_tolerance: float = math.inf,
        start_spread: float = 0.1,
        abort_error: float = 0.8,
        effort: float = 0.0,
        horizon: int = 300,
    ) -> None:
        super().__init__(channel, target, tolerance, rate_tolerance, start_spread, effort, horizon)
        self.abort_error = abort_error
