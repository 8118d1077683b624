"""A controller with noise on its commands, under which a robot is recorded."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Self

import numpy as np

from sysid_evo.controllers.controller import Controller, View
from sysid_evo.errors import InvalidArgument
from sysid_evo.tasks.task import Task
from sysid_evo.types import Array, BoolArray


class Exploring(Controller):
    """``inner`` with independent noise on every command in every step.

    Under a controller alone, commands are a function of the states, so that a model cannot separate their effects. To a
    continuous control noise is added, with ``noise`` times half its range as standard deviation. A control with levels
    is replaced by a random one in a share ``noise`` of the steps. Raises `InvalidArgument`.
    """

    has_levels: BoolArray

    def __init__(self, inner: Controller, noise: float) -> None:
        if not 0.0 <= noise <= 1.0:
            raise InvalidArgument(f"command noise: expected a number from 0 to 1, got {noise}")
        self.inner, self.noise = inner, noise

    def bind_to(self, task: Task) -> Self:
        bound = copy.copy(self)
        bound.inner = self.inner.bind_to(task)
        bound.n_parameters, bound.n_memory = bound.inner.n_parameters, bound.inner.n_memory
        bound.n_noise = bound.inner.n_noise + task.system.nu
        bound.has_levels = np.array([channel.levels is not None for channel in task.system.controls], dtype=bool)
        return bound

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        from scipy.special import ndtr

        assert view.noise is not None
        of_inner, own = np.split(view.noise, [self.inner.n_noise], axis=-1)
        raw, memory = self.inner.act(parameters, memory, replace(view, noise=of_inner if of_inner.size else None))
        share = ndtr(own)  # uniform in [0, 1]
        with np.errstate(all="ignore"):
            drawn = np.where(share < self.noise, 2.0 * share / self.noise - 1.0, raw)
        return np.where(self.has_levels, drawn, np.clip(raw + self.noise * own, -1.0, 1.0)), memory
