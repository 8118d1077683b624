"""Controls that never change: at rest, where every other controller is measured from."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from sysid_evo.arrays import Array, check_shape
from sysid_evo.controllers.controller import Controller, View
from sysid_evo.registry import register_controller
from sysid_evo.tasks.task import Task

if TYPE_CHECKING:
    from sysid_evo.kernels import ControllerKernel


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
        from sysid_evo.engine.kernels.constant import constant_kernel

        return constant_kernel(self.neutral)
