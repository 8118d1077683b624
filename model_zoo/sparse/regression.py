"""What the SINDy families share: pysindy fits, simulation of held-out blocks chooses."""

from __future__ import annotations

import warnings
from itertools import product
from typing import ClassVar, Literal, Self, TypeAlias

import numpy as np

from model_zoo.channels.features import Features
from model_zoo.channels.standard import root_mean_square
from model_zoo.sparse.family import PolynomialFamily, Regression
from model_zoo.sparse.polynomial import DEGREES, MOST_TERMS, library_size
from model_zoo.validation.held_out import FOLDS, HeldOut, best, lag_candidates, trials
from sysid_evo.arrays import Array, IntArray
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.errors import InvalidData
from sysid_evo.hyperparameters import Limit, at_least
from sysid_evo.progress import Counter, Progress
from sysid_evo.system import System

THRESHOLDS = (0.01, 0.03, 0.1, 0.3)


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


Setting: TypeAlias = tuple[int, float, tuple[int, int]]
"""Degree, threshold, lags."""


class SparsePolynomial(PolynomialFamily):
    """A polynomial whose terms pysindy finds.

    The features are `Features`: the plain (carry, control), sine and cosine of periodic states, and the
    ``functions`` asked for, such as "abs(speed)". ``degree``, ``threshold`` and lags left at None are chosen by the
    simulation error over one second on held-out blocks of time: the setting with the fewest terms among those
    within 5 % of the best. Settings that diverge there are never chosen if one does not. With ``lag_search="few"``
    only none, and lags that are enough for dead time and slow actuators, are tried.
    """

    knowledge = "dark grey"
    requires = ("pysindy",)
    limits: ClassVar[dict[str, Limit]] = {"degree": at_least(1), "threshold": at_least(0), "ridge": at_least(0)}
    offered_lags: ClassVar[tuple[tuple[int, int], ...]] = ((0, 0), (0, 2), (0, 3))
    few_lags: ClassVar[tuple[tuple[int, int], ...]] = ((0, 0), (0, 3))

    degree: int | None = None
    threshold: float | None = None
    ridge: float = 1e-3
    functions: list[str] | None = None
    state_lags: int | None = None
    control_lags: int | None = None
    lag_search: Literal["all", "few"] = "all"
    rest_hold: bool = False
    most_steps: int | None = 100_000

    def check_system(self, system: System) -> None:
        self.features_of(system, (0, 0))

    def features_of(self, system: System, lags: tuple[int, int]) -> Features:
        return Features(system, lags, tuple(self.functions or ()))

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

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        settings, sizes = self._settings(dataset), dict[Setting, int]()
        counter = Counter(progress, trials(settings) * FOLDS + 1)
        blocks = HeldOut.of(dataset)

        def error(setting: Setting) -> float:
            degree, threshold, lags = setting
            trial = self.variant(degree=degree, threshold=threshold, state_lags=lags[0], control_lags=lags[1])
            sizes[setting] = FOLDS * trial.n_carry  # what has to be remembered counts too

            def learned(part: Dataset) -> DynamicsModel:
                trial.learn_once(part, degree, threshold)
                sizes[setting] += int(np.count_nonzero(trial.coefficients_))
                return trial

            return blocks.error(learned, told=counter.advance)

        self.degree_, self.threshold_, lags = best(settings, error, size=lambda setting: sizes[setting])
        self.keep_lags(lags)
        self.learn(dataset, self.degree_, self.threshold_, rng, counter)
        counter.advance()
        return self

    def _settings(self, dataset: Dataset) -> list[Setting]:
        """Return every (degree, threshold, lags) to try; large libraries are left out if a smaller one is there."""
        degrees = DEGREES if self.degree is None else (self.degree,)
        thresholds = THRESHOLDS if self.threshold is None else (self.threshold,)
        offered = self.few_lags if self.lag_search == "few" else self.offered_lags
        lags = lag_candidates(self.state_lags, self.control_lags, offered)
        every = list(product(degrees, thresholds, lags))

        def terms(setting: Setting) -> int:
            return library_size(len(self.features_of(dataset.system, setting[2]).names), setting[0])

        return [setting for setting in every if terms(setting) <= MOST_TERMS[self.lag_search]] or [every[0]]
