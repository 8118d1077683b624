"""Imagined trials: a task in a dynamics under sequences of controls that are known beforehand, compiled."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from sysid_evo.arrays import Array, BoolArray
from sysid_evo.engine.compiled import loops
from sysid_evo.engine.compiled.dialect import compile_kernel
from sysid_evo.engine.compiled.memory import aligned, empty_lines
from sysid_evo.engine.compiled.run import compiled
from sysid_evo.engine.compiled.tables import envelope_table
from sysid_evo.kernels import ADVANCE, DYNAMICS, LANES, DynamicsKernel, KernelSource, Precision, TaskKernel
from sysid_evo.tasks.task import TaskState


@cache
def _loop(precision: Precision) -> Any:
    return compile_kernel(KernelSource(loops.imagine), loops.IMAGINE, precision, pointer=False)


class CompiledTrials:
    """The kernels of a dynamics and of a bound task, ready to run trials that are only imagined."""

    def __init__(self, dynamics: DynamicsKernel, task: TaskKernel[Any], envelope: Array, precision: Precision) -> None:
        self.task, self.n_scratch, self.precision = task, dynamics.n_scratch, precision
        self.shared = {
            "dynamics": compiled(dynamics.source, DYNAMICS, precision),
            "advance": compiled(task.advance, ADVANCE, precision),
            "dynamics_parameters": aligned(dynamics.parameters, precision),
            "task_parameters": aligned(task.parameters, precision),
            "envelope": aligned(envelope_table(envelope, envelope.shape[1], precision), precision),
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
        lost = np.zeros(rollouts, np.int64)
        state, final = np.zeros(rollouts * nx, real), np.zeros(rollouts * n_task, real)
        _loop(self.precision)(
            *loops.IMAGINE.ordered(
                sizes=sizes,
                trials=np.zeros(LANES, np.int64),
                lost_of=lost,
                final_state=state,
                final_task=final,
                **self.shared,
                **{name: aligned(array, real) for name, array in given.items()},
                **{name: empty_lines(n * LANES, real) for name, n in room.items()},
            )
        )
        last = final.reshape(rollouts, n_task).T.astype(np.float64)
        return self.task.state(task_state.tile(count), last), state.reshape(rollouts, nx).astype(np.float64), lost > 0
