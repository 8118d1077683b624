"""The task of a Gymnasium environment: its own reward, start and end, on any model of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from hardware.simulators import gymnasium_rewards
from hardware.simulators.gymnasium_robot import KNOWN, ActionMap, control_channels, make_environment
from hardware.simulators.simulator import LONGEST_SEED
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.kernels import LANES, KernelSource, TaskKernel
from sysid_evo.registry import register_task
from sysid_evo.system import Channel, System
from sysid_evo.tasks.task import Task, TaskState
from sysid_evo.types import Array, BoolArray, Seeds

if TYPE_CHECKING:
    import gymnasium


@dataclass(frozen=True)
class KnownReward:
    """The reward of a step and the end of a trial, see `rewards`.

    ``least`` is the lowest reward of a step, ``horizon`` the number of steps until the environment's time is up.
    ``most`` is the highest reward of a step, if every step can give it.
    """

    reward: Callable[..., float]
    over: Callable[..., float]
    least: float
    horizon: int
    most: float = np.inf


SWING = KnownReward(
    gymnasium_rewards.pendulum,
    gymnasium_rewards.never,
    -(np.pi**2 + 0.1 * gymnasium_rewards.FASTEST_SWING**2 + 0.001 * 4.0),
    200,
)

CLIMB = KnownReward(gymnasium_rewards.continuous_hill, gymnasium_rewards.on_continuous_hill, -0.1, 999)

RULES: Mapping[str, KnownReward] = {
    "Pendulum-v1": SWING,
    "CartPole-v0": KnownReward(gymnasium_rewards.one, gymnasium_rewards.fallen, 0.0, 200, most=1.0),
    "CartPole-v1": KnownReward(gymnasium_rewards.one, gymnasium_rewards.fallen, 0.0, 500, most=1.0),
    "MountainCar-v0": KnownReward(gymnasium_rewards.hill, gymnasium_rewards.on_hill, -1.0, 200),
    "MountainCarContinuous-v0": CLIMB,
    "Acrobot-v1": KnownReward(gymnasium_rewards.acrobot, gymnasium_rewards.raised, -1.0, 500),
}
"""Rewards of the classic environments."""


@dataclass(frozen=True)
class EnvironmentTaskState(TaskState):
    """``earned`` (B,) is the sum of the rewards so far."""

    earned: Array


@register_task("environment")
class EnvironmentTask(Task):
    """Fitness is the sum of the rewards of the environment ``id``.

    A trial begins where the environment begins an episode with the trial's seed. It ends where the environment
    ends it, or after ``horizon`` steps, by default those of the environment. The controller observes a constant 1, then
    every state: the sine and the cosine of an angle, the distance from rest in units of its scale for any other.
    The rewards of the classic environments are known as functions and compiled. For any other the environment is put
    into each state and stepped, which takes some hundred times as long; its attribute ``state`` must hold everything
    that it depends on, in the order of its states. Rewards below ``lowest`` count as that; by default it is slightly
    below the rewards of random steps. Raises `IncompatibleTask` if the reward cannot be computed, `InvalidArgument`.
    """

    fitness_unit = "reward"

    def __init__(
        self,
        *,
        id: str = "Pendulum-v1",  # noqa: A002  # as the robot
        horizon: int | None = None,
        lowest: float | None = None,
    ) -> None:
        self.id, self.rules, self.known = id, RULES.get(id), KNOWN.get(id)
        self.asked: QueriedReward | None = None if self.rules is not None else QueriedReward.of(id)
        found = self.rules or self.asked
        assert found is not None
        if self.asked is not None and lowest is not None:
            self.asked = found = replace(self.asked, least=lowest)
        elif lowest is not None:
            raise InvalidArgument(f"task environment: the lowest reward of {id} is known, {found.least:g}")
        self.horizon = found.horizon if horizon is None else horizon
        if self.horizon < 1:
            raise InvalidArgument(f"task environment: expected a horizon of at least one step, got {horizon}")
        self.worst = min(0.0, found.least) * self.horizon

    @property
    def scale(self) -> tuple[float, ...]:
        """Range of each state."""
        if self.known is not None:
            return self.known.scale
        assert self.asked is not None
        return self.asked.scale

    def check_system(self, system: System) -> None:
        if self.known is None:
            assert self.asked is not None
            n, controls = len(self.asked.scale), self.asked.controls
            if system.nx != n or _size(system.controls) != _size(controls):
                raise IncompatibleTask(
                    f"the task of {self.id} needs {n} states, those of the environment itself, and its own "
                    f"controls; {system.name or 'this system'} has the states {', '.join(system.state_names)} and the "
                    f"controls {', '.join(system.control_names) or 'none'}"
                )
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

    def begin(self, seeds: Seeds) -> EnvironmentTaskState:
        states = initial_states(self.id, tuple(seeds.tolist()))
        alive = np.ones(len(seeds), dtype=bool)
        return EnvironmentTaskState(
            states.copy(), np.zeros((len(seeds), self.system.n_pose)), alive, np.zeros(len(seeds))
        )

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
        here = cast("EnvironmentTaskState", task_state)
        reward, over = self._judged(before, control, after)
        return replace(here, earned=here.earned + reward, alive=here.alive & ~over), after

    def fitness(self, task_state: TaskState) -> Array:
        return cast("EnvironmentTaskState", task_state).earned

    def kernel(self) -> TaskKernel[Any] | None:
        if self.rules is None:
            return None
        states = [
            gymnasium_rewards.STATE.pack(periodic=float(i in self.system.periods), centre=centre, scale=scale)
            for i, (centre, scale) in enumerate(zip(self.system.neutral_state, self.scale, strict=True))
        ]
        return TaskKernel(
            observe=KernelSource(gymnasium_rewards.observe),
            advance=KernelSource(
                gymnasium_rewards.advance, {"reward_of": self.rules.reward, "is_over": self.rules.over}
            ),
            n_rows=gymnasium_rewards.ROWS.size,
            rows=lambda state: np.stack([cast("EnvironmentTaskState", state).earned, state.alive.astype(np.float64)]),
            trial_data=lambda state: np.zeros((len(state.alive), 1)),
            state=lambda state, rows: replace(cast("EnvironmentTaskState", state), earned=rows[0], alive=rows[1] > 0.0),
            parameters=gymnasium_rewards.HEAD.pack(np.concatenate(states), nx=self.system.nx),
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
    """Levels or limits of each control, to compare controls whose names may differ."""
    return [channel.levels or (channel.low, channel.high) for channel in channels]


def _lanes(values: Array) -> list[float]:
    """Return (k, n) values of at most 64 trials as rows of 64 lanes."""
    room = np.zeros((values.shape[1], LANES))
    room[:, : len(values)] = values.T
    numbers: list[float] = room.ravel().tolist()
    return numbers


@lru_cache(maxsize=16)
def initial_states(name: str, seeds: tuple[int, ...]) -> Array:
    """Return the state (E, nx) in which the environment ``name`` begins with each of the seeds; read-only."""
    env = make_environment(name, {})
    begun = []
    for seed in seeds:
        env.reset(seed=seed % LONGEST_SEED)
        begun.append(np.array(vars(env.unwrapped)["state"], dtype=np.float64))  # every queried environment has one
    env.close()
    states = np.array(begun)
    states.flags.writeable = False
    return states


TRIED = 400
"""Number of random steps for the lowest reward and the range of the states."""
LONGEST = 500
"""Number of steps of a trial if the environment has no time limit."""


@dataclass(frozen=True)
class QueriedReward:
    """The environment called ``id``, whose attribute ``state`` (n,) holds all that its steps depend on.

    ``least`` is the lowest reward of some hundred random steps, minus a tenth of their range; ``scale`` (n,) is the
    range of its states; ``horizon`` the number of steps until its time is up.
    """

    id: str
    least: float
    scale: tuple[float, ...]
    horizon: int
    environment: gymnasium.Env[Any, Any]

    @classmethod
    def of(cls, name: str) -> QueriedReward:
        """Try the environment called ``name``. Raises `IncompatibleTask` if its reward cannot be computed."""
        env = make_environment(name, {})
        inner: Any = env.unwrapped
        rng = np.random.default_rng(0)
        env.action_space.seed(0)
        env.reset(seed=0)
        kept: Any = getattr(inner, "state", None)
        if kept is None or np.ndim(kept) != 1:
            raise IncompatibleTask(
                f"task environment: {name} has no attribute state, a row of numbers that can be set, so "
                "its reward cannot be computed. Write it as a function: register_reward"
            )
        rewards, seen = [], []
        for _ in range(TRIED):
            before, action = np.array(inner.state, dtype=np.float64), env.action_space.sample()
            seen.append(before)
            first, again = (_stepped(inner, before, action) for _ in range(2))
            if not np.array_equal(first, again):
                raise IncompatibleTask(
                    f"task environment: {name}, put into the same state twice, continued differently: it depends on "
                    "more than its state, so its reward cannot be computed. Write it as a function: register_reward"
                )
            rewards.append(float(first[-2]))
            if first[-1]:
                env.reset(seed=int(rng.integers(2**31)))
        spread = np.ptp(np.array(seen), axis=0)
        spec = env.spec
        horizon = LONGEST if spec is None or spec.max_episode_steps is None else spec.max_episode_steps
        least = min(rewards) - 0.1 * (max(rewards) - min(rewards))
        return cls(name, least, tuple(np.where(spread > 0.0, spread, 1.0).tolist()), horizon, env)

    def judge(self, before: Array, control: Array, controls: tuple[Channel, ...]) -> tuple[Array, BoolArray]:
        """Return the rewards (B,) of steps from states (B, n) under controls (B, nu), and which were the last."""
        actions = ActionMap(self.environment.action_space, controls)
        inner: Any = self.environment.unwrapped
        results = [_stepped(inner, x, actions.action(u))[-2:] for x, u in zip(before, control, strict=True)]
        rewards, over = np.array(results, dtype=np.float64).reshape(-1, 2).T
        return np.where(rewards >= self.least, rewards, self.least), over > 0.0

    @property
    def controls(self) -> tuple[Channel, ...]:
        """Its actions as channels, with any names."""
        return control_channels(f"task environment: {self.id}", self.environment.action_space)


def _stepped(inner: Any, state: Array, action: Any) -> Array:
    """Return the next state, the reward, and whether it was the last step, of an environment put into ``state``."""
    inner.state = np.array(state, dtype=np.float64)
    _, reward, ended, _, _ = inner.step(action)
    return np.array([*np.ravel(inner.state), float(reward), float(ended)], dtype=np.float64)
