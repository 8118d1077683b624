"""Family linear_state_space: subspace start, output-error training, Kalman observer."""

from __future__ import annotations

from typing import Any, ClassVar, Self

import numpy as np

from model_zoo.state_space.estimation import EstimationProblem
from model_zoo.state_space.model import StateSpaceModel
from sysid_evo import Dataset, register_model
from sysid_evo.models.parameters import Limit, at_least
from sysid_evo.progress import Counter, Progress
from sysid_evo.validation.folds import FOLDS, time_fold
from sysid_evo.validation.held_out import best_candidate, count_fits
from sysid_evo.validation.simulation_error import error_windows, simulation_error

MOST = 8
"""Highest order that is tried; the number of outputs plus two if that is higher."""

STEPS = 60
"""Length of the simulations that choose the order."""
TRIAL_SHARE = 0.4
"""Share of the iterations used to try an order."""


@register_model("linear_state_space")
class LinearStateSpace(StateSpaceModel):
    """Linear state space with hidden states and a Kalman observer, for systems with unmeasured states.

    x' = A x + B u + c + K (y - C x - d), y = C x + d: the innovation form, trained as an output-error model. A
    predictor-based subspace method (Chiuso 2007) gives A, B and C; Levenberg-Marquardt with analytic gradients then
    fits simulations of 100 and finally of ``horizon`` steps, each with its own initial state, for ``iterations``
    iterations. K is the gain of the Kalman predictor for the noise ratio with the lowest simulation error. An ``order``
    (number of states) left at None is the smallest one, from the number of outputs to 8, whose simulation error on
    ``folds`` held-out blocks of time is within 5 % of the best.
    """

    knowledge = "black"
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"iterations": 12, "folds": 1, "max_steps": 4000}}
    limits: ClassVar[dict[str, Limit]] = {"folds": at_least(1, at_most=FOLDS)}

    order: int | None = None
    iterations: int = 30
    horizon: int = 1000
    folds: int = 2
    max_steps: int | None = 30_000

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        ny = dataset.system.nx
        orders = [max(self.order, ny)] if self.order else list(range(ny, max(MOST, ny + 2) + 1))
        short = max(1, round(TRIAL_SHARE * self.iterations))
        counter = Counter(progress, count_fits(orders) * self.folds * short + 2 * self.iterations + 1)
        pairs = [time_fold(dataset, fold, FOLDS) for fold in range(self.folds)] if count_fits(orders) else []
        problems = [EstimationProblem.of(learned, self.horizon) for learned, _ in pairs]

        def error(order: int) -> float:
            total = 0.0
            for problem, (_, held) in zip(problems, pairs, strict=True):
                trial = self.variant(order=order)
                trial._learn(problem, order, short, 0, counter)
                total += simulation_error(trial, error_windows(held, trial.n_lags, fewest=STEPS))
            return total

        order = best_candidate(orders, error, size=float)
        self._learn(EstimationProblem.of(dataset, self.horizon), order, self.iterations, self.iterations, counter)
        counter.advance()
        return self

    def _learn(self, problem: EstimationProblem, order: int, short: int, long: int, counter: Counter) -> None:
        """Fit one space with ``short`` iterations on short and ``long`` iterations on long simulations."""
        trained = problem.linear_trained(order, short, long, counter.advance)
        self.set_learned(problem.scales, [trained.spaces], problem.observers(trained), np.ones(1))
