"""Bring an angle to the top, and keep it there: cases of a set point for what comes round again."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.errors import IncompatibleTask
from sysid_evo.registry import register_task
from sysid_evo.system import System
from sysid_evo.tasks.following import Following
from sysid_evo.tasks.goals import Goal, places


class Upright(Following):
    """What `SwingUp` and `Balance` share: one periodic state, by default the first, and its ``target``.

    The target is by default half a period from neutral: upright, where neutral is hanging.
    """

    def __init__(
        self,
        *,
        channel: str,
        target: float | None,
        tolerance: float,
        still: float,
        spread: float,
        effort: float,
        horizon: int,
    ) -> None:
        super().__init__(effort=effort, horizon=horizon)
        self.channel, self.target = channel, target
        self.tolerance, self.still, self.spread = tolerance, still, spread

    end = math.inf

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
        return (Goal(state, place, target, target, self.tolerance, self.still, self.spread, self.end),)

    def references(self, rng: np.random.Generator) -> Array:
        return np.array([[goal.low for goal in self.goals]])


@register_task("swing_up")
class SwingUp(Upright):
    """Bring an angle from rest to the top and keep it there.

    ``channel`` is a periodic state (default: the first), ``target`` its value at the top (half a period from neutral).
    Trials begin at rest, ``spread`` rad off at most. See `Following` for the score with ``tolerance`` (rad) and
    ``still`` (rad/s: who spins through the top gains little), the observations and ``effort``.
    """

    name: ClassVar[str] = "swing_up"

    def __init__(
        self,
        *,
        channel: str = "",
        target: float | None = None,
        tolerance: float = 0.5,
        still: float = 3.0,
        spread: float = 0.2,
        effort: float = 0.0,
        horizon: int = 300,
    ) -> None:
        super().__init__(
            channel=channel,
            target=target,
            tolerance=tolerance,
            still=still,
            spread=spread,
            effort=effort,
            horizon=horizon,
        )


@register_task("balance")
class Balance(Upright):
    """Keep an angle at the top, from ``spread`` rad off at most; a trial is over once it is ``end`` rad off.

    ``channel``, ``target``, ``tolerance``, ``still`` and ``effort`` are as for `SwingUp`.
    """

    name: ClassVar[str] = "balance"
    starts_at_target = True

    def __init__(
        self,
        *,
        channel: str = "",
        target: float | None = None,
        tolerance: float = 0.1,
        still: float = math.inf,
        spread: float = 0.1,
        end: float = 0.8,
        effort: float = 0.0,
        horizon: int = 300,
    ) -> None:
        super().__init__(
            channel=channel,
            target=target,
            tolerance=tolerance,
            still=still,
            spread=spread,
            effort=effort,
            horizon=horizon,
        )
        self.end = end
