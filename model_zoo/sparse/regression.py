"""What the SINDy families share: pysindy fits, simulation of held-out blocks chooses, a batched polynomial steps."""

from __future__ import annotations

import warnings
from abc import abstractmethod
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from sklearn.base import clone

from model_zoo.sparse.polynomial import equation, evaluate, lagged_names
from model_zoo.validation.held_out import diverges, lag_candidates, time_blocks
from sysid_evo.arrays import Array, IntArray
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.errors import InvalidData
from sysid_evo.free_run import judging_windows, simulation_error
from sysid_evo.hyperparameters import Limit, at_least
from sysid_evo.progress import Counter, Progress

if TYPE_CHECKING:
    from sysid_evo.engine.kernels import Predictor

DEGREES = (2, 3)
THRESHOLDS = (0.01, 0.03, 0.06, 0.1)
MOST_TERMS = 250
SEARCH_FOLDS = 3


@dataclass(frozen=True)
class Regression:
    """Regressors (N, n), of which the first ``nx`` are the state, and targets (N, nx)."""

    regressors: Array
    targets: Array

    def __getitem__(self, rows: IntArray) -> Regression:
        return Regression(self.regressors[rows], self.targets[rows])


def sparse_coefficients(data: Regression, degree: int, threshold: float, ridge: float) -> tuple[Array, IntArray]:
    """Return coefficients (T, nx) and exponents (T, n) that pysindy's STLSQ finds, zeros included.

    pysindy sees regressors and targets divided by their root mean squares, so that ``threshold`` is
    a share of a target's size; the coefficients returned are those of the raw quantities.
    """
    from pysindy import SINDy
    from pysindy.feature_library import PolynomialLibrary
    from pysindy.optimizers import STLSQ

    if len(data.regressors) < 2:
        raise InvalidData("data set: a sparse regression needs at least two steps")
    scale, target_scale = root_mean_square(data.regressors), root_mean_square(data.targets)
    nx = data.targets.shape[1]
    regressors = data.regressors / scale
    model = SINDy(optimizer=STLSQ(threshold=threshold, alpha=ridge), feature_library=PolynomialLibrary(degree=degree))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a threshold that leaves an equation empty is an outcome here
        others = regressors[:, nx:] if regressors.shape[1] > nx else None
        model.fit(regressors[:, :nx], t=1.0, x_dot=data.targets / target_scale, u=others)
    exponents = np.asarray(model.feature_library.powers_, dtype=np.int64)
    coefficients = model.coefficients().T * target_scale / np.prod(scale**exponents, axis=1)[:, None]
    return np.asarray(coefficients, dtype=np.float64), exponents


def root_mean_square(values: Array) -> Array:
    """Return the root mean square of each column, 1 for a column of zeros."""
    size = np.sqrt(np.mean(values**2, axis=0))
    return np.where(size > 0, size, 1.0)


