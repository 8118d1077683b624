"""The base class of controllers, families of control laws with a parameter vector; lookup of channels by name."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

import numpy as np

from sysid_evo.angles import TURN
from sysid_evo.controllers.program import SYMBOLS, Operand, Program, elements, observation, program_of, remembered
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.kernels import ControllerKernel
from sysid_evo.laws import ROLLOUTS, ScalarLaw, read, together
from sysid_evo.registry.grammar import Spec
from sysid_evo.registry.registry import controllers
from sysid_evo.system import Channel
from sysid_evo.tasks.task import Task, TaskState
from sysid_evo.types import Array, check_shape


@dataclass(frozen=True)
class View:
    """The inputs of a controller, for P candidates in E trials.

    ``observation`` (P, E, n_observations); ``state`` (P, E, nx); ``task_state`` with P E trials,
    candidate first; ``noise`` (P, E, n_noise) standard normal numbers, the same for all candidates in a
    trial, or None if ``n_noise`` is 0.
    """

    observation: Array
    state: Array
    task_state: TaskState
    noise: Array | None = None


class Controller(ABC):
    """Base class of control laws with ``n_parameters`` parameters and ``n_memory`` numbers of memory.

    Batched over parameter vectors: P candidates act in E trials at once. Memory starts at zero.
    ``n_noise`` standard normal numbers are passed to every `act`, never drawn inside; such a controller
    runs in NumPy. A controller with ``is_baseline`` drives with zeros as parameters and needs no evolution.

    A class defines `act` and one of `bind` and `bind_to`; a `LawController` sets its law there instead of `act`.
    """

    is_baseline: ClassVar[bool] = False
    not_exportable: ClassVar[str] = "it has no `program`"
    """Reason why the controller cannot be exported, if `program` returns None."""

    n_parameters: int
    n_memory: int
    n_noise: int = 0

    def bind(self, n_observations: int, n_outputs: int) -> Self:
        """Return this controller with these numbers of inputs and outputs, regardless of their meaning.

        Raises `InvalidArgument` for a controller that depends on their meaning.
        """
        raise InvalidArgument(f"{type(self).__name__} depends on the names of a task's channels: use bind_to(task)")

    def bind_to(self, task: Task) -> Self:
        """Return this controller for ``task``, which is bound to a system.

        The default only uses the numbers of observations and controls; a controller that uses their names, or that
        looks ahead, overrides it. Raises `IncompatibleTask` if the controller does not fit the task.
        """
        return self.bind(len(task.observations), task.system.nu)

    @abstractmethod
    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        """Return outputs in [-1, 1], (P, E, n_outputs), and the new memory (P, E, n_memory).

        ``parameters`` is (P, n_parameters), ``memory`` (P, E, n_memory).
        """

    def first_steps(self, sizes: Array) -> Array:
        """Return the relative step sizes (n_parameters,) in which a search of a bound controller begins.

        ``sizes`` (n_observations,) are those of `Task.observation_sizes`: weights of a large one are small. By default
        all are 1.
        """
        return np.ones(self.n_parameters)

    def kernel(self) -> ControllerKernel | None:
        """Return the compiled form of `act` of a bound controller, if it has one."""
        return None

    def program(self, parameters: Array) -> Program | None:
        """Return `act` of a bound controller with these parameters (n_parameters,) as a program, for export.

        None if it cannot be expressed as a `Program`.
        """
        return None


@dataclass(frozen=True)
class ControllerLaw:
    """A control law for one rollout, see `sysid_evo.laws`, and the ``parameters`` that all candidates share.

    ``function(theta, memory, observation, raw, parameters, scratch)`` writes to ``raw`` and ``memory``; ``scratch``
    holds ``n_scratch`` numbers. ``width`` as for `ScalarLaw`.
    """

    function: Callable[..., None]
    parameters: Array
    n_scratch: int = 0
    width: Literal["quarter", "row"] = "quarter"


class LawController(Controller):
    """A controller whose `act`, `kernel` and `program` are one ``law``, which a class sets when it is bound."""

    law: ControllerLaw
    n_observations: int
    n_outputs: int
    n_memory = 0

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        check_shape("parameters", parameters, (None, self.n_parameters))
        grid = view.observation.shape[:2]
        remembered, seen = (list(np.moveaxis(array, -1, 0)) for array in (memory, view.observation))
        raw, scratch = [0.0] * self.n_outputs, [0.0] * self.law.n_scratch
        law = read(self.law.function, ROLLOUTS)
        law(list(parameters.T[:, :, None]), remembered, seen, raw, self.law.parameters.tolist(), scratch)
        return together(raw, grid), together(remembered, grid)

    def kernel(self) -> ControllerKernel:
        source = ScalarLaw(self.law.function, rows=LAW_ROWS, width=self.law.width)
        return ControllerKernel(source, self.law.parameters, self.law.n_scratch)

    def program(self, parameters: Array) -> Program:
        check_shape("parameters", parameters, (self.n_parameters,))
        raw: list[Operand] = [0.0] * self.n_outputs
        seen, before = elements(observation(self.n_observations)), elements(remembered(MEMORY, self.n_memory))
        after, scratch = list(before), [0.0] * self.law.n_scratch
        law = read(self.law.function, SYMBOLS)
        law(parameters.tolist(), after, seen, raw, self.law.parameters.tolist(), scratch)
        return program_of(raw, {MEMORY: after} if after else {})


LAW_ROWS = ("theta", "memory", "observation", "raw", "scratch")
MEMORY = "memory"


def observation_indices(what: str, names: Sequence[str], task: Task) -> tuple[int, ...]:
    """Return the indices of ``names`` among the observations of ``task``. Raises `IncompatibleTask`."""
    return _places(f"{what}: the task has no observation", names, task.observations)


def control_indices(what: str, names: Sequence[str], task: Task) -> tuple[int, ...]:
    """Return the indices of ``names`` among the controls of the system of ``task``. Raises `IncompatibleTask`."""
    return _places(f"{what}: the system has no control", names, task.system.controls)


def _places(what: str, names: Sequence[str], channels: Sequence[Channel]) -> tuple[int, ...]:
    known = [channel.name for channel in channels]
    for name in names:
        if name not in known:
            raise IncompatibleTask(f"{what} {name!r}; there are {', '.join(known)}")
    return tuple(known.index(name) for name in names)


def channel_scale(channel: Channel) -> float:
    """Return the size of the values of ``channel``: the larger of its limits, half a period, or 1 of its unit."""
    if channel.period is not None:
        return channel.period / 2.0
    return max(abs(channel.low), abs(channel.high)) if channel.bounded else 1.0


def channel_period(channel: Channel) -> float | None:
    """Return the period of ``channel``, also of an angle that is observed within one turn; None for all others."""
    if channel.period is None and channel.unit == "rad" and math.isclose(channel.high - channel.low, TURN):
        return TURN
    return channel.period


def make_controller(spec: str | Spec, /, **parameters: Any) -> Controller:
    """Return the controller that ``spec`` names, with its parameters and ``parameters``; see `Registry.make`."""
    made: Controller = controllers.make(spec, **parameters)
    return made
