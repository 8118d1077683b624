"""Fit of a model's parameters by evolution on the multi-step error (paper, section 4.2)."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from sysid_evo.data.dataset import Dataset
from sysid_evo.data.trajectory import Windows
from sysid_evo.engine.compiled.open_loop import final_errors
from sysid_evo.errors import InvalidData
from sysid_evo.evolution.champion import Finalist
from sysid_evo.evolution.loop import Objective
from sysid_evo.evolution.runs import FinishedRun, Runs
from sysid_evo.evolution.strategies.mu_plus_lambda import MuPlusLambda
from sysid_evo.evolution.strategies.strategy import EvolutionStrategy
from sysid_evo.kernels import DynamicsKernel, Precision
from sysid_evo.models.dynamics import chained, enough, training_bounds
from sysid_evo.processors import available_processors, engine_inputs, resolve
from sysid_evo.progress import Checkpoint, Progress
from sysid_evo.randomness import keyed_generator
from sysid_evo.types import Array

PopulationStep: TypeAlias = Callable[[Array, Array, Array], Array]
"""(P, n) parameters, (P, W, n_carry) carries, (W, nu) controls -> (P, W, n_carry) next carries."""

Start: TypeAlias = Callable[[Array, Array], Array]
"""(W, L + 1, nx) measured states, (W, L, nu) controls before the last -> (W, n_carry) carries, see `Dynamics.start`."""

PopulationKernel: TypeAlias = Callable[[Array], "tuple[DynamicsKernel, Array] | None"]
"""(P, n) parameters -> a kernel of the family and its flat parameters (P, m) for every candidate; None without one."""

Weights: TypeAlias = Literal["spread", "paper"]

CHOICE_WINDOWS = 500


@dataclass(frozen=True)
class ModelEvolution:
    """A 50+50 evolution strategy that minimises the error ``horizon`` steps after ``windows`` random starts.

    The fitness of a candidate is minus the mean squared difference between the simulated and the recorded state
    ``horizon`` steps after the start. With ``error_units`` "spread", every state is divided by its standard deviation
    over the data; with "paper", states count in their own units, so that small numbers have little weight. All
    candidates of a generation have the same windows; the next generation has new ones, and parents are evaluated
    again. The result is the best of the last parents on up to 500 windows, evenly spaced over the data.
    """

    generations: int = 1000
    windows: int = 100
    horizon: int = 10
    parents: int = 50
    children: int = 50
    sigma: float = 0.1
    error_units: Weights = "spread"

    def run(
        self,
        step: PopulationStep,
        dataset: Dataset,
        *,
        initial: Array,
        spread: float,
        rng: np.random.Generator,
        progress: Progress | None = None,
        checkpoint: Checkpoint | None = None,
        kernel: PopulationKernel | None = None,
        start: Start | None = None,
        history: int = 0,
    ) -> Array:
        """Return the best parameters found (n,); the first candidates are drawn around ``initial`` (n,).

        ``kernel``, the compiled form of ``step``, is used unless `SYSID_EVO_ENGINE` selects the reference. ``start``
        computes the first carry of a simulation from ``history`` earlier samples; by default it is the measured state.
        With a ``checkpoint``, an interrupted fit resumes and ends with the same parameters.
        """
        every = dataset.find_windows(self.horizon, history=history)
        if not len(every):
            raise InvalidData(
                f"data set: no episode is longer than {self.horizon + history} steps, the horizon of the fit"
                + (f" and {history} of history" if history else "")
            )
        scale = dataset.system.spread(every.last_states)
        weight = np.ones_like(scale) if self.error_units == "paper" else 1.0 / np.where(scale > 0, scale, 1.0) ** 2
        seed = int(rng.integers(2**32))
        precision = enough("float32", training_bounds(every.last_states, 2.0))

        def objective(population: Array, generation: int) -> Array:
            chosen = every[keyed_generator(seed, generation).integers(len(every), size=self.windows)]
            compiled = None if kernel is None or resolve() == "reference" else kernel(population)
            if compiled is None:
                return -final_error(step, population, chosen, start, weight=weight)
            return -kernel_error(*compiled, chosen, start, weight=weight, precision=precision)

        def start_run(_run: int, _ended: Sequence[FinishedRun]) -> tuple[EvolutionStrategy, Objective]:
            strategy = MuPlusLambda(
                n_parameters=len(initial),
                seed=seed,
                parents=self.parents,
                children=self.children,
                sigma=self.sigma,
                spread=spread,
                initial=initial,
            )
            return strategy, objective

        def finalists_of(run: int, strategy: EvolutionStrategy) -> tuple[Finalist, ...]:
            evenly = np.unique(np.linspace(0, len(every) - 1, CHOICE_WINDOWS).astype(np.int64))
            error = final_error(step, strategy.elite, every[evenly], start, weight=weight)
            winner = int(np.argmin(error))
            return (Finalist("", run, -float(error[winner]), strategy.elite[winner]),)

        def identity() -> str:
            """Return the digest of the settings, the data, and the fitness of the first candidates."""
            first = objective(start_run(0, ())[0].ask(), 0)
            inputs = [repr(self), seed, spread, dataset.fingerprint, initial.tolist(), first.tolist()]
            return hashlib.sha256(json.dumps([*inputs, *engine_inputs().items()]).encode()).hexdigest()

        def report(done: int, total: int, note: str = "") -> None:  # noqa: ARG001  # a fit reports numbers only
            if progress is not None:
                progress(done, total)

        (run,) = Runs(
            (self.generations,),
            start_run,
            finalists_of,
            models=(),
            checkpoint=checkpoint,
            identity="" if checkpoint is None else identity(),
        ).finish(report)
        return run.finalists[0].parameters


def starting_carries(windows: Windows, start: Start | None) -> Array:
    """Return the first carries (W, n_carry) of the simulations of ``windows``."""
    return windows.start_states if start is None else start(windows.past_states, windows.past_controls)


def final_error(
    step: PopulationStep,
    population: Array,
    windows: Windows,
    start: Start | None = None,
    *,
    weight: Array | float = 1.0,
) -> Array:
    """Return the mean squared difference (P,) of the last state of ``windows``; ``weight`` (nx,) multiplies each state.

    The error of a candidate that diverges is the largest finite number.
    """
    nx = windows.states.shape[2]
    carry = np.repeat(starting_carries(windows, start)[None], len(population), axis=0)
    with np.errstate(all="ignore"):
        for last in chained(lambda current, control: step(population, current, control), carry, windows.controls):
            carry = last
        error = np.mean((carry[..., :nx] - windows.states[:, -1]) ** 2 * weight, axis=(1, 2))
    return np.where(np.isfinite(error), error, np.finfo(float).max)


def kernel_error(
    kernel: DynamicsKernel,
    parameters: Array,
    windows: Windows,
    start: Start | None = None,
    *,
    weight: Array | None = None,
    precision: Precision = "float32",
) -> Array:
    """Return the error of `final_error`, compiled, on all processors; ``parameters`` (P, m) are those of the kernel."""
    error = final_errors(
        kernel.source,
        kernel.n_scratch,
        parameters,
        starting_carries(windows, start),
        windows.controls,
        windows.states[:, -1],
        weight,
        precision=precision,
        threads=available_processors(),
    )
    return np.where(np.isfinite(error), error, np.finfo(float).max)
