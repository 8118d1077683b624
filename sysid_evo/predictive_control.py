"""A controller that plans with a model, by path integrals (MPPI); trials under given control sequences."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from sysid_evo.carry import clip_state, latest
from sysid_evo.controllers.controller import Controller, View
from sysid_evo.controllers.inner_model import load_inner_model
from sysid_evo.engine.compiled import loops
from sysid_evo.engine.compiled.compiler import compiled, compiled_loop
from sysid_evo.engine.compiled.workspace import aligned, bounds_table, empty_lines
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import ADVANCE, DYNAMICS, LANES, DynamicsKernel, Precision, TaskKernel
from sysid_evo.models.dynamics import Dynamics, enough
from sysid_evo.processors import Engine, resolve
from sysid_evo.registry.registry import register_controller
from sysid_evo.tasks.task import Task, TaskState
from sysid_evo.types import Array, BoolArray, check_shape

LEVELS = np.array([1.0, 0.0, -1.0])
SETS = 8
"""Number of sets of random sequences; every step uses the next one."""


@register_controller("predictive")
class Predictive(Controller):
    """Model predictive path integral control (MPPI) with an internal model.

    At every step ``samples`` sequences of outputs over ``horizon`` steps are simulated and scored: the plan of the step
    before, each constant sequence of full and no output, and random variations of the plan, each held for ``hold``
    steps. The new plan is their mean, weighted by exp((score - best) / (temperature sigma)), where sigma is the
    standard deviation of the scores; its first outputs are applied. The score is the fitness of the task plus its
    `Task.potential`, without knowledge of the future (`Task.hide_future`).

    ``model`` is the file of a fitted model, the name of an emulated robot, a `Dynamics`, or a list of these; of
    several, the lowest score counts. The two parameters are the logarithms of the temperature and of the ``spread`` of
    the variations, relative to the given values; zeros change nothing. The random sequences depend on ``seed`` alone.
    Simulations run compiled if model and task have a compiled form, else in NumPy.

    Source: Williams, Aldrich and Theodorou, "Model Predictive Path Integral Control", J. Guidance 40 (2017).
    """

    is_baseline: ClassVar[bool] = True
    not_exportable: ClassVar[str] = (
        "it plans with a whole model at every sample. Evolve a network in that model and export it"
    )
    n_parameters = 2

    def __init__(
        self,
        *,
        model: str | Dynamics | Sequence[str | Dynamics],
        horizon: int = 30,
        samples: int = 64,
        temperature: float = 0.1,
        spread: float = 0.8,
        hold: int = 8,
        seed: int = 0,
    ) -> None:
        if horizon < 1 or samples < 2 or hold < 1 or not (0.0 < temperature < np.inf and 0.0 < spread < np.inf):
            raise InvalidArgument(
                "predictive: expected horizon, hold >= 1, samples >= 2, temperature, spread > 0, "
                f"got {horizon}, {hold}, {samples}, {temperature}, {spread}"
            )
        self.model, self.horizon, self.samples = model, horizon, samples
        self.temperature, self.spread, self.hold, self.seed = temperature, spread, hold, seed

    def bind_to(self, task: Task) -> Self:
        models = [self.model] if isinstance(self.model, (str, Dynamics)) else list(self.model)
        if not models:
            raise InvalidArgument("predictive: expected at least one model, got none")
        bound = copy.copy(self)
        bound.imagined = tuple(ImaginedTrials(load_inner_model("predictive", model, task), task) for model in models)
        bound.task, bound.n_lags = task, max(imagined.dynamics.n_lags for imagined in bound.imagined)
        system = task.system
        bound.n_memory = self.horizon * system.nu + 2 + bound.n_lags * (system.nx + system.nu)
        bound.constant, bound.random = self._sequences(system.nu)
        return bound

    task: Task
    imagined: tuple[ImaginedTrials, ...]
    n_lags: int
    constant: Array
    random: Array

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        check_shape("parameters", parameters, (None, self.n_parameters))
        system, grid = self.task.system, view.state.shape[:2]
        nu, size = system.nu, self.horizon * system.nu
        flat = memory.reshape(-1, self.n_memory)
        state = view.state.reshape(-1, system.nx)
        plan, steps = flat[:, :size].reshape(-1, self.horizon, nu), flat[:, size + 1]
        past_states, past_controls = self._past(flat[:, size:], state)
        temperature, spread = (
            np.repeat(made * np.exp(np.clip(logarithm, -5.0, 5.0)), grid[1])
            for made, logarithm in zip((self.temperature, self.spread), parameters.T, strict=True)
        )
        sequences = self._variations(plan, steps, spread)
        states = np.concatenate([past_states, state[:, None]], axis=1)
        known = self.task.hide_future(view.task_state)
        scores = np.min([one.scores(states, past_controls, sequences, known) for one in self.imagined], axis=0)
        better = scores - scores.max(axis=0)
        weights = np.exp(better / (temperature * scores.std(axis=0) + 1e-12))
        plan = np.einsum("kb,kbhu->bhu", weights / weights.sum(axis=0), sequences)
        raw = plan[:, 0]
        control = system.actuate(raw)
        kept_states = states[:, 1:]
        kept_controls = np.concatenate([past_controls, control[:, None]], axis=1)[:, 1:]
        later = np.concatenate([plan[:, 1:], plan[:, -1:]], axis=1)
        parts = (later, np.ones((len(flat), 1)), steps[:, None] + 1.0, kept_states, kept_controls)
        after = np.concatenate([part.reshape(len(flat), -1) for part in parts], axis=1)
        return raw.reshape(*grid, nu), after.reshape(memory.shape)

    def _past(self, rest: Array, state: Array) -> tuple[Array, Array]:
        """Return the last ``n_lags`` states and controls, (B, n_lags, nx) and (B, n_lags, nu), padded at first."""
        system, started = self.task.system, rest[:, 0] > 0.0
        cut = 2 + self.n_lags * system.nx
        states = rest[:, 2:cut].reshape(len(rest), self.n_lags, system.nx)
        controls = rest[:, cut:].reshape(len(rest), self.n_lags, system.nu)
        states = np.where(started[:, None, None], states, state[:, None])
        return states, np.where(started[:, None, None], controls, system.neutral_control)

    def _sequences(self, nu: int) -> tuple[Array, Array]:
        """Return constant sequences (k, horizon, nu) and sets of random ones (SETS, n, horizon, nu)."""
        corners = np.stack(np.meshgrid(*[LEVELS] * nu, indexing="ij"), axis=-1).reshape(-1, nu)
        if len(corners) > self.samples // 2:
            corners = np.repeat(LEVELS[:, None], nu, axis=1)[: self.samples // 2]
        constant = np.tile(corners[:, None], (1, self.horizon, 1))
        n, holds = self.samples - 1 - len(constant), -(-self.horizon // self.hold) + 1
        rng = np.random.default_rng(self.seed)
        drawn = np.repeat(rng.standard_normal((SETS, n, holds, nu)), self.hold, axis=2)
        first = rng.integers(0, self.hold, (SETS, n))
        places = first[..., None] + np.arange(self.horizon)
        return constant, np.take_along_axis(drawn, places[..., None], axis=2)

    def _variations(self, plan: Array, steps: Array, spread: Array) -> Array:
        """Return all sequences to simulate, (samples, B, horizon, nu)."""
        drawn = self.random[steps.astype(np.int64) % SETS].transpose(1, 0, 2, 3)
        varied = np.clip(plan + spread[:, None, None] * drawn, -1.0, 1.0)
        constant = np.broadcast_to(self.constant[:, None], (len(self.constant), *plan.shape))
        return np.concatenate([plan[None], constant, varied])


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
