"""Linear feedback of what the task shows, and controls that never change."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import ClassVar, Self

import numpy as np

from sysid_evo.controllers.controller import Controller, View, observed
from sysid_evo.controllers.program import Program, Statement, constant, dot, limited, observation, take
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import LANES, ControllerKernel, KernelSource, Layout, load, store
from sysid_evo.registry.registry import register_controller
from sysid_evo.tasks.task import Task
from sysid_evo.types import Array, check_shape


@register_controller("linear")
class LinearFeedback(Controller):
    """y = W o + b, limited to [-1, 1]: state feedback where the task shows the state.

    ``inputs`` names the observations that count, by default all. The parameters are W (inputs, n_outputs), row
    by row, and then b (n_outputs,).
    """

    n_memory = 0

    def __init__(self, *, inputs: str | Sequence[str] = ()) -> None:
        self.inputs = (inputs,) if isinstance(inputs, str) else tuple(inputs)
        if len(set(self.inputs)) < len(self.inputs):
            raise InvalidArgument(f"linear: expected different inputs, got {', '.join(self.inputs)}")

    def bind(self, n_observations: int, n_outputs: int) -> Self:
        if self.inputs:
            return super().bind(n_observations, n_outputs)
        return self._sized(n_observations, tuple(range(n_observations)), n_outputs)

    def bind_to(self, task: Task) -> Self:
        names = self.inputs or [channel.name for channel in task.observations]
        return self._sized(len(task.observations), observed("linear", names, task), task.system.nu)

    def _sized(self, n_observations: int, places: tuple[int, ...], n_outputs: int) -> Self:
        bound = copy.copy(self)
        bound.n_observations, bound.places, bound.n_outputs = n_observations, places, n_outputs
        bound.n_parameters = (len(places) + 1) * n_outputs
        return bound

    n_observations: int
    places: tuple[int, ...]
    n_outputs: int

    def weights(self, parameters: Array) -> tuple[Array, Array]:
        """Return W (P, inputs, n_outputs) and b (P, 1, n_outputs)."""
        check_shape("parameters", parameters, (None, self.n_parameters))
        table = parameters.reshape(len(parameters), len(self.places) + 1, self.n_outputs)
        return table[:, :-1], table[:, -1:]

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        weights, bias = self.weights(parameters)
        raw = view.observation[..., list(self.places)] @ weights + bias
        return np.clip(raw, -1.0, 1.0), memory.copy()

    def kernel(self) -> ControllerKernel:
        return ControllerKernel(
            KernelSource(linear_lanes),
            LINEAR_HEAD.pack(self.places, n_inputs=len(self.places), n_outputs=self.n_outputs),
        )

    def program(self, parameters: Array) -> Program:
        weights, bias = (part[0] for part in self.weights(parameters[None]))
        seen = Statement("seen", take("SEEN_AT", observation(self.n_observations), *self.places), "what counts")
        pushed = dot("W", weights.T, seen.value) + constant("B", bias[0])
        raw = Statement("raw", limited(pushed), "outputs in [-1, 1]")
        return Program((seen, raw), raw.value)


LINEAR_HEAD = Layout("n_inputs", "n_outputs")


def linear_lanes(theta, memory, observation, raw, parameters, scratch):
    """y = W o + b within [-1, 1], see `LinearFeedback`."""
    n_inputs, n_outputs = int(parameters[LINEAR_HEAD.n_inputs]), int(parameters[LINEAR_HEAD.n_outputs])
    for j in range(n_outputs):
        total = load(theta, (n_inputs * n_outputs + j) * LANES)
        for i in range(n_inputs):
            seen = load(observation, int(parameters[LINEAR_HEAD.size + i]) * LANES)
            total = total + load(theta, (i * n_outputs + j) * LANES) * seen
        store(raw, j * LANES, total)
    for i in range(n_outputs * LANES):
        raw[i] = min(max(raw[i], -1.0), 1.0)


@register_controller("constant")
class Constant(Controller):
    """y = y_0 + b, limited to [-1, 1]: y_0 gives every control its neutral value, of levels the nearest to it.

    The parameters are b (n_outputs,). With zeros it stays at rest.
    """

    hand_written: ClassVar[bool] = True
    n_memory = 0
    neutral: Array

    def bind_to(self, task: Task) -> Self:
        bound = copy.copy(self)
        bound.neutral = task.system.raw_of(task.system.neutral_control)
        bound.n_parameters = task.system.nu
        return bound

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        check_shape("parameters", parameters, (None, self.n_parameters))
        raw = np.clip(self.neutral + parameters, -1.0, 1.0)[:, None]
        return np.repeat(raw, view.observation.shape[1], axis=1), memory.copy()

    def kernel(self) -> ControllerKernel:
        return ControllerKernel(
            KernelSource(constant_lanes), CONSTANT_HEAD.pack(self.neutral, n_outputs=len(self.neutral))
        )


CONSTANT_HEAD = Layout("n_outputs")


def constant_lanes(theta, memory, observation, raw, parameters, scratch):
    """y = y_0 + b within [-1, 1], see `Constant`."""
    for row in range(int(parameters[CONSTANT_HEAD.n_outputs])):
        neutral = parameters[CONSTANT_HEAD.size + row]
        for lane in range(LANES):
            i = row * LANES + lane
            raw[i] = min(max(neutral + theta[i], -1.0), 1.0)
