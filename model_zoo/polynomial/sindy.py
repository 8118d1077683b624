"""Families sindy and sindy_discrete: sparse regression by pysindy, choices, continuation outside the data."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, ClassVar, Literal, Self, TypeAlias

import numpy as np

from model_zoo.features import Features, between_limits, integrals
from model_zoo.polynomial.libraries import WeakForm, basis_of, read_library, testing_functions
from model_zoo.polynomial.model import (
    DEGREES,
    MAX_TERMS,
    PolynomialModel,
    Regression,
    evaluate,
    library_size,
    monomials,
)
from model_zoo.polynomial.optimizers import counts_rows, make_optimizer, read_optimizer, run
from model_zoo.scaling import root_mean_square
from sysid_evo import register_model
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidArgument, InvalidData
from sysid_evo.models import DynamicsModel
from sysid_evo.models.dynamics import rk4
from sysid_evo.models.kernels import Predictor, runge_kutta_predictor, turning_frame
from sysid_evo.models.learned import Declared, Numbers
from sysid_evo.models.parameters import Limit, at_least
from sysid_evo.progress import Counter, Progress
from sysid_evo.system import System
from sysid_evo.types import Array, BoolArray, IntArray
from sysid_evo.validation.folds import FOLDS
from sysid_evo.validation.held_out import HeldOutError, best_candidate, count_fits, lag_candidates

THRESHOLDS = (0.01, 0.03, 0.1, 0.3)

Setting: TypeAlias = tuple[int, float, tuple[int, int]]
"""Degree (0 if a library is given), threshold, lags."""
SEED = 0
"""Seed of optimisers that use random numbers, while settings are tried."""


class SparsePolynomial(PolynomialModel):
    """A polynomial whose terms are selected by pysindy.

    The features (`Features`) are (carry, control), sine and cosine for periodic states, and the ``functions`` that are
    given, such as "abs(speed)". ``degree``, ``threshold`` and lags left at None are chosen by the simulation error over
    one second on held-out blocks of time: of the settings within 5 % of the lowest error, the one with the fewest
    terms. Settings that diverge are chosen only if all do. ``lag_search="few"`` tries only no lags and lags that cover
    dead time and slow actuators.

    ``library`` and ``optimizer`` are written as in pysindy, with arguments (see `libraries`, `optimizers`):
    "polynomial(degree=2) + fourier(n_frequencies=2)", "SR3(reg_weight_lam=0.1)". The optimiser works on quantities
    divided by their RMS.
    """

    knowledge = "dark grey"
    requires = ("pysindy",)
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"lag_search": "few"}}
    limits: ClassVar[dict[str, Limit]] = {"degree": at_least(1), "threshold": at_least(0), "ridge": at_least(0)}
    lag_options: ClassVar[tuple[tuple[int, int], ...]] = ((0, 0), (0, 2), (0, 3))
    _few_lags: ClassVar[tuple[tuple[int, int], ...]] = ((0, 0), (0, 3))
    _has_weak_form: ClassVar[bool] = False

    degree: int | None = None
    threshold: float | None = None
    ridge: float = 1e-3
    functions: list[str] | None = None
    library: str | None = None
    optimizer: str | None = None
    state_lags: int | None = None
    control_lags: int | None = None
    lag_search: Literal["all", "few"] = "all"
    max_steps: int | None = 100_000

    def check_parameters(self) -> None:
        super().check_parameters()
        if self.library is not None:
            named_terms = read_library(self.library)
            if self.degree is not None:
                raise InvalidArgument(f"degree={self.degree}: give it in the library, polynomial(degree={self.degree})")
            if named_terms.weak is not None and not self._has_weak_form:
                raise InvalidArgument(f"{type(self).__name__} has no weak form; use sindy")
        if self.optimizer is not None:
            read_optimizer(self.optimizer)
            if self.threshold is not None:
                raise InvalidArgument(f"threshold: give it in the optimizer, STLSQ(threshold={self.threshold})")

    def check_system(self, system: System) -> None:
        state_lags, control_lags = np.min(self._lag_candidates(), axis=0).tolist()
        self._features_of(system, (state_lags, control_lags))
        if self.optimizer is not None:
            make_optimizer(self.optimizer)

    def _features_of(self, system: System, lags: tuple[int, int]) -> Features:
        requested = tuple(self.functions or ())
        features = Features(system, lags, requested, self.offsets)
        if self.library is None:
            return features
        return replace(features, functions=(*requested, *basis_of(self.library, features).functions))

    @property
    def features(self) -> Features:
        """The features of the polynomial; of a library's functions only those in its terms."""
        if self.library is None:
            return super().features
        return Features(self.system, self.lags, tuple(self.used_functions_), self.offsets)

    def _terms_of(self, system: System, lags: tuple[int, int], degree: int) -> IntArray:
        """Return the exponents (T, n) of the candidate terms over `_features_of`."""
        if self.library is None:
            return monomials(len(self._features_of(system, lags).names), degree)
        return basis_of(self.library, Features(system, lags, tuple(self.functions or ()))).exponents

    def _kept_features(self, exponents: IntArray) -> IntArray:
        if self.library is None:
            return super()._kept_features(exponents)
        features = self._features_of(self.system, self.lags)
        plain, used = len(features.plain_names), np.sum(exponents, axis=0) > 0
        kept = np.flatnonzero(used | (np.arange(len(used)) < plain))
        self.used_functions_ = [features.functions[i - plain] for i in kept if i >= plain]
        return kept

    def library_of(self, data: Regression, lags: tuple[int, int], degree: int) -> Library:
        """Return the candidate terms of ``data``."""
        weak = None if self.library is None else read_library(self.library).weak
        rows = self.optimizer is not None and counts_rows(self.optimizer)
        exponents = self._terms_of(self.system, lags, degree)
        return Library.of(data, exponents, weak=weak, dt=self.system.dt, rows=rows)

    def sampled(self, dataset: Dataset, lags: tuple[int, int]) -> IntArray | None:
        """Return the numbers (N,) of the training steps, for the weak form; None without it."""
        if self.library is None or read_library(self.library).weak is None:
            return None
        history = max(lags)
        windows = dataset.windows(1, history=history, moving=True)
        windows = windows if len(windows) else dataset.windows(1, history=history)
        begins = np.cumsum([0, *(len(episode) + 2 for episode in dataset.episodes)])
        return np.asarray(begins[windows.episode] + windows.start, dtype=np.int64)

    def solved(self, library: Library, threshold: float, seed: int = SEED) -> Array:
        """Return the coefficients (T, nx) of a library."""
        if self.optimizer is None:
            return library.coefficients(threshold, self.ridge)
        return run(make_optimizer(self.optimizer), library.terms, library.targets, seed) * library.unit

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        settings = self._settings(dataset)
        counter = Counter(progress, count_fits(settings) * FOLDS + 1)
        scores = self._held_out_scores(dataset, settings, counter) if len(settings) > 1 else {}
        degree, threshold, lags = best_candidate(
            settings, lambda setting: scores[setting][0], size=lambda setting: scores[setting][1]
        )
        self.record_lags(lags)
        if self.library is None:
            self.degree_ = degree
        if self.optimizer is None:
            self.threshold_ = threshold
        data = self.regression(dataset, lags)
        library = self.library_of(data, lags, degree)
        seed = int(rng.integers(2**32)) if self.optimizer is not None else SEED
        self.set_learned(data, self.solved(library, threshold, seed), library.exponents)
        counter.advance()
        self.calibrate(dataset, rng, lambda: counter.advance(0))
        return self

    def _held_out_scores(
        self, dataset: Dataset, settings: Sequence[Setting], counter: Counter
    ) -> dict[Setting, tuple[float, int]]:
        """Return the error on held-out blocks and the size of the model of each setting.

        Settings of the same degree and lags share the monomials of every block.
        """
        blocks, found = HeldOutError.of(dataset), dict[Setting, tuple[float, int]]()
        for kind in dict.fromkeys((degree, lags) for degree, _, lags in settings):
            shared: dict[int, tuple[Regression, Library]] = {}
            for setting in settings:
                if (setting[0], setting[2]) == kind:
                    found[setting] = self._tried(setting, blocks, shared, counter)
        return found

    def _tried(
        self, setting: Setting, blocks: HeldOutError, shared: dict[int, tuple[Regression, Library]], counter: Counter
    ) -> tuple[float, int]:
        degree, threshold, lags = setting
        own = {} if self.library is not None else {"degree": degree}
        searched = {} if self.optimizer is not None else {"threshold": threshold}
        trial = self.variant(**own, **searched, state_lags=lags[0], control_lags=lags[1])
        size = FOLDS * trial.n_carry  # the size of the carry counts too

        def learned(part: Dataset) -> DynamicsModel:
            nonlocal size
            if id(part) not in shared:
                data = trial.regression(part, lags)
                shared[id(part)] = data, trial.library_of(data, lags, degree)
            data, library = shared[id(part)]
            trial.set_learned(data, trial.solved(library, threshold), library.exponents)
            size += int(np.count_nonzero(trial.coefficients_))
            return trial

        return blocks.error(learned, report=counter.advance), size

    def _settings(self, dataset: Dataset) -> list[Setting]:
        """Return every (degree, threshold, lags) to try, without large libraries if there is a smaller one."""
        degrees = DEGREES if self.degree is None else (self.degree,)
        thresholds = THRESHOLDS if self.threshold is None else (self.threshold,)
        degrees = (0,) if self.library is not None else degrees
        thresholds = (0.0,) if self.optimizer is not None else thresholds
        every = list(product(degrees, thresholds, self._lag_candidates()))

        def terms(setting: Setting) -> int:
            if self.library is not None:
                return len(self._terms_of(dataset.system, setting[2], 0))
            return library_size(len(self._features_of(dataset.system, setting[2]).names), setting[0])

        return [setting for setting in every if terms(setting) <= MAX_TERMS[self.lag_search]] or [every[0]]

    def _lag_candidates(self) -> list[tuple[int, int]]:
        offered = self._few_lags if self.lag_search == "few" else self.lag_options
        return lag_candidates(self.state_lags, self.control_lags, offered)


