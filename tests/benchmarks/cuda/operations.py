"""How many multiplications and additions a step of a closed loop takes: one rollout, run with numbers that count."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.controllers.controller import Controller
from sysid_evo.dynamics import Dynamics
from sysid_evo.engine.compiled.dialect import KernelSource, Target, generate_for, imported
from sysid_evo.engine.compiled.run import Kernels
from sysid_evo.engine.cuda import lanes, loop, program
from sysid_evo.engine.cuda.trials import prepare
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks.task import Task

HEADER = """\
# Written by tests.benchmarks.cuda.operations from {origin}, for {precision} and {functions}.
import math

from sysid_evo.engine.cuda.one_lane import *
from tests.benchmarks.cuda.operations import Counted as _real
from tests.benchmarks.cuda.operations import power_of_two, view

LANES = {lanes}
"""


class Counted(float):
    """A number that counts what is done with numbers of its kind."""

    done = 0

    def __add__(self, other: float) -> Counted:
        Counted.done += 1
        return Counted(float(self) + float(other))

    def __sub__(self, other: float) -> Counted:
        Counted.done += 1
        return Counted(float(self) - float(other))

    def __rsub__(self, other: float) -> Counted:
        Counted.done += 1
        return Counted(float(other) - float(self))

    def __mul__(self, other: float) -> Counted:
        Counted.done += 1
        return Counted(float(self) * float(other))

    __radd__, __rmul__ = __add__, __mul__

    def __truediv__(self, other: float) -> Counted:
        Counted.done += 1
        return Counted(np.divide(float(self), float(other)))

    def __rtruediv__(self, other: float) -> Counted:
        Counted.done += 1
        return Counted(np.divide(float(other), float(self)))

    def __neg__(self) -> Counted:
        return Counted(-float(self))

    def __abs__(self) -> Counted:
        return Counted(abs(float(self)))


class Numbers:
    """An array of numbers that count, or a view of one."""

    def __init__(self, values: Any, first: int = 0) -> None:
        self.values, self.first = values, first

    @classmethod
    def of(cls, array: Array) -> Numbers:
        """Return a copy, with room behind it that nobody looks at."""
        return cls([*(Counted(number) for number in np.ravel(array)), Counted(0.0)])

    def __getitem__(self, place: int) -> Any:
        return self.values[self.first + place]

    def __setitem__(self, place: int, number: Any) -> None:
        self.values[self.first + place] = number


def view(array: Numbers, first: int) -> Numbers:
    """Return ``array`` from element ``first`` on."""
    return Numbers(array.values, array.first + first)


def power_of_two(exponent: float) -> Counted:
    """Return 2 to the power of a whole number."""
    return Counted(math.ldexp(1.0, int(exponent)))


COUNTING = Target({"LANES": 1, "QUARTER": 1}, lanes.FUNCTIONS, HEADER, "")


def per_step(dynamics: Dynamics, controller: Controller, theta: Array, task: Task) -> float:
    """Return the multiplications, additions and divisions of a step, the mean of one rollout under ``theta`` (n,)."""
    task = task.bind(dynamics.system)
    controller = controller.bind_to(task)
    of_dynamics, of_controller, of_task = dynamics.kernel(), controller.kernel(), task.kernel()
    assert of_dynamics is not None
    assert of_controller is not None
    assert of_task is not None
    kernels = Kernels(of_dynamics, of_controller, of_task)
    given = prepare(kernels, dynamics, controller, task, trial_seeds(0, 1), "float32", record=False)
    source = KernelSource(loop.one_rollout, {**kernels.sources, **given.sizes})
    entry = imported(generate_for(COUNTING, source, "", "float32")).entry
    shared = {name: Numbers.of(array) for name, array in given.arrays.items()}
    own = {name: Numbers.of(np.zeros(count)) for name, count in given.room.items()}
    results = {name: Numbers.of(np.zeros(count)) for name, count in given.results.items()}
    numbers = {"rollout": 0, "rollouts": 1, "trial": 0, "trials_in_all": 1, "horizon": task.horizon}
    Counted.done = 0
    with np.errstate(all="ignore"):
        entry(
            *numbers.values(),
            *(shared[name] for name in program.GIVEN),
            Numbers.of(theta),
            *(shared[name] for name in program.ARRAYS),
            *(own[name] for name in program.OWN),
            [0],
            *(results[name] for name in program.RESULTS),
        )
    return Counted.done / max(1, int(results["survived"][0]))
