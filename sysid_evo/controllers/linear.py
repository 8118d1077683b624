"""Linear feedback of the observations, constant controls, random commands, and noise on the commands of another."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np

from sysid_evo.controllers.controller import Controller, ControllerLaw, LawController, View, observation_indices
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import Layout
from sysid_evo.registry.registry import register_controller
from sysid_evo.tasks.task import Task
from sysid_evo.types import Array, BoolArray


@register_controller("linear")
class LinearFeedback(LawController):
    """y = W o + b, limited to [-1, 1]: state feedback if the task observes the state.

    ``inputs`` names the observations to use, by default all. The parameters are W (inputs, n_outputs), row
    by row, and then b (n_outputs,).
    """

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
        return self._sized(len(task.observations), observation_indices("linear", names, task), task.system.nu)

    places: tuple[int, ...]

    def first_steps(self, sizes: Array) -> Array:
        return 1.0 / np.repeat([*sizes[list(self.places)], 1.0], self.n_outputs)

    def _sized(self, n_observations: int, places: tuple[int, ...], n_outputs: int) -> Self:
        bound = copy.copy(self)
        bound.n_observations, bound.n_outputs = n_observations, n_outputs
        bound.n_parameters, bound.places = (len(places) + 1) * n_outputs, places
        shared = LINEAR_HEAD.pack(places, n_inputs=len(places), n_outputs=n_outputs)
        bound.law = ControllerLaw(linear, shared, width="row")
        return bound


LINEAR_HEAD = Layout("n_inputs", "n_outputs")


def linear(theta, memory, observation, raw, parameters, scratch):
    """y = W o + b within [-1, 1], see `LinearFeedback`."""
    n_inputs, n_outputs = int(parameters[LINEAR_HEAD.n_inputs]), int(parameters[LINEAR_HEAD.n_outputs])
    for j in range(n_outputs):
        total = theta[n_inputs * n_outputs + j]
        for i in range(n_inputs):
            total += theta[i * n_outputs + j] * observation[int(parameters[LINEAR_HEAD.size + i])]
        raw[j] = min(max(total, -1.0), 1.0)


@register_controller("constant")
class Constant(LawController):
    """y = y_0 + b, limited to [-1, 1]: y_0 gives every control its neutral value, or the level nearest to it.

    The parameters are b (n_outputs,). With zeros all controls are neutral.
    """

    is_baseline: ClassVar[bool] = True

    def bind_to(self, task: Task) -> Self:
        bound = copy.copy(self)
        neutral = task.system.raw_output(task.system.neutral_control)
        bound.n_observations, bound.n_outputs = len(task.observations), task.system.nu
        bound.n_parameters = task.system.nu
        bound.law = ControllerLaw(constant, CONSTANT_HEAD.pack(neutral, n_outputs=len(neutral)), width="row")
        return bound


CONSTANT_HEAD = Layout("n_outputs")


def constant(theta, memory, observation, raw, parameters, scratch):
    """y = y_0 + b within [-1, 1], see `Constant`."""
    for i in range(int(parameters[CONSTANT_HEAD.n_outputs])):
        raw[i] = min(max(parameters[CONSTANT_HEAD.size + i] + theta[i], -1.0), 1.0)


@register_controller("random")
class RandomCommands(Controller):
    """Independent commands in every step, uniform over the range of each control; no parameters, never evolved."""

    is_baseline: ClassVar[bool] = True
    not_exportable: ClassVar[str] = "its commands are random"
    n_parameters = n_memory = 0

    def bind(self, n_observations: int, n_outputs: int) -> Self:
        bound = copy.copy(self)
        bound.n_noise = n_outputs
        return bound

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        from scipy.special import ndtr

        assert view.noise is not None
        shape = (*view.observation.shape[:2], self.n_noise)
        return np.broadcast_to(2.0 * ndtr(view.noise) - 1.0, shape), memory


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
