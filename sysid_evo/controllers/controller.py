"""The contract of a controller: a family of control laws, one for each parameter vector."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Self

from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidArgument
from sysid_evo.tasks.task import Task, TaskState

if TYPE_CHECKING:
    from sysid_evo.export.program import Program
    from sysid_evo.kernels import ControllerKernel


@dataclass(frozen=True)
class View:
    """All that a controller may look at, for P candidates in E trials.

    ``observation`` (P, E, n_observations); ``state`` (P, E, nx); ``task_state`` with P E trials,
    candidate first; ``noise`` (P, E, n_noise) standard normal numbers, the same for all candidates in a
    trial, or None for a controller that wants none.
    """

    observation: Array
    state: Array
    task_state: TaskState
    noise: Array | None = None


class Controller(ABC):
    """A control law with ``n_parameters`` parameters and ``n_memory`` numbers of memory.

    Batched over parameter vectors: P candidates act in E trials at once. Memory starts at zero.
    ``n_noise`` standard normal numbers are given to every `act`, never drawn inside; such a controller
    runs in the reference form. A ``hand_written`` one drives with zeros as its parameters, so that it
    needs no evolution.

    A class writes `act` and one of `bind` and `bind_to`.
    """

    hand_written: ClassVar[bool] = False
    unwritten: ClassVar[str] = "it has no `program`"
    """Why it cannot be written in other languages, where `program` gives None."""

    n_parameters: int
    n_memory: int
    n_noise: int = 0

    def bind(self, n_observations: int, n_outputs: int) -> Self:
        """Return this controller with that many inputs and outputs, whatever they mean.

        Raises `InvalidArgument` for a controller that must know what they mean.
        """
        raise InvalidArgument(f"{type(self).__name__} goes by the names of a task's channels: use bind_to(task)")

    def bind_to(self, task: Task) -> Self:
        """Return this controller for ``task``, which is bound to a system.

        By default what counts is how many observations and controls there are; a controller that goes by
        their names, or that looks ahead, writes this one. Raises `IncompatibleTask` if it cannot do the task.
        """
        return self.bind(len(task.observations), task.system.nu)

    @abstractmethod
    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        """Return outputs in [-1, 1], (P, E, n_outputs), and the new memory (P, E, n_memory).

        ``parameters`` is (P, n_parameters), ``memory`` (P, E, n_memory).
        """

    def kernel(self) -> ControllerKernel | None:
        """Return the compiled form of `act` of a bound controller, if it has one."""
        return None

    def program(self, parameters: Array) -> Program | None:
        """Return `act` of a bound controller with these parameters (n_parameters,), to be written in other languages.

        None if it cannot be written as a `Program`.
        """
        return None
