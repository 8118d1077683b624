"""Dynamics, a task and a controller small enough to follow by hand, and the paper's network as a scalar loop."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sysid_evo.controllers import Controller, View
from sysid_evo.models import Dynamics
from sysid_evo.system import Channel, System
from sysid_evo.tasks import Task, TaskState
from sysid_evo.types import Array, IntArray, Seeds


class Climber(Dynamics):
    """x' = x + u + noise; a height above ``breaks_above`` is infinite."""

    n_carry = 1

    def __init__(
        self, system: System, *, breaks_above: float = np.inf, envelope: Array | None = None, n_noise: int = 0
    ) -> None:
        self.system, self.breaks_above, self.n_noise = system, breaks_above, n_noise
        self._envelope = envelope

    @property
    def envelope(self) -> Array | None:
        return self._envelope

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return states[:, -1].copy()

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        after = carry + control + (0.0 if noise is None else noise.sum(axis=1, keepdims=True))
        return np.where(after > self.breaks_above, np.inf, after)


class Echo(Dynamics):
    """x' = 10 u two samples ago + x two samples ago; the carry holds states, then controls, newest first."""

    n_carry = 5
    n_lags = 2

    def __init__(self, system: System) -> None:
        self.system = system

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return np.concatenate([states[:, ::-1, 0], controls[:, ::-1, 0]], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        now, before, oldest, u1, u2 = carry.T
        return np.stack([10.0 * u2 + oldest, now, before, control[:, 0], u1], axis=1)


class SluggishCar(Dynamics):
    """A car whose drive acts one sample late, scaled by a battery drawn for each trial, with noise."""

    n_carry = 5
    n_lags = 1
    n_noise = 2
    n_draws = 1

    def __init__(self, system: System) -> None:
        self.system = system

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        assert draws is not None
        return np.concatenate([states[:, -1], controls[:, -1, :1], 1.0 + 0.1 * draws], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        assert noise is not None
        u, v, r, drive, battery = carry.T
        dt = self.system.dt
        return np.stack(
            [
                u + dt * (4.0 * battery * drive - u) + 0.01 * noise[:, 0],
                0.8 * v + 0.02 * r,
                r + dt * (5.0 * u * control[:, 1] - 2.0 * r) + 0.02 * noise[:, 1],
                control[:, 0],
                battery,
            ],
            axis=1,
        )


class Constant(Controller):
    """The outputs are the parameters."""

    n_memory = 0

    def bind(self, n_observations: int, n_outputs: int) -> Self:
        bound = copy.copy(self)
        bound.n_parameters = n_outputs
        return bound

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        trials = view.observation.shape[1]
        return np.repeat(parameters[:, None], trials, axis=1), memory


class Restless(Constant):
    """The outputs are the parameters plus a tenth of noise."""

    n_noise = 1

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        raw, memory = super().act(parameters, memory, view)
        assert view.noise is not None
        return raw + 0.1 * view.noise, memory


@dataclass(frozen=True)
class LadderState(TaskState):
    """``steps`` (B,) counts how often each trial was advanced."""

    steps: IntArray


class Ladder(Task):
    """Fitness is the number of steps; a trial is over above ``top``, and ``ceiling`` stops a climber.

    The height at the start is the last digit of the seed.
    """

    observations = (Channel("height", "m"),)
    worst = 0.0

    def __init__(self, *, horizon: int = 10, top: float = np.inf, ceiling: float = np.inf) -> None:
        self.horizon, self.top, self.ceiling = horizon, top, ceiling

    def check_system(self, system: System) -> None:
        assert system.nx == 1

    def begin(self, seeds: Seeds) -> LadderState:
        trials = len(seeds)
        start = np.array([[float(seed % np.uint64(10))] for seed in seeds])
        return LadderState(start, np.empty((trials, 0)), np.ones(trials, dtype=bool), np.zeros(trials, dtype=np.int64))

    def observe(self, task_state: TaskState, state: Array) -> Array:
        return state

    def advance(
        self, task_state: TaskState, before: Array, after: Array, *, control: Array, pose: Array | None = None
    ) -> tuple[TaskState, Array]:
        assert isinstance(task_state, LadderState)
        after = np.minimum(after, self.ceiling)
        return replace(task_state, alive=after[:, 0] <= self.top, steps=task_state.steps + 1), after

    def fitness(self, task_state: TaskState) -> Array:
        assert isinstance(task_state, LadderState)
        return task_state.steps.astype(np.float64)


def network_by_hand(parameters: Array, observations: Array, hidden: int, outputs: int) -> list[list[float]]:
    """The outputs of one network for one sequence of observations (K, inputs)."""
    inputs = observations.shape[1]
    memory = [0.0] * hidden
    result = []
    for observation in observations:
        sums = [0.0] * hidden
        for j in range(hidden):
            for i in range(inputs):
                sums[j] += observation[i] * parameters[i * hidden + j]
            for i in range(hidden):
                sums[j] += memory[i] * parameters[(inputs + i) * hidden + j]
        memory = [math.tanh(value) for value in sums]
        first = (inputs + hidden) * hidden
        result.append(
            [
                math.tanh(sum(memory[i] * parameters[first + i * outputs + o] for i in range(hidden)))
                for o in range(outputs)
            ]
        )
    return result
