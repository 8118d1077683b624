"""What an author hands over: a kernel function, its flat parameter array, and how much room it needs.

Arrays in kernels are one-dimensional, rows of 64 lanes one after the other: row i, lane l stands at
``i * LANES + l``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.engine.compiled.dialect import Precision, Source
from sysid_evo.engine.compiled.signature import REALS, WHOLES, Signature

if TYPE_CHECKING:
    from sysid_evo.tasks.task import TaskState

DYNAMICS = Signature(carry=REALS, control=REALS, noise=REALS, parameters=REALS, scratch=REALS)
"""Overwrite ``carry`` with the next one."""
CONTROLLER = Signature(theta=REALS, memory=REALS, observation=REALS, raw=REALS, parameters=REALS, scratch=REALS)
"""Write ``raw``, overwrite ``memory``."""
OBSERVE = Signature(task=REALS, state=REALS, observation=REALS, parameters=REALS)
"""Write ``observation``."""
ADVANCE = Signature(
    task=REALS, before=REALS, after=REALS, control=REALS, trials=WHOLES, trial_data=REALS, parameters=REALS
)
"""Overwrite ``task``, perhaps ``after``.

Row 0 of ``task`` is the fitness, row 1 is 1.0 while the trial is alive; ``trials`` (64,) is the trial
of each lane, whose data begin at ``trials[l] * len(trial_data) / E``.
"""


@dataclass(frozen=True)
class DynamicsKernel:
    """The compiled form of `Dynamics.step`; ``precision`` is the lowest one in which it is exact enough."""

    source: Source
    parameters: Array = field(default_factory=lambda: np.zeros(1))
    n_scratch: int = 0
    precision: Precision = "float32"

    def of_candidates(self, own: Array) -> Array:
        """Return the flat parameters (P, n) of this kernel for candidates whose predictors have ``own`` (P, m)."""
        shell = self.parameters[: len(self.parameters) - own.shape[1]]
        return np.concatenate([np.tile(shell, (len(own), 1)), own], axis=1)


@dataclass(frozen=True)
class ControllerKernel:
    """The compiled form of `Controller.act`.

    ``before_tanh`` says that ``raw`` is still to be squashed by tanh. The loop does that where a control is
    continuous; a switch at b is one at artanh b before it.
    """

    source: Source
    parameters: Array = field(default_factory=lambda: np.zeros(1))
    n_scratch: int = 0
    before_tanh: bool = False


@dataclass(frozen=True)
class TaskKernel:
    """The compiled form of a bound task.

    ``rows`` turns the state of E trials into task rows (n_rows, E); ``state`` turns the rows of B
    trials (n_rows, B), tiled from those, back. ``trial_data`` (E, n) is what advancing looks up.
    ``pose_row`` is the first of ``n_pose`` rows that hold the pose.
    """

    observe: Source
    advance: Source
    n_rows: int
    rows: Callable[[TaskState], Array]
    trial_data: Callable[[TaskState], Array]
    state: Callable[[TaskState, Array], TaskState]
    parameters: Array = field(default_factory=lambda: np.zeros(1))
    pose_row: int = 2
    n_pose: int = 0
