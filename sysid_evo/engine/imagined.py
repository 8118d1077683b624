"""Trials under given control sequences, in NumPy and compiled (for planning)."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from sysid_evo.carry import clip_state, latest
from sysid_evo.engine.compiled import loops
from sysid_evo.engine.compiled.compiler import compiled, compiled_loop
from sysid_evo.engine.compiled.workspace import aligned, bounds_table, empty_lines
from sysid_evo.kernels import ADVANCE, DYNAMICS, LANES, DynamicsKernel, Precision, TaskKernel
from sysid_evo.models.dynamics import Dynamics, enough
from sysid_evo.processors import Engine, resolve
from sysid_evo.tasks.task import Task, TaskState
from sysid_evo.types import Array, BoolArray


class ImaginedTrials:
    """Simulation of trials of a bound ``task`` in ``dynamics``, from their current state, without noise.

    ``engine`` is "float32" or "float64" (both kernels compiled), "reference" (NumPy), or "auto": the lowest precision
    that the model allows if there are kernels, unless `SYSID_EVO_ENGINE` selects the reference.
    """

    def __init__(self, dynamics: Dynamics, task: Task, *, engine: Engine = "auto") -> None:
        self.dynamics, self.task, self.engine = dynamics, task, engine

    def scores(self, states: Array, controls: Array, sequences: Array, task_state: TaskState) -> Array:
        """Return fitness plus potential at the end of every sequence, (K, B).

        ``states`` (B, L + 1, nx) and ``controls`` (B, L, nu) are the history of B trials; the model uses its last
        samples, and a shorter one is padded, see `latest`. ``sequences`` (K, B, steps, nu) are outputs in [-1, 1];
        ``task_state`` has B trials.
        """
        dynamics, task = self.dynamics, self.task
        count, trials, steps, _ = sequences.shape
        legal = task.system.actuate(sequences)
        draws = np.zeros((trials, dynamics.n_draws))
        carry = dynamics.start(*latest(states, controls, dynamics.n_lags, task.system.neutral_control), draws)
        if self.compiled is None or steps > task.horizon:  # a task's data are as long as its trials
            reached, state, diverged = self._run(carry, legal, task_state)
        else:
            sizes = {"nx": dynamics.system.nx, "n_noise": dynamics.n_noise}
            reached, state, diverged = self.compiled.run(carry, legal, task_state, **sizes)
        scores = task.fitness(reached) + task.potential(reached, state)
        return np.where(diverged, task.worst - 1.0, scores).reshape(count, trials)

    @cached_property
    def compiled(self) -> CompiledImagined | None:
        """The compiled form; None for the reference engine, or if the model or the task has no kernel."""
        engine = resolve(self.engine)
        if engine == "reference":
            return None
        dynamics_kernel, task_kernel = self.dynamics.kernel(), self.task.kernel()
        state_bounds, nx = self.dynamics.state_bounds, self.dynamics.system.nx
        if dynamics_kernel is None or task_kernel is None:
            return None
        precision = enough(dynamics_kernel.precision, state_bounds) if engine == "auto" else engine
        return CompiledImagined(dynamics_kernel, task_kernel, bounds_table(state_bounds, nx, precision), precision)

    def _run(self, carry: Array, legal: Array, task_state: TaskState) -> tuple[TaskState, Array, BoolArray]:
        """Return the results of `CompiledImagined.run`, in NumPy."""
        dynamics, nx, (count, trials, steps, nu) = self.dynamics, self.dynamics.system.nx, legal.shape
        legal = legal.reshape(count * trials, steps, nu)
        carry, task_state = np.tile(carry, (count, 1)), task_state.tile(count)
        diverged = np.zeros(len(carry), dtype=bool)
        with np.errstate(all="ignore"):
            for k in range(steps):
                before, alive = carry[:, :nx], task_state.alive
                stepped = dynamics.step(carry, legal[:, k])
                diverged |= alive & ~np.isfinite(stepped).all(axis=1)
                stepped, _ = clip_state(np.where(diverged[:, None], 0.0, stepped), dynamics.state_bounds)
                predicted = stepped[:, :nx]
                advanced, after = self.task.advance(task_state, before, predicted, control=legal[:, k])
                if after is not predicted:
                    stepped = np.concatenate([after, stepped[:, nx:]], axis=1)
                task_state = advanced if alive.all() else task_state.updated_where(advanced, alive)
                carry = stepped if alive.all() else np.where(alive[:, None], stepped, carry)
        return task_state, carry[:, :nx], diverged


class CompiledImagined:
    """The compiled kernels of a dynamics and of a bound task, for trials under given control sequences."""

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
        """Return the results of K sequences of ``controls`` (K, B, steps, nu) from B carries (B, n_carry).

        These are the task's state of K B trials, the final states (K B, nx), and whether each trial diverged (K B,).
        """
        real, (count, trials, steps, nu) = np.dtype(self.precision), controls.shape
        rows, data = self.task.rows(task_state), self.task.trial_data(task_state)
        rollouts, n_carry, n_task = count * trials, carry.shape[1], len(rows)
        sizes = loops.IMAGINED.integers(
            trials=trials,
            n_data=len(data),
            steps=steps,
            n_carry=n_carry,
            nx=nx,
            nu=nu,
            n_task=n_task,
            rollouts=rollouts,
        )
        given = {"start": carry, "task_start": rows.T, "trial_data": data, "controls": controls}
        lengths = {
            "carry": n_carry, "control": nu, "noise": n_noise, "before": nx, "task": n_task,
            "snapshot": n_carry + n_task, "scratch": self.n_scratch,
        }  # fmt: skip
        shared = {**self.tables, **{name: aligned(array, real) for name, array in given.items()}}
        work = {name: empty_lines(n * LANES, real) for name, n in lengths.items()}
        diverged = np.zeros(rollouts, np.int64)
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
                diverged_of=diverged,
            )
        )
        last = final.reshape(rollouts, n_task).T.astype(np.float64)
        final_states = state.reshape(rollouts, nx).astype(np.float64)
        return self.task.state(task_state.tile(count), last), final_states, diverged > 0
