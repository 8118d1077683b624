"""The task of a Gymnasium environment: its own reward, start and end, on any model of it.

Rewards and ends of the classic environments are kernel functions, by the rules that Gymnasium documents: ``before``,
``control`` and ``after`` are rows of 64 trials, of which ``lane`` is one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from hardware.simulators.gymnasium_robot import KNOWN
from hardware.simulators.gymnasium_spaces import (
    ActionMap,
    ObservationMap,
    control_channels,
    found_angles,
    make_environment,
    observation_map,
    raw_interface,
)
from hardware.simulators.gymnasium_state import KeptSettings, RandomStep, StateSetter, random_steps, state_setter
from hardware.simulators.simulator import LONGEST_SEED
from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.kernels import LANES, KernelSource, TaskKernel
from sysid_evo.registry import register_task
from sysid_evo.system import Channel, System
from sysid_evo.tasks.learned_reward import LearnedReward, scratch_rows
from sysid_evo.tasks.raw import RawInterface
from sysid_evo.tasks.reward_fit import fit_reward
from sysid_evo.tasks.task import LearnedTask, Task, TaskState
from sysid_evo.types import Array, BoolArray, Seeds

if TYPE_CHECKING:
    import gymnasium


import math

from sysid_evo.angles import TURN
from sysid_evo.kernels import Layout, nearest, view
from sysid_evo.motion_kernels import PER_TURN
from sysid_evo.tasks.learned_reward import judge_lanes

FASTEST_SWING = 8.0  # rad/s, beyond which the pendulum does not turn
CART_REACH, POLE_REACH = 2.4, 24.0 * math.pi / 360.0  # m, rad
CONTINUOUS_GOAL, GOAL = 0.45, 0.5


def pendulum(before, control, after, lane):
    """Minus the square of the angle from upright, and small shares of the squares of speed and torque."""
    angle = before[lane] - TURN * nearest(before[lane] * PER_TURN)
    speed = min(max(before[LANES + lane], -FASTEST_SWING), FASTEST_SWING)
    return -(angle * angle + 0.1 * speed * speed + 0.001 * control[lane] * control[lane])


def never(after, lane):
    """The pendulum continues until its time is up."""
    return 0.0


def one_a_step(before, control, after, lane):
    """The cart gets 1 for every step."""
    return 1.0


def fallen(after, lane):
    """The cart has left its rail, or the pole leans by more than 12 degrees."""
    return 1.0 if (abs(after[lane]) > CART_REACH) | (abs(after[2 * LANES + lane]) > POLE_REACH) else 0.0


def continuous_hill(before, control, after, lane):
    """100 at the goal, minus a tenth of the square of every force."""
    return 100.0 * on_continuous_hill(after, lane) - 0.1 * control[lane] * control[lane]


def on_continuous_hill(after, lane):
    """The car has reached the goal and does not roll back."""
    return 1.0 if (after[lane] >= CONTINUOUS_GOAL) & (after[LANES + lane] >= 0.0) else 0.0


def hill(before, control, after, lane):
    """Every step costs 1."""
    return -1.0


def on_hill(after, lane):
    """The car has reached the goal and does not roll back."""
    return 1.0 if (after[lane] >= GOAL) & (after[LANES + lane] >= 0.0) else 0.0


def acrobot(before, control, after, lane):
    """Every step costs 1, except the one that reaches the height."""
    return raised(after, lane) - 1.0


def raised(after, lane):
    """The free end is above the line, one link over the hinge."""
    height = -math.cos(after[lane]) - math.cos(after[lane] + after[LANES + lane])
    return 1.0 if height > 1.0 else 0.0


ROWS = Layout("fitness", "alive", "steps")
HEAD = Layout("nx")
STATE = Layout("periodic", "centre", "scale")


def observe(task, state, observation, parameters):
    """Bias, then each state in units of its scale; of a periodic one the sine and the cosine."""
    for lane in range(LANES):
        observation[lane] = 1.0
    row = 1
    for i in range(int(parameters[HEAD.nx])):
        at = HEAD.size + i * STATE.size
        centre, scale = parameters[at + STATE.centre], parameters[at + STATE.scale]
        value, shown = view(state, i * LANES), view(observation, row * LANES)
        if parameters[at + STATE.periodic] > 0.0:
            for lane in range(LANES):
                shown[lane] = math.sin(value[lane])
                shown[LANES + lane] = math.cos(value[lane])
            row += 2
        else:
            for lane in range(LANES):
                shown[lane] = (value[lane] - centre) / scale
            row += 1


def advance_known(task, before, after, control, trials, trial_data, parameters):
    """Add the reward of the step, and end the trial where the environment does."""
    for lane in range(LANES):
        task[ROWS.fitness * LANES + lane] += reward_of(before, control, after, lane)
        task[ROWS.steps * LANES + lane] += 1.0
        if is_over(after, lane) > 0.0:
            task[ROWS.alive * LANES + lane] = 0.0


LEARNED = Layout("least", "late", "limit")
"""After the table of the states; the parameters of the learned reward follow.

