"""Trials under controls that are known beforehand, in NumPy and compiled (for planning)."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from sysid_evo.carry import clip_state
from sysid_evo.engine.compiled import loops
from sysid_evo.engine.compiled.compiler import compiled, compiled_loop
from sysid_evo.engine.compiled.workspace import aligned, bounds_table, empty_lines
from sysid_evo.kernels import ADVANCE, DYNAMICS, LANES, DynamicsKernel, Precision, TaskKernel
from sysid_evo.models.dynamics import Dynamics, enough
from sysid_evo.processors import Engine, resolve
from sysid_evo.tasks.task import Task, TaskState
from sysid_evo.types import Array, BoolArray


class ImaginedTrials:
    """Runs trials of a bound ``task`` in ``dynamics``, from where they stand, without noise.

    ``engine`` is "float32" or "float64" (both kernels compiled) or "reference" (NumPy); "auto" takes the lowest
    precision that the model allows where there are kernels, unless `SYSID_EVO_ENGINE` names the reference. The scores
    are the same to rounding.
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
        scores = task.fitness(reached) + task.potential(reached, state)
        return np.where(lost, task.worst - 1.0, scores).reshape(count, trials)

    @cached_property
    def compiled(self) -> CompiledImagined | None:
        """The compiled form; None if it is not wanted, or the model or the task has none."""
        engine = resolve(self.engine)
        if engine == "reference":
            return None
        of_dynamics, of_task, state_bounds = self.dynamics.kernel(), self.task.kernel(), self.dynamics.state_bounds
        if of_dynamics is None or of_task is None:
            return None
        precision = enough(of_dynamics.precision, state_bounds) if engine == "auto" else engine
        return CompiledImagined(
            of_dynamics, of_task, bounds_table(state_bounds, self.dynamics.system.nx, precision), precision
        )

    def _run(self, carry: Array, legal: Array, here: TaskState) -> tuple[TaskState, Array, BoolArray]:
        """Return what `CompiledImagined.run` does, in NumPy."""
        dynamics, nx, (count, trials, steps, nu) = self.dynamics, self.dynamics.system.nx, legal.shape
        legal = legal.reshape(count * trials, steps, nu)
        carry, here = np.tile(carry, (count, 1)), here.tile(count)
        lost = np.zeros(len(carry), dtype=bool)
        with np.errstate(all="ignore"):
            for k in range(steps):
                before, going = carry[:, :nx], here.alive
                stepped = dynamics.step(carry, legal[:, k])
                lost |= going & ~np.isfinite(stepped).all(axis=1)
                stepped, _ = clip_state(np.where(lost[:, None], 0.0, stepped), dynamics.state_bounds)
                predicted = stepped[:, :nx]
                advanced, after = self.task.advance(here, before, predicted, control=legal[:, k])
                if after is not predicted:
                    stepped = np.concatenate([after, stepped[:, nx:]], axis=1)
                here = advanced if going.all() else here.updated_where(advanced, going)
                carry = stepped if going.all() else np.where(going[:, None], stepped, carry)
        return here, carry[:, :nx], lost


class CompiledImagined:
    """The kernels of a dynamics and of a bound task, ready to run trials that are only imagined."""

    def __init__(
        self, dynamics: DynamicsKernel, task: TaskKernel[Any], state_bounds: Array, precision: Precision
    ) -> None:
        self.task, self.n_scratch, self.precision = task, dynamics.n_scratch, precision
        self.functions = {
            "dynamics": compiled(dynamics.source, DYNAMICS, precision),
            "advance": compiled(task.advance, ADVANCE, precision),
        }
        self.tables = {
            "dynamics_parameters": aligned(dynamics.parameters, precision),
            "task_parameters": aligned(task.parameters, precision),
            "state_bounds": aligned(state_bounds, precision),
        }

    def run(
        self, carry: Array, controls: Array, task_state: TaskState, *, nx: int, n_noise: int
    ) -> tuple[TaskState, Array, BoolArray]:
        """Return where K sequences of ``controls`` (K, B, steps, nu) lead from B carries (B, n_carry), K B of each.

        These are the task's state, the state (K B, nx), and whether it was lost on the way, not being finite.
        """
        real, (count, trials, steps, nu) = np.dtype(self.precision), controls.shape
        rows, data = self.task.rows(task_state), self.task.trial_data(task_state)
        rollouts, n_carry, n_task = count * trials, carry.shape[1], len(rows)
        sizes = loops.IMAGINED.integers(
            trials=trials,
            of_data=len(data),
            steps=steps,
            n_carry=n_carry,
            nx=nx,
            nu=nu,
            n_task=n_task,
            rollouts=rollouts,
        )
        given = {"start": carry, "task_start": rows.T, "trial_data": data, "controls": controls}
        room = {
            "carry": n_carry, "control": nu, "noise": n_noise, "before": nx, "task": n_task, "kept": n_carry + n_task,
            "scratch": self.n_scratch,
        }  # fmt: skip
        shared = {**self.tables, **{name: aligned(array, real) for name, array in given.items()}}
        work = {name: empty_lines(n * LANES, real) for name, n in room.items()}
        lost = np.zeros(rollouts, np.int64)
        state, final = np.zeros(rollouts * nx, real), np.zeros(rollouts * n_task, real)
        compiled_loop(loops.imagine, loops.IMAGINE, self.precision)(
            *loops.IMAGINE.ordered(
                **self.functions,
                sizes=sizes,
                shared=loops.IMAGINED_SHARED.chosen(shared),
                work=loops.IMAGINED_WORK.chosen(work),
                trials=np.zeros(LANES, np.int64),
                final_state=state,
                final_task=final,
                lost_of=lost,
            )
        )
        last = final.reshape(rollouts, n_task).T.astype(np.float64)
        return self.task.state(task_state.tile(count), last), state.reshape(rollouts, nx).astype(np.float64), lost > 0