class SparsePolynomial(DynamicsModel):
    """A family whose right-hand side is a sparse polynomial of (carry, control) within the training range.

    A subclass says what is regressed on what (`regression`), and steps with `polynomial`. ``degree``,
    ``threshold`` and lags left at None are chosen by the simulation error over one second on
    held-out blocks of time; settings that diverge there are never chosen if one does not.
    """

    knowledge = "dark grey"
    requires = ("pysindy",)
    limits: ClassVar[dict[str, Limit]] = {"degree": at_least(1), "threshold": at_least(0), "ridge": at_least(0)}
    degree: int | None
    threshold: float | None
    ridge: float

    @abstractmethod
    def regression(self, dataset: Dataset, lags: tuple[int, int]) -> Regression:
        """Return what the polynomial is fitted to."""

    @abstractmethod
    def left_sides(self) -> list[tuple[str, str]]:
        """Return the left side of each equation and its unit."""

    def learn(
        self,
        dataset: Dataset,
        degree: int,
        threshold: float,
        rng: np.random.Generator,  # for those that draw
        counter: Counter,  # for those that take long
    ) -> None:
        """Learn the polynomial from all of ``dataset``, once degree, threshold and lags are chosen."""
        self.learn_once(dataset, degree, threshold)

    def learn_once(self, dataset: Dataset, degree: int, threshold: float) -> None:
        """Learn the polynomial by one sparse regression."""
        data = self.regression(dataset, self.lags)
        self.adopt(data, *sparse_coefficients(data, degree, threshold, self.ridge))

    def adopt(self, data: Regression, coefficients: Array, exponents: IntArray) -> None:
        """Make the terms with a coefficient the right-hand side, in the range of ``data``."""
        used = np.flatnonzero(np.any(coefficients != 0, axis=1))
        used = used if len(used) else np.array([0])
        self.coefficients_ = np.ascontiguousarray(coefficients[used])
        self.exponents_ = np.ascontiguousarray(exponents[used])
        self.low_, self.high_ = data.regressors.min(axis=0), data.regressors.max(axis=0)

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        settings = self._settings(dataset)
        chosen = settings[0]
        searched = len(settings) if len(settings) > 1 else 0
        counter = Counter(progress, searched * SEARCH_FOLDS + 1)
        if searched:
            folds = [time_blocks(dataset, fold) for fold in range(SEARCH_FOLDS)]
            errors = []
            for degree, threshold, lags in settings:
                trial = clone(self).set_params(
                    degree=degree, threshold=threshold, state_lags=lags[0], control_lags=lags[1]
                )
                trial.system_, trial.envelope_ = self.system_, self.envelope_
                error = 0.0
                for learned, held in folds:
                    trial.learn_once(learned, degree, threshold)
                    windows = judging_windows(held, trial.n_lags)
                    error += simulation_error(trial, windows) + (1e6 if diverges(trial, windows, dataset) else 0.0)
                    counter.advance()
                errors.append(error)
            chosen = settings[int(np.argmin(errors))]
        degree, threshold, lags = chosen
        if self.state_lags is None:
            self.state_lags_ = lags[0]
        if self.control_lags is None:
            self.control_lags_ = lags[1]
        self.degree_, self.threshold_ = degree, threshold
        self.learn(dataset, degree, threshold, rng, counter)
        counter.advance()
        return self

    def polynomial(self, inputs: Array) -> Array:
        """Return the right-hand side (B, nx) for (carry, control), clipped to the training range."""
        return evaluate(np.clip(inputs, self.low_, self.high_), self.exponents_) @ self.coefficients_

    def predictor(self) -> Predictor:
        """Return `polynomial` as a predictor of the fast engine."""
        from sysid_evo.engine.kernels import polynomial_predictor, within

        sums = polynomial_predictor(self.exponents_, self.coefficients_, self.n_carry, self.system.nu)
        return within(sums, self.low_, self.high_, self.n_carry)

    def equations(self) -> list[str]:
        """Return one equation for each state, with the unit of every coefficient in brackets."""
        system = self.system
        lags = self.lags
        names = lagged_names(system.state_names, system.control_names, lags)
        states, controls = [c.unit for c in system.states], [c.unit for c in system.controls]
        units = states * (lags[0] + 1) + controls * (lags[1] + 1)
        return [
            equation(left, unit, self.coefficients_[:, channel], self.exponents_, names, units)
            for channel, (left, unit) in enumerate(self.left_sides())
        ]

    def _settings(self, dataset: Dataset) -> list[tuple[int, float, tuple[int, int]]]:
        """Return every (degree, threshold, lags) to try; large libraries are left out if a smaller one is there."""
        system = dataset.system
        degrees = DEGREES if self.degree is None else (self.degree,)
        thresholds = THRESHOLDS if self.threshold is None else (self.threshold,)
        lags = lag_candidates(self.state_lags, self.control_lags, ((0, 0), (0, 2), (0, 3), (1, 3)))
        every = list(product(degrees, thresholds, lags))

        def terms(setting: tuple[int, float, tuple[int, int]]) -> int:
            n = system.nx * (1 + setting[2][0]) + system.nu * (1 + setting[2][1])
            return int(np.prod([(n + i) / i for i in range(1, setting[0] + 1)]) + 0.5)

        return [setting for setting in every if terms(setting) <= MOST_TERMS] or [every[0]]