Those of the reward at the time limit begin at ``late``; ``limit`` is its step, 0 if it is paid as others are.
"""


def advance_learned(task, before, after, control, trials, trial_data, parameters):
    """Add the learned reward of the step, and end the trial where an episode was learned to end."""
    own = view(parameters, HEAD.size + int(parameters[HEAD.nx]) * STATE.size)
    scratch = view(task, ROWS.size * LANES)
    fitness, steps = view(task, ROWS.fitness * LANES), view(task, ROWS.steps * LANES)
    least, late, limit = own[LEARNED.least], int(own[LEARNED.late]), own[LEARNED.limit]
    judge_lanes(before, control, after, scratch, view(own, LEARNED.size))
    at_limit = 0
    for lane in range(LANES):
        steps[lane] += 1.0
        reward = scratch[lane] if scratch[lane] >= least else least
        if steps[lane] == limit:
            at_limit, reward = 1, 0.0
        fitness[lane] += reward
        if scratch[LANES + lane] > 0.0:
            task[ROWS.alive * LANES + lane] = 0.0
    if at_limit > 0:
        judge_lanes(before, control, after, scratch, view(own, late))
        for lane in range(LANES):
            if steps[lane] == limit:
                fitness[lane] += scratch[lane] if scratch[lane] >= least else least


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


LEAST_SWING = -(np.pi**2 + 0.1 * FASTEST_SWING**2 + 0.001 * 4.0)
RULES: Mapping[str, KnownReward] = {
    "Pendulum-v1": KnownReward(pendulum, never, LEAST_SWING, 200),
    "CartPole-v0": KnownReward(one_a_step, fallen, 0.0, 200, most=1.0),
    "CartPole-v1": KnownReward(one_a_step, fallen, 0.0, 500, most=1.0),
    "MountainCar-v0": KnownReward(hill, on_hill, -1.0, 200),
    "MountainCarContinuous-v0": KnownReward(continuous_hill, on_continuous_hill, -0.1, 999),
    "Acrobot-v1": KnownReward(acrobot, raised, -1.0, 500),
}
"""Rewards of the classic environments."""


@dataclass(frozen=True)
class EnvironmentTaskState(TaskState):
    """``earned`` (B,) is the sum of the rewards of all ``steps`` (B,) so far."""

    earned: Array
    steps: Array


@register_task("environment")
class EnvironmentTask(Task):
    """Fitness is the sum of the rewards of the environment ``id``.

    A trial begins where the environment begins an episode with the trial's seed. It ends where the environment
    ends it, or after ``horizon`` steps, by default those of the environment. The controller observes a constant 1, then
    every state: the sine and the cosine of an angle, the distance from rest in units of its scale for any other.
    ``angle`` and ``settings`` are those of the robot.

    The rewards of the classic environments are known as functions and compiled. Others are ``learned`` from a
    recording, which `compare` does, with the function `learn_task`; they are compiled, too. A reward that is paid at
    the environment's time limit alone is learned apart, and paid in that step of a trial. With ``exact`` the
    environment itself is put into each state and stepped instead, which takes some hundred times as long; this is the
    default of a task that has learned nothing, where `state_setter` finds a way. Rewards below ``lowest`` count as
    that; by default it is slightly below the rewards of random steps or of the recording. On the environment itself
    fitness is always the sum of its own rewards. Raises `IncompatibleTask` if the reward is not known,
    `InvalidArgument`.
    """

    fitness_unit = "reward"

    def __init__(
        self,
        *,
        id: str = "Pendulum-v1",  # noqa: A002  # as the robot
        angle: str | int | None = None,
        settings: Mapping[str, Any] | None = None,
        horizon: int | None = None,
        lowest: float | None = None,
        learned: str = "",
        exact: bool = False,
    ) -> None:
        self.id, self.rules, self.known = id, RULES.get(id), KNOWN.get(id)
        self.angle, self.settings = "" if angle is None else str(angle), dict(settings or {})
        asked = None if angle is None else self.angle
        self.learned = LearnedReward.from_text(learned) if learned else None
        self.tried: TriedEnvironment | None = None
        if self.rules is not None:
            if lowest is not None or learned or exact:
                what = f"the lowest reward of {id} is known, {self.rules.least:g}" if lowest is not None else ""
                raise InvalidArgument(f"task environment: {what or f'the reward of {id} is known: it is not learned'}")
            self.scale, least, longest = KNOWN[id].scale, self.rules.least, self.rules.horizon
        else:
            self.tried = tried = _tried(id, asked, KeptSettings.of(self.settings))
            self.angle, self.scale = tried.angle, tried.scale
            least, longest = tried.least if self.learned is None else self.learned.least, tried.horizon
            if exact and isinstance(tried.setter, str):
                raise IncompatibleTask(f"task environment: {tried.setter}, so its reward cannot be computed exactly")
        self.least = least if lowest is None else lowest
        self.needs_recording = self.rules is None and self.learned is None and not exact
        self.pays_at_limit = self.learned is not None and self.learned.late is not None
        self.limit = longest
        self.horizon = longest if horizon is None else horizon
        if self.horizon < 1:
            raise InvalidArgument(f"task environment: expected a horizon of at least one step, got {horizon}")
        self.worst = min(0.0, self.least) * self.horizon

    def check_system(self, system: System) -> None:
        if self.known is None:
            assert self.tried is not None
            n, controls = len(self.scale), self.tried.controls
            if system.nx != n or _size(system.controls) != _size(controls):
                names = ", ".join(channel.name for channel in self.tried.states)
                raise IncompatibleTask(
                    f"the task of {self.id} needs {n} states, those of the environment itself ({names}), and its own "
                    f"controls; {system.name or 'this system'} has the states {', '.join(system.state_names)} and the "
                    f"controls {', '.join(system.control_names) or 'none'}"
                )
            if self.learned is not None and not self.learned.fits(system):
                raise IncompatibleTask(
                    f"the reward of {self.id} was learned from another recording: its angles were different ones"
                )
            return
        for what, own, its in (
            ("states", self.known.states, system.state_names),
            ("controls", self.known.controls, system.control_names),
        ):
            wanted = tuple(channel.name for channel in own)
            if wanted != tuple(its):
                raise IncompatibleTask(
                    f"the task of {self.id} needs the {what} {', '.join(wanted)}; "
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
        if self.tried is None:
            states = initial_states(self.id, tuple(seeds.tolist()))
        else:
            states = self.tried.initial_states(tuple(seeds.tolist()))
        alive, none = np.ones(len(seeds), dtype=bool), np.zeros(len(seeds))
        return EnvironmentTaskState(states.copy(), np.zeros((len(seeds), self.system.n_pose)), alive, none, none)

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
        if self.learned is not None and self.learned.late is not None:
            late, _ = self.learned.late.judge(self.system, before, control, after)
            reward = np.where(here.steps + 1 == self.limit, np.maximum(late, self.least), reward)
        return replace(here, earned=here.earned + reward, alive=here.alive & ~over, steps=here.steps + 1), after

    def fitness(self, task_state: TaskState) -> Array:
        return cast("EnvironmentTaskState", task_state).earned

    def learn(self, dataset: Dataset) -> LearnedTask:
        reward, quality = fit_reward(dataset, self.limit)
        settable = self.tried is not None and isinstance(self.tried.setter, StateSetter)
        # an environment that is put into a state begins at time 0, and never pays what it pays at the limit
        exact = {"exact": True} if settable and not quality.forms[3] else {}
        return LearnedTask({"learned": reward.to_text()}, quality.sentences, quality.warning, exact)

    def rewarded_by(self, simulator: str) -> bool:
        return self.rules is None and simulator == self.id

    def advance_rewarded(self, task_state: TaskState, reward: Array) -> TaskState:
        here = cast("EnvironmentTaskState", task_state)
        return replace(here, earned=here.earned + np.where(reward >= self.least, reward, self.least))

    def raw(self) -> RawInterface:
        angle = self.known.angle if self.known is not None else self.angle
        return raw_interface(self.id, self.settings, angle, self.system, self.scale)

    def kernel(self) -> TaskKernel[Any] | None:
        if self.rules is None and self.learned is None:
            self._check_known()
            return None
        states = [
            STATE.pack(periodic=float(i in self.system.periods), centre=centre, scale=scale)
            for i, (centre, scale) in enumerate(zip(self.system.neutral_state, self.scale, strict=True))
        ]
        if self.rules is not None:
            functions = {"reward_of": self.rules.reward, "is_over": self.rules.over}
            advance, further = KernelSource(advance_known, functions), 0
            parameters = HEAD.pack(np.concatenate(states), nx=self.system.nx)
        else:
            assert self.learned is not None
            advance, further = KernelSource(advance_learned), scratch_rows(self.learned)
            late = self.learned.late
            tables = [one.parameters(self.system) for one in (self.learned, late) if one is not None]
            at, limit = LEARNED.size + len(tables[0]), 0 if late is None else self.limit
            own = LEARNED.pack(*tables, least=self.least, late=at, limit=limit)
            parameters = HEAD.pack(np.concatenate(states), own, nx=self.system.nx)
        return TaskKernel(
            observe=KernelSource(observe),
            advance=advance,
            rows=lambda state: np.vstack(
                [state.earned, state.alive, state.steps, np.zeros((further, len(state.alive)))]
            ),
            trial_data=lambda state: np.zeros((len(state.alive), 1)),
            state=lambda state, rows: replace(state, earned=rows[0], alive=rows[1] > 0.0, steps=rows[2]),
            parameters=parameters,
        )

    def _check_known(self) -> None:
        """Raise `IncompatibleTask` if the reward is neither known nor learned, and cannot be asked."""
        if self.tried is not None and self.learned is None and isinstance(self.tried.setter, str):
            raise IncompatibleTask(
                f"task environment: the reward of {self.id} must be learned from a recording. sysid-evo compare does "
                "so; in Python learn_task(task, dataset) returns the task. Or write it as a function, register_reward, "
                f"in a file for --plugin FILE. It cannot be computed exactly: {self.tried.setter}"
            )

    def _judged(self, before: Array, control: Array, after: Array) -> tuple[Array, BoolArray]:
        """Return the rewards of a step (B,), and whether it was the last."""
        if self.learned is not None:
            rewards, ended = self.learned.judge(self.system, before, control, after)
            return np.where(rewards >= self.least, rewards, self.least), ended
        if self.rules is None:
            assert self.tried is not None
            self._check_known()
            return self.tried.judge(before, control, self.system.controls, self.least)
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
class TriedEnvironment:
    """What some hundred random steps show of the environment called ``id``.

    ``least`` is the lowest reward, minus a tenth of their range; ``scale`` (nx,) is the range of its states;
    ``horizon`` the number of steps until its time is up; ``setter`` puts it into a state, or is the reason why it
    cannot be put there.
    """

    id: str
    least: float
    scale: tuple[float, ...]
    horizon: int
    states: tuple[Channel, ...]
    observations: ObservationMap
    setter: StateSetter | str
    environment: gymnasium.Env[Any, Any]
    angle: str

    def judge(
        self, before: Array, control: Array, controls: tuple[Channel, ...], least: float
    ) -> tuple[Array, BoolArray]:
        """Return the rewards (B,) of steps from states (B, n) under controls (B, nu), and which were the last."""
        assert isinstance(self.setter, StateSetter)
        actions, env = ActionMap(self.environment.action_space, controls), self.environment
        rewards, over = np.zeros(len(before)), np.zeros(len(before), dtype=bool)
        for i, (state, values) in enumerate(zip(before, control, strict=True)):
            env.reset(seed=0)
            self.setter.put(env, state)
            _, reward, over[i], _, _ = env.step(actions.action(values))
            rewards[i] = np.asarray(reward).item()
        return np.where(rewards >= least, rewards, least), over

    def initial_states(self, seeds: tuple[int, ...]) -> Array:
        """Return the state (E, nx) in which it begins with each of the seeds."""
        begun = [self.environment.reset(seed=seed % LONGEST_SEED)[0] for seed in seeds]
        return self.observations.state(np.array(begun))

    @property
    def controls(self) -> tuple[Channel, ...]:
        """Its actions as channels, with any names."""
        return control_channels(f"task environment: {self.id}", self.environment.action_space)


def _time_limit(steps: Sequence[RandomStep]) -> int:
    """Return the length of the longest episode whose time was up, 0 without one, for environments that declare none."""
    longest = length = 0
    for step in steps:
        length += 1
        longest = max(longest, length) if step.late else longest
        length = 0 if step.late or step.ended else length
    return longest


@lru_cache(maxsize=32)
def _tried(name: str, angle: str | None, settings: KeptSettings) -> TriedEnvironment:
    """Try the environment called ``name``, once in a process; its angles are found if ``angle`` is None."""
    env = make_environment(name, settings.values)
    angle = found_angles(f"task environment: {name}", env)[0] if angle is None else angle
    observations, channels = observation_map(f"task environment: {name}", env.observation_space, angle)
    steps = list(random_steps(env, observations, TRIED))
    rewards = [one.reward for one in steps if np.isfinite(one.reward)] or [0.0]
    states = np.array([one.before for one in steps])
    spread = np.ptp(states, axis=0)
    horizon = (None if env.spec is None else env.spec.max_episode_steps) or _time_limit(steps) or LONGEST
    least = min(rewards) - 0.1 * (max(rewards) - min(rewards))
    scale = tuple(np.where(spread > 0.0, spread, 1.0).tolist())
    setter = state_setter(name, settings.values, observations)
    return TriedEnvironment(name, least, scale, horizon, channels, observations, setter, env, angle)