@dataclass(frozen=True)
class Library:
    """The monomials of a regression, compressed to as few rows as least squares need.

    ``terms`` (R, T) and ``targets`` (R, nx) are the triangular factor of the QR decomposition of monomials and targets,
    both of quantities divided by their RMS; or the data themselves if they have fewer rows than terms.
    """

    terms: Array
    targets: Array
    exponents: IntArray
    unit: Array
    """Unit of the coefficient of each term and target (T, nx)."""

    @classmethod
    def of(
        cls, data: Regression, exponents: IntArray, *, weak: WeakForm | None = None, dt: float = 0.0, rows: bool = False
    ) -> Library:
        """Return the monomials with ``exponents``, optionally in the weak form, uncompressed if ``rows``.

        Raises `InvalidData` if there are fewer than two steps.
        """
        if len(data.regressors) < 2:
            raise InvalidData("data set: expected at least two steps for a sparse regression")
        scale, target_scale = root_mean_square(data.regressors), root_mean_square(data.targets)
        terms, targets = evaluate(data.regressors / scale, exponents), data.targets / target_scale
        unit = target_scale / np.prod(scale**exponents, axis=1)[:, None]
        count = len(exponents)
        if weak is not None and data.sample is not None:
            tested = testing_functions(data.sample, dt, weak)
            terms, targets = tested @ terms, tested @ targets
        if not rows and len(terms) > count + targets.shape[1]:
            factor: Array = np.asarray(np.linalg.qr(np.concatenate([terms, targets], axis=1), mode="r"))
            terms, targets = factor[:count, :count], factor[:count, count:]
        return cls(terms, targets, exponents, unit)

    def coefficients(self, threshold: float, ridge: float) -> Array:
        """Return the coefficients (T, nx) of raw quantities by STLSQ; ``threshold`` is relative to the target."""
        from pysindy.optimizers import STLSQ
        from sklearn import config_context

        start = np.ones((self.targets.shape[1], self.terms.shape[1]))  # only the presence of all terms matters
        unchecked = {"check_input": False, "solver": "cholesky"}  # checks take longer than the regressions
        search = STLSQ(threshold=threshold, alpha=ridge, initial_guess=start, ridge_kw=unchecked)
        with warnings.catch_warnings(), config_context(assume_finite=True, skip_parameter_validation=True):
            warnings.simplefilter("ignore")  # an empty equation is a valid result
            search.fit(self.terms, self.targets)
        return np.asarray(search.coef_.T * self.unit, dtype=np.float64)


