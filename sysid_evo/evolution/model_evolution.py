"""Fitting a model's parameters by evolution on its multi-step error (paper, section 4.2)."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from sysid_evo.data.dataset import Dataset
from sysid_evo.data.trajectory import Windows
from sysid_evo.engine.compiled.open_loop import final_errors
from sysid_evo.errors import InvalidData
from sysid_evo.evolution.champion import Finalist
from sysid_evo.evolution.loop import Schedule
from sysid_evo.evolution.runs import Runs
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
    """A 50+50 strategy on the error after ``horizon`` steps from ``windows`` random starts.

    The fitness of a candidate is minus the mean square difference between the simulated and the
    recorded state ``horizon`` steps after the start. ``error_units`` says in what: with "spread", every state is
    divided by its standard deviation over the data; with "paper", states count in their own units, so
    that one whose numbers are small hardly counts. All candidates of a generation meet the same
    windows, the next generation new ones, and parents are evaluated again. The winner is the best
    of the last parents on up to 500 windows spread evenly over the data.
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
        """Return the best parameters found, (n,), starting around ``initial`` (n,).

        With ``kernel``, the compiled form of ``step``, generations run compiled, unless `SYSID_EVO_ENGINE` names the
        reference. A simulation starts from what ``start`` makes of ``history`` earlier samples, by default from the
        measured state. What was stopped or killed goes on from its ``checkpoint``, to the same parameters.
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

        def begun(_: int) -> tuple[EvolutionStrategy, Schedule]:
            strategy = MuPlusLambda(
                n_parameters=len(initial),
                seed=seed,
                parents=self.parents,
                children=self.children,
                sigma=self.sigma,
                spread=spread,
                initial=initial,
            )
            return strategy, Schedule((), objective)

        def finals(run: int, strategy: EvolutionStrategy) -> tuple[Finalist, ...]:
            evenly = np.unique(np.linspace(0, len(every) - 1, CHOICE_WINDOWS).astype(np.int64))
            error = final_error(step, strategy.elite, every[evenly], start, weight=weight)
            winner = int(np.argmin(error))
            return (Finalist("", run, -float(error[winner]), strategy.elite[winner]),)

        def identity() -> str:
            """Return the digest of what is asked for, the data, and how the first candidates do."""
            first = objective(begun(0)[0].ask(), 0)
            asked = [repr(self), seed, spread, dataset.fingerprint, initial.tolist(), first.tolist()]
            return hashlib.sha256(json.dumps([*asked, *engine_inputs().items()]).encode()).hexdigest()

        def told(done: int, total: int, note: str = "") -> None:  # noqa: ARG001  # of a fit, numbers are told
            if progress is not None:
                progress(done, total)

        (run,) = Runs(
            1,
            self.generations,
            begun,
            finals,
            models=((),),
            checkpoint=checkpoint,
            identity="" if checkpoint is None else identity(),
        ).finish(told)
        return run.finalists[0].parameters


def starting_carries(windows: Windows, start: Start | None) -> Array:
    """Return the carries (W, n_carry) from which ``windows`` are simulated."""
    return windows.start_states if start is None else start(windows.past_states, windows.past_controls)


def final_error(
    step: PopulationStep,
    population: Array,
    windows: Windows,
    start: Start | None = None,
    *,
    weight: Array | float = 1.0,
) -> Array:
    """Return the mean square difference (P,) of the last state of ``windows``, every state times its ``weight`` (nx,).

    A candidate that diverges has the largest number there is.
    """
    nx = windows.states.shape[2]
    carry = np.repeat(starting_carries(windows, start)[None], len(population), axis=0)
    with np.errstate(all="ignore"):
        for last in chained(lambda now, control: step(population, now, control), carry, windows.controls):
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
    """Return what `final_error` does, compiled, on all processors; ``parameters`` are the kernel's, (P, m)."""
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
