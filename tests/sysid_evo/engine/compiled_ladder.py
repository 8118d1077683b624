"""The made-up climber, its task and its controller with kernels."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Self

import numpy as np

from sysid_evo.kernels import LANES, ControllerKernel, DynamicsKernel, KernelSource, Lifted, TaskKernel
from sysid_evo.system import System
from sysid_evo.tasks import TaskState
from sysid_evo.types import Array, Seeds
from tests.fixtures.by_hand import Climber, Constant, Ladder, LadderState


def climb(x, u, w, p):
    after = x[0] + u[0] + w[0]
    return (p[0] / 0.0 if after > p[1] else after,)


class CompiledClimber(Climber):
    """`Climber` with one number of noise a step, and a lifted kernel."""

    def __init__(self, system: System, **keywords: Any) -> None:
        super().__init__(system, n_noise=1, **keywords)

    def kernel(self) -> DynamicsKernel:
        return DynamicsKernel(Lifted(climb, n_carry=1, nu=1, n_noise=1), np.array([1.0, self.breaks_above]))


def repeat(theta, memory, observation, raw, parameters, scratch):
    for i in range(int(parameters[0]) * LANES):
        raw[i] = theta[i]


class CompiledConstant(Constant):
    """`Constant` with its kernel; ``n_outputs`` controls."""

    def bind(self, n_observations: int, n_outputs: int) -> Self:
        bound = super().bind(n_observations, n_outputs)
        bound.n_outputs = n_outputs
        return bound

    n_outputs: int

    def kernel(self) -> ControllerKernel:
        return ControllerKernel(KernelSource(repeat), np.array([self.n_outputs]))


def observe(task, state, observation, parameters):
    for lane in range(LANES):
        observation[lane] = state[lane]


def advance(task, before, after, control, trials, trial_data, parameters):
    top, ceiling = parameters[0], parameters[1]
    for lane in range(LANES):
        after[lane] = min(after[lane], ceiling)
        task[LANES + lane] = 1.0 if after[lane] <= top else 0.0
        task[lane] += 1.0


class CompiledLadder(Ladder):
    """`Ladder` with its kernel: a trial ends above ``top``, a wall stands at ``ceiling``."""

    def kernel(self) -> TaskKernel:
        return TaskKernel(
            observe=KernelSource(observe),
            advance=KernelSource(advance),
            n_rows=2,
            rows=lambda began: np.stack([np.zeros(len(began.alive)), began.alive]),
            trial_data=lambda began: np.zeros((len(began.alive), 1)),
            state=_state,
            parameters=np.array([self.top, self.ceiling]),
        )


def _state(task_state: TaskState, rows: Array) -> TaskState:
    assert isinstance(task_state, LadderState)
    return replace(task_state, alive=rows[1] > 0, steps=rows[0].astype(np.int64))


def look_nowhere(task, state, observation, parameters):
    return


class BlindLadder(CompiledLadder):
    """A ladder that shows its controller nothing."""

    observations = ()

    def observe(self, task_state: TaskState, state: Array) -> Array:
        return np.empty((len(state), 0))

    def kernel(self) -> TaskKernel:
        return replace(super().kernel(), observe=KernelSource(look_nowhere))


def seeds_from(*heights: int) -> Seeds:
    """Return the seeds of trials that start at these heights."""
    return np.array(heights, dtype=np.uint64)