@register_model("sindy")
class Sindy(SparsePolynomial):
    """Differential equation with few, readable polynomial terms (SINDy), found by sparse regression with pysindy.

    dx/dt = Theta(x, u) Xi + w(x), Theta all monomials up to ``degree`` (Brunton, Proctor, Kutz 2016); w is the rotation
    of a planar body's frame, (r v, -r u, 0), else zero. The derivative is the difference over one step, taken at the
    mean of its two ends and the control held (second order in dt). Sequentially thresholded least squares drops
    coefficients below ``threshold`` (of quantities divided by their RMS) with the L2 penalty ``ridge``.
    Settings left at None are chosen by the simulation error over one second on held-out blocks of time: the fewest
    terms within 5 % of the best. docs/models.md describes ``functions``, ``library`` and ``optimizer``.

    A step is one fourth-order Runge-Kutta step with held controls; inputs are clipped to the training range. Outside
    this range the equation is bounded (`continued`), so that a polynomial which grows there cannot diverge. Integrals
    are not bounded.
    """

    knowledge = "dark grey"
    requires = ("pysindy",)
    _has_weak_form = True

    def regression(self, dataset: Dataset, lags: tuple[int, int]) -> Regression:
        system = dataset.system
        data = dataset.transitions(state_lags=lags[0], control_lags=lags[1], moving=True)
        middle = 0.5 * (data.state + data.after)
        rate = (data.after - data.state) / system.dt - system.frame_rotation(middle)
        carry = np.concatenate([middle, data.carry[:, system.nx :]], axis=1)
        features = self._features_of(system, lags)
        seen, measured = features(carry, data.control), features(data.carry, data.control)
        found = Regression(seen, rate, measured, data.state, integrals(dataset), self.sampled(dataset, lags))
        return found[np.flatnonzero(between_limits(system, data.after))]

    def set_learned(self, data: Regression, coefficients: Array, exponents: IntArray) -> None:
        super().set_learned(data, coefficients, exponents)
        self.continuation_ = continuation_limits(data.states, data.targets, data.added)

    def _zero_of(self, added: Array | BoolArray) -> Array:
        return np.zeros(len(added))  # rates have no offset

    def learned_arrays(self) -> Mapping[str, Declared]:
        return {"continuation_": Numbers(5, self.system.nx, infinite=True)}

    def _left_sides(self) -> list[tuple[str, str]]:
        return [(f"acceleration of {c.name}", f"{c.unit or '1'}/s") for c in self.system.states]

    def predictor(self) -> Predictor | None:
        rate = turning_frame(self.right_side(), self.system, bounds=self.continuation_)
        return None if rate is None else runge_kutta_predictor(rate, self.system, n_carry=self.n_carry)

    def next_state(self, carry: Array, control: Array) -> Array:
        system = self.system
        held = carry[:, system.nx :]

        def rate(state: Array) -> Array:
            learned = self.polynomial(np.concatenate([state, held], axis=1), control)
            return continued(learned, system.frame_rotation(state), state, self.continuation_, system.dt)

        return rk4(rate, carry[:, : system.nx], system.dt)


