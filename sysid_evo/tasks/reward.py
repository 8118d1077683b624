"""A task of one function: what each state and control are worth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self, TypeAlias, cast

import numpy as np

from sysid_evo.arrays import Array, BoolArray, Seeds, check_shape
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.randomness import TASK_STREAM, generator
from sysid_evo.system import Channel, System
from sysid_evo.tasks.following import formulas_of_states, observations, shown_states
from sysid_evo.tasks.task import Task, TaskState

if TYPE_CHECKING:
    from sysid_evo.kernels import TaskKernel

Worth: TypeAlias = Callable[[Array, Array], Array]
"""From states (B, nx) and the controls given in them (B, nu) to rewards (B,)."""


@dataclass(frozen=True)
class RewardState(TaskState):
    """``score`` (B,) is the sum of the rewards so far over the horizon."""

    score: Array


class Reward(Task):
    """Fitness is the mean of ``worth(state, control)`` over the horizon, for states in which the controls are given.

    A reward below ``lowest``, or one that is not a number, counts as ``lowest``. ``ended`` says of the states that
    are reached (B, nx) which trials are over (B,); they get nothing from then on. ``start`` draws the state (nx,) in
    which a trial begins, default at rest. ``states`` names what the function needs, in no order. ``scalar`` is
    ``worth`` for one state and control, in plain numbers as kernels are written: with it, and without ``ended``, the
    task has a compiled form. The observations are a bias and every state, as for `set_point`.

    It has no name on the command line: `register_reward` gives one to a function of single numbers, or register a
    function that returns such a task.
    """

    observations: tuple[Channel, ...] = (Channel("bias", neutral=1.0),)

    def __init__(
        self,
        worth: Worth,
        *,
        lowest: float = 0.0,
        horizon: int = 300,
        scalar: Callable[[Any, Any], Any] | None = None,
        ended: Callable[[Array], BoolArray] | None = None,
        start: Callable[[np.random.Generator], Array] | None = None,
        states: tuple[str, ...] = (),
        unit: str = "reward a step",
    ) -> None:
        if horizon < 1 or not np.isfinite(lowest):
            raise InvalidArgument(f"reward: expected horizon >= 1 and a finite lowest, got {horizon} and {lowest}")
        self.worth, self.scalar, self.ended, self.start, self.states = worth, scalar, ended, start, states
        self.lowest, self.horizon, self.fitness_unit = lowest, horizon, unit
        self.worst = min(0.0, lowest)

    def check_system(self, system: System) -> None:
        for name in self.states:
            if name not in system.state_names:
                raise IncompatibleTask(
                    f"the reward needs the state {name!r}; the states are {', '.join(system.state_names) or 'none'}"
                )

    def bind(self, system: System) -> Self:
        bound = super().bind(system)
        bound.observations = observations(system, ())
        return bound

    def begin(self, seeds: Seeds) -> RewardState:
        trials, system = len(seeds), self.system
        state = np.tile(system.neutral_state, (trials, 1))
        if self.start is not None:
            drawn = [self.start(generator(seed, TASK_STREAM)) for seed in seeds]
            state = check_shape("start of a reward", np.array(drawn), (trials, system.nx))
        pose, alive = np.zeros((trials, system.n_pose)), np.ones(trials, dtype=bool)
        return RewardState(state, pose, alive, np.zeros(trials))

    def observe(self, task_state: TaskState, state: Array) -> Array:
        return np.stack(shown_states(self.system, state), axis=1)

    def formulas(self) -> Mapping[str, str]:
        return formulas_of_states(self.system)

    def advance(
        self, task_state: TaskState, before: Array, after: Array, *, control: Array, pose: Array | None = None
    ) -> tuple[TaskState, Array]:
        here = cast("RewardState", task_state)
        rewards = check_shape("rewards", self.worth(before, control), (len(before),))
        rewards = np.where(rewards >= self.lowest, rewards, self.lowest)
        over = self.over_after(control, after)
        advanced = replace(
            here,
            score=here.score + rewards / self.horizon,
            pose=self.system.move(here.pose, before, after) if pose is None else pose,
            alive=here.alive & ~over,
        )
        return advanced, after

    def over_after(self, control: Array, after: Array) -> BoolArray:
        """Return which trials are over (B,) in the states ``after`` (B, nx), to which ``control`` (B, nu) led."""
        return np.zeros(len(after), dtype=bool) if self.ended is None else self.ended(after)

    def fitness(self, task_state: TaskState) -> Array:
        return np.maximum(cast("RewardState", task_state).score, self.worst)  # a sum of so many shares is rounded

    def kernel(self) -> TaskKernel[Any] | None:
        if self.scalar is None or self.ended is not None:
            return None
        from sysid_evo.engine.kernels.reward import reward_kernel

        return reward_kernel(self.system, self.scalar, self.lowest, self.horizon)
