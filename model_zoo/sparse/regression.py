"""What the SINDy families share: pysindy fits, simulation of held-out blocks chooses."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import ClassVar, Literal, Self, TypeAlias

import numpy as np

from model_zoo.channels.features import Features
from model_zoo.channels.standard import root_mean_square
from model_zoo.sparse.family import PolynomialFamily, Regression
from model_zoo.sparse.polynomial import DEGREES, MOST_TERMS, evaluate, library_size, monomials
from model_zoo.validation.held_out import FOLDS, HeldOut, best, lag_candidates, trials
from sysid_evo.arrays import Array, IntArray
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.errors import InvalidData
from sysid_evo.hyperparameters import Limit, at_least
from sysid_evo.progress import Counter, Progress
from sysid_evo.searched import Searched, Within
from sysid_evo.system import System

THRESHOLDS = (0.01, 0.03, 0.1, 0.3)


@dataclass(frozen=True)
class Library:
    """The monomials of a regression, with no more rows than that takes: least squares see only their products.

    ``terms`` (R, T) and ``targets`` (R, nx) are the triangular factor of the QR decomposition of the monomials and
    targets, of quantities divided by their root mean squares; the data themselves if they have fewer rows than terms.
    """

    terms: Array
    targets: Array
    exponents: IntArray
    unit: Array
    """What a coefficient of each term and target (T, nx) is measured in."""

    @classmethod
    def of(cls, data: Regression, degree: int) -> Library:
        """Return all monomials up to ``degree``. Raises `InvalidData` if there are fewer than two steps."""
        if len(data.regressors) < 2:
            raise InvalidData("data set: a sparse regression needs at least two steps")
        scale, target_scale = root_mean_square(data.regressors), root_mean_square(data.targets)
        exponents = monomials(len(scale), degree)
        terms, targets = evaluate(data.regressors / scale, exponents), data.targets / target_scale
        unit = target_scale / np.prod(scale**exponents, axis=1)[:, None]
        count = len(exponents)
        if len(terms) > count + targets.shape[1]:
            factor: Array = np.asarray(np.linalg.qr(np.concatenate([terms, targets], axis=1), mode="r"))
            terms, targets = factor[:count, :count], factor[:count, count:]
        return cls(terms, targets, exponents, unit)

    def coefficients(self, threshold: float, ridge: float) -> Array:
        """Return the coefficients (T, nx) of the raw quantities that pysindy's STLSQ finds, zeros included.

        ``threshold`` is a share of a target's size.
        """
        from pysindy.optimizers import STLSQ
        from sklearn import config_context

        start = np.ones((self.targets.shape[1], self.terms.shape[1]))  # nothing but that all terms are there counts
        unchecked = {"check_input": False, "solver": "cholesky"}  # checks took longer than the regressions
        search = STLSQ(threshold=threshold, alpha=ridge, initial_guess=start, ridge_kw=unchecked)
        with warnings.catch_warnings(), config_context(assume_finite=True, skip_parameter_validation=True):
            warnings.simplefilter("ignore")  # a threshold that leaves an equation empty is an outcome here
            search.fit(self.terms, self.targets)
        return np.asarray(search.coef_.T * self.unit, dtype=np.float64)


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
    searched: ClassVar[dict[str, Searched]] = {
        "degree": Within(1, 3),
        "threshold": Within(0.003, 1.0, log=True),
        "ridge": Within(1e-6, 0.1, log=True),
    }
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
        data = self.regression(dataset, self.lags)
        library = Library.of(data, degree)
        self.adopt(data, library.coefficients(threshold, self.ridge), library.exponents)

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        settings = self._settings(dataset)
        counter = Counter(progress, trials(settings) * FOLDS + 1)
        judged = self._judged(dataset, settings, counter) if len(settings) > 1 else {}
        self.degree_, self.threshold_, lags = best(
            settings, lambda setting: judged[setting][0], size=lambda setting: judged[setting][1]
        )
        self.keep_lags(lags)
        self.learn(dataset, self.degree_, self.threshold_, rng, counter)
        counter.advance()
        return self

    def _judged(
        self, dataset: Dataset, settings: Sequence[Setting], counter: Counter
    ) -> dict[Setting, tuple[float, int]]:
        """Return the error on held-out blocks and the size of the model of each setting.

        Those of the same degree and lags share the monomials of every block.
        """
        blocks, found = HeldOut.of(dataset), dict[Setting, tuple[float, int]]()
        for kind in dict.fromkeys((degree, lags) for degree, _, lags in settings):
            shared: dict[int, tuple[Regression, Library]] = {}
            for setting in settings:
                if (setting[0], setting[2]) == kind:
                    found[setting] = self._tried(setting, blocks, shared, counter)
        return found

    def _tried(
        self, setting: Setting, blocks: HeldOut, shared: dict[int, tuple[Regression, Library]], counter: Counter
    ) -> tuple[float, int]:
        degree, threshold, lags = setting
        trial = self.variant(degree=degree, threshold=threshold, state_lags=lags[0], control_lags=lags[1])
        size = FOLDS * trial.n_carry  # what has to be remembered counts too

        def learned(part: Dataset) -> DynamicsModel:
            nonlocal size
            if id(part) not in shared:
                data = trial.regression(part, lags)
                shared[id(part)] = data, Library.of(data, degree)
            data, library = shared[id(part)]
            trial.adopt(data, library.coefficients(threshold, self.ridge), library.exponents)
            size += int(np.count_nonzero(trial.coefficients_))
            return trial

        return blocks.error(learned, told=counter.advance), size

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
