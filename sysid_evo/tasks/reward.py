"""Tasks defined by a reward function of state and control, and the decorator that registers such a function."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self, TypeAlias, TypeVar, cast

import numpy as np
import numpy.typing as npt

from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.kernels import LANES, KernelSource, Layout, ScalarFunction, Source, TaskKernel, view
from sysid_evo.randomness import TASK_STREAM, generator
from sysid_evo.registry.registry import register_task
from sysid_evo.system import Channel, System
from sysid_evo.tasks.task import Task, TaskState
from sysid_evo.tasks.tracking import HEAD, OBSERVING, formulas_of_states, numbers_of, observations, shown
from sysid_evo.types import Array, BoolArray, Seeds, check_shape

RewardFunction: TypeAlias = Callable[[Array, Array], Array] | Callable[[Array, Array, Array], Array]
"""From states (B, nx) and the controls applied in them (B, nu) to rewards (B,).

With a third argument it also gets the next states (B, nx).
"""


Start: TypeAlias = (
    Mapping[str, tuple[float, float]] | Callable[[np.random.Generator], npt.ArrayLike | Mapping[str, float]]
)
"""Ranges of start values by name of the state, or a function that draws a start state, or values by name."""


@dataclass(frozen=True)
class RewardState(TaskState):
    """``score`` (B,) is the sum of the rewards so far over the horizon."""

    score: Array


class Reward(Task):
    """Fitness is the mean of ``reward(state, control)`` over the horizon; controls are applied in these states.

    - ``lowest``: lower bound of a reward, which also replaces nan.
    - ``terminated``: maps the states reached (B, nx) to the trials that are over (B,); these get no further reward.
    - ``start``: draws the start state (nx,) of a trial; at rest by default.
    - ``states``: names of the states that the function needs, in any order.
    - ``scalar``: ``reward`` for one state and control in plain numbers, as in kernels; with it, and without
      ``terminated``, the task has a compiled form.

    The observations are a bias and every state, as for `set_point`. To use such a task on the command line, give a
    function of single numbers to `register_reward`, or register a function that returns the task.
    """

    observations: tuple[Channel, ...] = (Channel("bias", neutral=1.0),)

    def __init__(
        self,
        reward: RewardFunction,
        *,
        lowest: float = 0.0,
        horizon: int = 300,
        scalar: Callable[[Any, Any], Any] | None = None,
        terminated: Callable[[Array], BoolArray] | None = None,
        start: Callable[[np.random.Generator], Array] | None = None,
        states: tuple[str, ...] = (),
        unit: str = "reward a step",
    ) -> None:
        if horizon < 1 or not np.isfinite(lowest):
            raise InvalidArgument(f"reward: expected horizon >= 1 and a finite lowest, got {horizon} and {lowest}")
        self.needs_next = takes_next(reward)
        if scalar is not None and self.needs_next:
            raise InvalidArgument("reward: expected no scalar for a reward of three arguments")
        self.reward, self.scalar, self.terminated, self.start, self.states = reward, scalar, terminated, start, states
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
        bound.numbers = numbers_of(system, (), np.zeros(0))
        return bound

    numbers: Array

    def begin(self, seeds: Seeds) -> RewardState:
        trials, system = len(seeds), self.system
        state = np.tile(system.neutral_state, (trials, 1))
        if self.start is not None:
            drawn = [self.start(generator(seed, TASK_STREAM)) for seed in seeds]
            state = check_shape("start of a reward", np.array(drawn), (trials, system.nx))
        pose, alive = system.initial_pose(state), np.ones(trials, dtype=bool)
        return RewardState(state, pose, alive, np.zeros(trials))

    def observe(self, task_state: TaskState, state: Array) -> Array:
        return shown(self.numbers, np.zeros((0, len(state))), state, len(self.observations))

    def formulas(self) -> Mapping[str, str]:
        return formulas_of_states(self.system)

    def advance(
        self, task_state: TaskState, before: Array, after: Array, *, control: Array, pose: Array | None = None
    ) -> tuple[TaskState, Array]:
        here = cast("RewardState", task_state)
        given = (before, control, after) if self.needs_next else (before, control)
        rewards = check_shape("rewards", cast("Callable[..., Array]", self.reward)(*given), (len(before),))
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
        """Return which trials are over (B,) in the states ``after`` (B, nx), reached with ``control`` (B, nu)."""
        return np.zeros(len(after), dtype=bool) if self.terminated is None else self.terminated(after)

    def fitness(self, task_state: TaskState) -> Array:
        return np.maximum(cast("RewardState", task_state).score, self.worst)  # sums are rounded

    def kernel(self) -> TaskKernel[Any] | None:
        if self.scalar is None or self.terminated is not None:
            return None
        return reward_kernel(self.system, self.scalar, self.lowest, self.horizon)


def takes_next(reward: RewardFunction) -> bool:
    """Return whether ``reward`` takes the next states as its third argument."""
    needed = [p for p in inspect.signature(reward).parameters.values() if p.default is p.empty]
    return sum(p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) for p in needed) == 3


F = TypeVar("F", bound=Callable[..., Any])
RESERVED = "horizon"
NEXT = "next_"
"""Begins the name of an argument that is a state after the step."""


class NamedReward(Reward):
    """The mean over the horizon of a ``function`` whose arguments are named after states and controls.

    An argument ``next_NAME`` is the state ``NAME`` after the step.

    - ``constants``: values of further arguments.
    - ``terminated``: a function of the same kind, of the state reached and the control applied before.
    - ``start``: range of the start value by name of the state; other states begin at rest. Or a function that draws
      the start state (nx,) with a generator of random numbers, or values by name.
    - ``compiled``: compile both functions; they must be written in plain numbers and `math`, as kernels are.
    - ``min_reward``: ``lowest`` of `Reward`.

    `bind` raises `IncompatibleTask` for an argument that is not a state, control or constant.
    """

    def __init__(
        self,
        name: str,
        function: Callable[..., Any],
        *,
        min_reward: float,
        constants: Mapping[str, float],
        terminated: Callable[..., Any] | None = None,
        start: Start | None = None,
        horizon: int = 300,
        compiled: bool = True,
        unit: str = "reward a step",
    ) -> None:
        super().__init__(self._worth, lowest=min_reward, horizon=horizon, unit=unit)
        self.name, self.function, self.over, self.compiled = name, function, terminated, compiled
        self.needs_next, self.constants = True, dict(constants)
        self.draw = start if callable(start) else None
        self.begins: dict[str, tuple[float, float]] = {} if start is None or callable(start) else dict(start)
        for constant, value in self.constants.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise InvalidArgument(f"{name}: {constant}: expected a finite number, got {value!r}")

    def check_system(self, system: System) -> None:
        following = tuple(NEXT + name for name in system.state_names)
        known = (*system.state_names, *system.control_names, *self.constants, *following)
        wanted = [name for function in (self.function, self.over) if function for name in arguments_of(function)]
        for name in (*wanted, *self.begins):
            if name not in known or (name in self.begins and name not in system.state_names):
                what = "a state" if name in self.begins else "a state, a control or an argument with a default"
                raise IncompatibleTask(
                    f"{self.name} needs {name!r} as {what}; states: {', '.join(system.state_names)}, controls: "
                    f"{', '.join(system.control_names) or 'none'}"
                )

    def bind(self, system: System) -> Self:
        bound = super().bind(system)
        bound.reward = bound._worth
        bound.terminated = None
        bound.start = bound._drawn if self.begins or self.draw is not None else None
        return bound

    def over_after(self, control: Array, after: Array) -> BoolArray:
        if self.over is None:
            return np.zeros(len(after), dtype=bool)
        return np.array([bool(self._value(self.over, *row)) for row in zip(after, control, after, strict=True)])

    def kernel(self) -> TaskKernel[Any] | None:
        if not self.compiled:
            return None
        over = None if self.over is None else self._picked(self.over)
        two = any(name.startswith(NEXT) for part in (self.function, self.over) if part for name in arguments_of(part))
        return reward_kernel(self.system, self._picked(self.function), self.lowest, self.horizon, over, two=two)

    def _worth(self, states: Array, controls: Array, following: Array | None = None) -> Array:
        following = np.full_like(states, np.nan) if following is None else following
        return np.array([self._value(self.function, *row) for row in zip(states, controls, following, strict=True)])

    def _value(self, function: Callable[..., Any], state: Array, control: Array, after: Array) -> float:
        """Return ``function`` of one state and control; nan after an arithmetic error such as a division by 0."""
        known = dict(zip(self.system.state_names, state.tolist(), strict=True))
        known |= {NEXT + name: value for name, value in zip(self.system.state_names, after.tolist(), strict=True)}
        known |= dict(zip(self.system.control_names, control.tolist(), strict=True)) | self.constants
        try:
            return float(function(*(known[name] for name in arguments_of(function))))
        except (ArithmeticError, ValueError):
            return math.nan

    def _picked(self, function: Callable[..., Any]) -> ScalarFunction:
        places = {NEXT + name: f"u[{self.system.nu + i}]" for i, name in enumerate(self.system.state_names)}
        places |= {name: f"x[{i}]" for i, name in enumerate(self.system.state_names)}
        places |= {name: f"u[{i}]" for i, name in enumerate(self.system.control_names)}
        places |= {name: f"_real({float(value)!r})" for name, value in self.constants.items()}
        return ScalarFunction(function, tuple(places[name] for name in arguments_of(function)))

    def _drawn(self, rng: np.random.Generator) -> Array:
        state = self.system.neutral_state.copy()
        if self.draw is not None:
            drawn = self.draw(rng)
            if not isinstance(drawn, Mapping):
                return check_shape(f"start of {self.name}", drawn, (self.system.nx,))
            for name, value in drawn.items():
                if name not in self.system.state_names:
                    raise IncompatibleTask(
                        f"{self.name}: start gives {name!r}; the states are {', '.join(self.system.state_names)}"
                    )
                state[self.system.state_names.index(name)] = value
        for name, (low, high) in self.begins.items():
            state[self.system.state_names.index(name)] = rng.uniform(low, high)
        return state


def arguments_of(function: Callable[..., Any]) -> tuple[str, ...]:
    """Return the names of the arguments of ``function``, in order."""
    return tuple(inspect.signature(function).parameters)


def register_reward(
    name: str,
    *,
    min_reward: float,
    horizon: int = 300,
    terminated: Callable[..., Any] | None = None,
    start: Start | None = None,
    compiled: bool = True,
    unit: str = "reward a step",
) -> Callable[[F], F]:
    """Return a decorator that registers a function as the task ``name``, see `NamedReward`.

    The function's arguments are named after states and controls; ``next_NAME`` is the state ``NAME`` after the step.
    Arguments with a default are parameters of the task,
    like ``horizon``: ``NAME(horizon=200, weight=0.5)``. Raises `InvalidArgument` for other kinds of arguments.
    """

    def decorate(function: F) -> F:
        found = inspect.signature(function).parameters
        odd = [p.name for p in found.values() if p.kind is not p.POSITIONAL_OR_KEYWORD or p.name == RESERVED]
        if odd:
            raise InvalidArgument(
                f"reward {name!r}: expected arguments named after states and controls, and none named {RESERVED}; got "
                f"{', '.join(odd)}"
            )
        defaults = {p.name: p.default for p in found.values() if p.default is not p.empty}

        def make(*, horizon: int = horizon, **constants: float) -> NamedReward:
            return NamedReward(
                name,
                function,
                min_reward=min_reward,
                constants={**defaults, **constants},
                terminated=terminated,
                start=start,
                horizon=horizon,
                compiled=compiled,
                unit=unit,
            )

        only = inspect.Parameter.KEYWORD_ONLY
        settable = {RESERVED: horizon, **defaults}
        signature = inspect.Signature([inspect.Parameter(key, only, default=value) for key, value in settable.items()])
        make.__dict__["__signature__"] = signature
        make.__module__, make.__qualname__, make.__doc__ = function.__module__, function.__qualname__, function.__doc__
        register_task(name)(make)
        return function

    return decorate


ROWS = Layout("score", "alive", "pose")
"""The pose is followed by one row that holds the state and the control of a lane."""
OWN = Layout("lowest", "share", "two")


def reward_kernel(
    system: System,
    scalar: Callable[..., Any] | Source,
    lowest: float,
    horizon: int,
    over: Source | None = None,
    *,
    two: bool = False,
) -> TaskKernel[Any] | None:
    """Return the compiled form; None if the motion has none, or state and control fill more than a row.

    ``scalar`` and ``over`` are functions of one state and control; a trial is over where the latter is not 0. With
    ``two``, the next state follows the control.
    """
    motion = system.motion_kernel()
    if motion is None or (2 if two else 1) * system.nx + system.nu > LANES:
        return None
    worth = KernelSource(scalar) if callable(scalar) else scalar
    numbers = numbers_of(system, (), OWN.pack(lowest=lowest, share=1.0 / horizon, two=float(two)))
    return TaskKernel(
        observe=OBSERVING,
        advance=KernelSource(advance_lanes, {"move": motion.move, "worth": worth, "over": over or KernelSource(never)}),
        rows=_rows,
        trial_data=lambda task_state: np.zeros((len(task_state.alive), 1)),
        state=_state,
        parameters=np.concatenate([numbers, motion.parameters]),
        pose_row=ROWS.pose,
        n_pose=system.n_pose,
    )


def _rows(here: RewardState) -> Array:
    return np.stack([here.score, here.alive.astype(np.float64), *here.pose.T, np.zeros(len(here.alive))])


def _state(here: RewardState, rows: Array) -> TaskState:
    pose = rows[ROWS.pose : ROWS.pose + here.pose.shape[1]].T.copy()
    return replace(here, score=rows[ROWS.score], alive=rows[ROWS.alive] > 0, pose=pose)


def advance_lanes(task, before, after, control, trials, trial_data, parameters):
    """Move the pose and add the reward of the state in which the control was applied."""
    nx, nu, n_pose = int(parameters[HEAD.nx]), int(parameters[HEAD.nu]), int(parameters[HEAD.n_pose])
    own = view(parameters, int(parameters[HEAD.of_nu]))
    pose = view(task, ROWS.pose * LANES)
    x = view(pose, n_pose * LANES)
    u = view(x, nx)
    move(pose, before, after, parameters[HEAD.dt], view(parameters, int(parameters[HEAD.of_motion])))
    lowest, share, two = own[OWN.lowest], own[OWN.share], own[OWN.two]
    for lane in range(LANES):
        for i in range(nx):
            x[i] = before[i * LANES + lane]
        for j in range(nu):
            u[j] = control[j * LANES + lane]
        if two > 0.0:
            for i in range(nx):
                u[nu + i] = after[i * LANES + lane]
        reward = worth(x, u)
        task[lane] += share * (reward if reward >= lowest else lowest)
        for i in range(nx):
            x[i] = after[i * LANES + lane]
        if over(x, u):
            task[ROWS.alive * LANES + lane] = 0.0


def never(x, u):
    """No trial ends before the horizon."""
    return 0.0