@register_model("sindy_discrete")
class SindyDiscrete(SparsePolynomial):
    """Difference equation with few, readable polynomial terms (discrete-time SINDy), found with pysindy.

    x_{k+1} = Theta(x_k, u_k) Xi, Theta all monomials up to ``degree`` (Brunton, Proctor, Kutz 2016). Sequentially
    thresholded least squares drops coefficients below ``threshold`` (of quantities divided by their RMS) with the L2
    penalty ``ridge``; inputs are clipped to the training range. The other settings, and their choice if left at None,
    are those of sindy. Of an integral the change is predicted (`integrals`).
    """

    requires = ("pysindy",)
    knowledge = "black"
    lag_options: ClassVar[tuple[tuple[int, int], ...]] = ((0, 0), (0, 2), (0, 3), (1, 3))
    _few_lags: ClassVar[tuple[tuple[int, int], ...]] = ((0, 0), (0, 3), (1, 3))


MARGIN = 0.1
"""Width of the margin outside the range of a state in which outward rates fade to zero, as a share of the range."""


def continuation_limits(states: Array, rates: Array, endless: BoolArray) -> Array:
    """Return the bounds of the continuation (5, nx): lowest and highest state, 1 / margin, lowest and highest rate.

    ``states`` and ``rates`` (N, nx) are the training data; an ``endless`` (nx,) state, such as a position, has no
    bounds.
    """
    low, high = states.min(axis=0), states.max(axis=0)
    width = np.where(high > low, high - low, 1.0)
    found = np.stack([low, high, 1.0 / (MARGIN * width), rates.min(axis=0), rates.max(axis=0)])
    free = np.array([[-np.inf], [np.inf], [1.0], [-np.inf], [np.inf]])
    return np.where(endless, free, found)


def continued(rate: Array, turning: Array, state: Array, bounds: Array, dt: float) -> Array:
    """Return dx/dt (B, nx) of a learned ``rate`` and the known ``turning`` of the frame.

    The rate is clipped to that of the data. Above the range of a state, rates upwards fade to zero over a tenth of the
    range and the excess decays with the time constant dt; likewise below. Beyond the margin every state therefore
    returns, for any polynomial, and no state exceeds the margin by more than one step of bounded rates.
    """
    low, high, per_margin, slowest, fastest = bounds
    total = np.clip(rate, slowest, fastest) + turning
    above, below = np.maximum(state - high, 0.0), np.maximum(low - state, 0.0)
    up = np.maximum(total, 0.0) * np.maximum(1.0 - above * per_margin, 0.0)
    down = np.minimum(total, 0.0) * np.maximum(1.0 - below * per_margin, 0.0)
    return up + down - (above - below) / dt
