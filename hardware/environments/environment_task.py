"""The task that an environment sets itself: its own reward, start and end, on any model of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from hardware.environments.asked import Asked
from hardware.environments.environment import LONGEST_SEED, make
from hardware.environments.kernels import rewards
from hardware.environments.known import KNOWN
from sysid_evo.arrays import Array, BoolArray, Seeds
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.kernels import LANES
from sysid_evo.registry import register_task
from sysid_evo.system import Channel, System
from sysid_evo.tasks.task import Task, TaskState

if TYPE_CHECKING:
    from collections.abc import Callable

    from sysid_evo.kernels import TaskKernel


@dataclass(frozen=True)
class Rules:
    """The reward of a step and when it is the last, see `rewards`.

    ``least`` is the lowest reward of a step, ``horizon`` the steps after which the environment's time is up. ``most``
    is the highest reward of a step, if every step can bring it.
    """

    reward: Callable[..., float]
    over: Callable[..., float]
    least: float
    horizon: int
    most: float = np.inf


SWING = Rules(rewards.pendulum, rewards.never, -(np.pi**2 + 0.1 * rewards.FASTEST_SWING**2 + 0.001 * 4.0), 200)
CLIMB = Rules(rewards.continuous_hill, rewards.on_continuous_hill, -0.1, 999)

RULES: Mapping[str, Rules] = {
    "Pendulum-v1": SWING,
    "CartPole-v0": Rules(rewards.one, rewards.fallen, 0.0, 200, most=1.0),
    "CartPole-v1": Rules(rewards.one, rewards.fallen, 0.0, 500, most=1.0),
    "MountainCar-v0": Rules(rewards.hill, rewards.on_hill, -1.0, 200),
    "MountainCarContinuous-v0": CLIMB,
    "Acrobot-v1": Rules(rewards.acrobot, rewards.raised, -1.0, 500),
}
"""Those of the classic environments."""


@dataclass(frozen=True)
class Earned(TaskState):
    """``earned`` (B,) is the sum of the rewards so far."""

    earned: Array


@register_task("environment")
class EnvironmentTask(Task):
    """Fitness is the sum of the rewards of the environment ``id``, as it gives them itself.

    A trial begins where the environment begins an episode with the trial's seed. It is over where the environment
    ends it, or after ``horizon`` steps, by default those of the environment. The controller is shown a constant 1, then
    every state: of an angle the sine and the cosine, of any other the distance from rest in units of its scale.
    The rewards of the classic environments are known as functions and compiled. Any other is put into each state and
    asked, which takes some hundred times as long; its attribute ``state`` must hold all that it depends on, in
    the order of its states. What it rewards below ``least`` counts as that; by default a little less than what
    random steps showed. Raises `IncompatibleTask` for one that cannot be asked, `InvalidArgument`.
    """

    fitness_unit = "reward"

    def __init__(
        self,
        *,
        id: str = "Pendulum-v1",  # noqa: A002  # as the robot
        horizon: int | None = None,
        least: float | None = None,
    ) -> None:
        self.id, self.rules, self.known = id, RULES.get(id), KNOWN.get(id)
        self.asked = None if self.rules is not None else Asked.of(id)
        found = self.rules or self.asked
        assert found is not None
        if self.asked is not None and least is not None:
            self.asked = found = replace(self.asked, least=least)
        elif least is not None:
            raise InvalidArgument(f"task environment: the least reward of {id} is known, {found.least:g}")
        self.horizon = found.horizon if horizon is None else horizon
        if self.horizon < 1:
            raise InvalidArgument(f"task environment: expected a horizon of at least one step, got {horizon}")
        self.worst = min(0.0, found.least) * self.horizon

    @property
    def scale(self) -> tuple[float, ...]:
        """How far each state goes."""
        if self.known is not None:
            return self.known.scale
        assert self.asked is not None
        return self.asked.scale

    def check_system(self, system: System) -> None:
        if self.known is None:
            self._check_sizes(system)
            return
        for what, own, its in (
            ("states", self.known.states, system.state_names),
            ("controls", self.known.controls, system.control_names),
        ):
            names = tuple(channel.name for channel in own)
            if names != tuple(its):
                raise IncompatibleTask(
                    f"the task of {self.id} needs the {what} {', '.join(names)}; "
                    f"{system.name or 'this system'} has {', '.join(its) or 'none'}"
                )

    def _check_sizes(self, system: System) -> None:
        assert self.asked is not None
        n, controls = len(self.asked.scale), self.asked.controls
        if system.nx != n or _size(system.controls) != _size(controls):
            raise IncompatibleTask(
                f"the task of {self.id} needs {n} states, those in which the environment keeps itself, and its own "
                f"controls; {system.name or 'this system'} has the states {', '.join(system.state_names)} and the "
                f"controls {', '.join(system.control_names) or 'none'}"
            )

    def bind(self, system: System) -> EnvironmentTask:
        bound = super().bind(system)
        shown = [Channel("bias", neutral=1.0)]
        for i, channel in enumerate(system.states):
            if i in system.periods:
                shown += [Channel(f"sin {channel.name}"), Channel(f"cos {channel.name}")]
            else:
                shown.append(Channel(channel.name))
        bound.observations = tuple(shown)
        return bound

    def begin(self, seeds: Seeds) -> Earned:
        states = starts(self.id, tuple(seeds.tolist()))
        alive = np.ones(len(seeds), dtype=bool)
        return Earned(states.copy(), np.zeros((len(seeds), self.system.n_pose)), alive, np.zeros(len(seeds)))

    def observe(self, task_state: TaskState, state: Array) -> Array:
        columns = [np.ones(len(state))]
        for i, (centre, scale) in enumerate(zip(self.system.neutral_state, self.scale, strict=True)):
            if i in self.system.periods:
                columns += [np.sin(state[:, i]), np.cos(state[:, i])]
            else:
                columns.append((state[:, i] - centre) / scale)
        return np.stack(columns, axis=1)

    def formulas(self) -> Mapping[str, str]:
        found: dict[str, str] = {}
        for channel, scale in zip(self.system.states, self.scale, strict=True):
            if channel.period:
                found |= {f"sin {channel.name}": f"sin({channel.name})", f"cos {channel.name}": f"cos({channel.name})"}
            else:
                off = f"({channel.name} - {channel.neutral:.10g})" if channel.neutral else channel.name
                found[channel.name] = f"{off} / {scale:.10g}"
        return found

    def advance(
        self, task_state: TaskState, before: Array, after: Array, *, control: Array, pose: Array | None = None
    ) -> tuple[TaskState, Array]:
        here = cast("Earned", task_state)
        reward, over = self._judged(before, control, after)
        return replace(here, earned=here.earned + reward, alive=here.alive & ~over), after

    def fitness(self, task_state: TaskState) -> Array:
        return cast("Earned", task_state).earned

    def kernel(self) -> TaskKernel[Any] | None:
        if self.rules is None:
            return None
        from hardware.environments.kernels import task
        from sysid_evo.kernels import KernelSource, TaskKernel

        states = [
            task.STATE.pack(periodic=float(i in self.system.periods), centre=centre, scale=scale)
            for i, (centre, scale) in enumerate(zip(self.system.neutral_state, self.scale, strict=True))
        ]
        return TaskKernel(
            observe=KernelSource(task.observe),
            advance=KernelSource(task.advance, {"reward_of": self.rules.reward, "is_over": self.rules.over}),
            n_rows=task.ROWS.size,
            rows=lambda state: np.stack([cast("Earned", state).earned, state.alive.astype(np.float64)]),
            trial_data=lambda state: np.zeros((len(state.alive), 1)),
            state=lambda state, rows: replace(cast("Earned", state), earned=rows[0], alive=rows[1] > 0.0),
            parameters=task.HEAD.pack(np.concatenate(states), nx=self.system.nx),
        )

    def _judged(self, before: Array, control: Array, after: Array) -> tuple[Array, BoolArray]:
        """Return the rewards of a step (B,), and whether it was the last."""
        if self.rules is None:
            assert self.asked is not None
            return self.asked.judge(before, control, self.system.controls)
        reward, over = np.zeros(len(after)), np.zeros(len(after), dtype=bool)
        for first in range(0, len(after), LANES):
            part = slice(first, first + LANES)
            rows = [_lanes(values[part]) for values in (before, control, after)]
            for lane in range(len(after[part])):
                reward[first + lane] = self.rules.reward(*rows, lane)
                over[first + lane] = self.rules.over(rows[2], lane) > 0.0
        return reward, over


def _size(channels: tuple[Channel, ...]) -> list[tuple[float, ...]]:
    """Return what counts of controls whose names are not known."""
    return [channel.levels or (channel.low, channel.high) for channel in channels]


def _lanes(values: Array) -> list[float]:
    """Return (k, n) values of at most 64 trials as rows of 64 lanes."""
    room = np.zeros((values.shape[1], LANES))
    room[:, : len(values)] = values.T
    numbers: list[float] = room.ravel().tolist()
    return numbers


@lru_cache(maxsize=16)
def starts(name: str, seeds: tuple[int, ...]) -> Array:
    """Return the state (E, nx) in which the environment ``name`` begins with each of the seeds; read-only."""
    env = make(name, {})
    begun = []
    for seed in seeds:
        env.reset(seed=seed % LONGEST_SEED)
        begun.append(np.array(vars(env.unwrapped)["state"], dtype=np.float64))  # every one that can be asked keeps one
    env.close()
    states = np.array(begun)
    states.flags.writeable = False
    return states
