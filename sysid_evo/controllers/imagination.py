"""What a model makes of sequences of outputs at a task: trials that are only imagined."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from sysid_evo.arrays import Array, BoolArray
from sysid_evo.dynamics import Dynamics, clip_state
from sysid_evo.tasks.task import Task, TaskState

if TYPE_CHECKING:
    from sysid_evo.engine.compiled.imagined import CompiledTrials

Engine: TypeAlias = Literal["auto", "reference", "float32", "float64"]


class Imagination:
    """Runs trials of a bound ``task`` in ``dynamics``, from where they stand, without noise.

    ``engine`` is "float32" or "float64" (both kernels compiled) or "reference" (NumPy); "auto" takes the lowest
    precision that the model allows where there are kernels. The scores are the same to rounding.
    """

    def __init__(self, dynamics: Dynamics, task: Task, *, engine: Engine = "auto") -> None:
        self.dynamics, self.task, self.engine = dynamics, task, engine

    def scores(self, states: Array, controls: Array, sequences: Array, task_state: TaskState) -> Array:
        """Return fitness and promise at the end of every sequence, (K, B).

        ``states`` (B, L + 1, nx) and ``controls`` (B, L, nu) are the history of B trials, of which as much is used
        as the model wants; ``sequences`` (K, B, steps, nu) are outputs in [-1, 1]; ``task_state`` has B trials.
        """
        dynamics, task = self.dynamics, self.task
        count, trials, steps, _ = sequences.shape
        lags = dynamics.n_lags
        legal = task.system.actuate(sequences)
        draws = np.zeros((trials, dynamics.n_draws))
        carry = dynamics.start(states[:, len(states[0]) - lags - 1 :], controls[:, len(controls[0]) - lags :], draws)
        if self.compiled is None or steps > task.horizon:  # a task's data are as long as its trials
            reached, state, lost = self._run(carry, legal, task_state)
        else:
            reached, state, lost = self.compiled.run(
                carry, legal, task_state, nx=dynamics.system.nx, n_noise=dynamics.n_noise
            )
        scores = task.fitness(reached) + task.promise(reached, state)
        return np.where(lost, task.worst - 1.0, scores).reshape(count, trials)

    @cached_property
    def compiled(self) -> CompiledTrials | None:
        """The compiled form; None if it is not wanted, or the model or the task has none."""
        if self.engine == "reference":
            return None
        of_dynamics, of_task, envelope = self.dynamics.kernel(), self.task.kernel(), self.dynamics.envelope
        if of_dynamics is None or of_task is None:
            return None
        from sysid_evo.engine.compiled.imagined import CompiledTrials

        nx = self.dynamics.system.nx
        none = np.stack([np.full(nx, -np.inf), np.full(nx, np.inf)])
        precision = of_dynamics.precision if self.engine == "auto" else self.engine
        return CompiledTrials(of_dynamics, of_task, none if envelope is None else envelope, precision)

    def _run(self, carry: Array, legal: Array, here: TaskState) -> tuple[TaskState, Array, BoolArray]:
        """Return what `CompiledTrials.run` does, in NumPy."""
        dynamics, nx, (count, trials, steps, nu) = self.dynamics, self.dynamics.system.nx, legal.shape
        legal = legal.reshape(count * trials, steps, nu)
        carry, here = np.tile(carry, (count, 1)), here.tile(count)
        lost = np.zeros(len(carry), dtype=bool)
        with np.errstate(all="ignore"):
            for k in range(steps):
                before, going = carry[:, :nx], here.alive
                stepped = dynamics.step(carry, legal[:, k])
                lost |= going & ~np.isfinite(stepped).all(axis=1)
                stepped, _ = clip_state(np.where(lost[:, None], 0.0, stepped), dynamics.envelope)
                predicted = stepped[:, :nx]
                advanced, after = self.task.advance(here, before, predicted, control=legal[:, k])
                if after is not predicted:
                    stepped = np.concatenate([after, stepped[:, nx:]], axis=1)
                here = advanced if going.all() else here.keep(advanced, going)
                carry = stepped if going.all() else np.where(going[:, None], stepped, carry)
        return here, carry[:, :nx], lost
