"""Linear feedback of what the task shows."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import TYPE_CHECKING, Self

import numpy as np

from sysid_evo.arrays import Array, check_shape
from sysid_evo.controllers.controller import Controller, View
from sysid_evo.controllers.named import observed
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import register_controller
from sysid_evo.tasks.task import Task

if TYPE_CHECKING:
    from sysid_evo.export.program import Program
    from sysid_evo.kernels import ControllerKernel


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
        from sysid_evo.engine.kernels.linear_feedback import linear_feedback_kernel

        return linear_feedback_kernel(self.places, self.n_outputs)

    def program(self, parameters: Array) -> Program:
        from sysid_evo.export.program import Program, Statement, constant, dot, limited, observation, take

        weights, bias = (part[0] for part in self.weights(parameters[None]))
        seen = Statement("seen", take("SEEN_AT", observation(self.n_observations), *self.places), "what counts")
        pushed = dot("W", weights.T, seen.value) + constant("B", bias[0])
        raw = Statement("raw", limited(pushed), "outputs in [-1, 1]")
        return Program((seen, raw), raw.value)
