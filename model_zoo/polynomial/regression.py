"""Sparse regression by pysindy: candidate terms, optimiser, constraints, choice of degree, threshold and lags."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Any, ClassVar, Literal, Self, TypeAlias

import numpy as np
from scipy.optimize import lsq_linear

from model_zoo.features import Features
from model_zoo.polynomial.libraries import WeakForm, basis_of, read_library, testing_functions
from model_zoo.polynomial.model import (
    DEGREES,
    MAX_TERMS,
    PolynomialModel,
    Regression,
    evaluate,
    factors,
    library_size,
    monomials,
    term_name,
)
from model_zoo.polynomial.optimizers import counts_rows, make_optimizer, read_optimizer, run
from model_zoo.scaling import root_mean_square
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidArgument, InvalidData
from sysid_evo.models import DynamicsModel
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
    divided by their RMS. ``constraints`` are known properties of coefficients: "damping of yaw_rate <= 0", "steer in
    forward_speed = 0".
    """

    knowledge = "dark grey"
    requires = ("pysindy",)
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"lag_search": "few"}}
    limits: ClassVar[dict[str, Limit]] = {"degree": at_least(1), "threshold": at_least(0), "ridge": at_least(0)}
    lag_options: ClassVar[tuple[tuple[int, int], ...]] = ((0, 0), (0, 2), (0, 3))
    few_lags: ClassVar[tuple[tuple[int, int], ...]] = ((0, 0), (0, 3))
    has_weak_form: ClassVar[bool] = False

    degree: int | None = None
    threshold: float | None = None
    ridge: float = 1e-3
    functions: list[str] | None = None
    library: str | None = None
    optimizer: str | None = None
    constraints: list[str] | None = None
    state_lags: int | None = None
    control_lags: int | None = None
    lag_search: Literal["all", "few"] = "all"
    dead_band: bool = False
    max_steps: int | None = 100_000

    def check_parameters(self) -> None:
        super().check_parameters()
        if self.library is not None:
            named_terms = read_library(self.library)
            if self.degree is not None:
                raise InvalidArgument(f"degree={self.degree}: give it in the library, polynomial(degree={self.degree})")
            if named_terms.weak is not None and not self.has_weak_form:
                raise InvalidArgument(f"{type(self).__name__} has no weak form; use sindy")
        if self.optimizer is not None:
            read_optimizer(self.optimizer)
            if self.threshold is not None:
                raise InvalidArgument(f"threshold: give it in the optimizer, STLSQ(threshold={self.threshold})")

    def check_system(self, system: System) -> None:
        (fewest, few), (most, many) = np.sort(self._lag_candidates(), axis=0)[[0, -1]].tolist()
        self.features_of(system, (fewest, few))
        if self.optimizer is not None:
            make_optimizer(self.optimizer)
        if self.constraints:
            exponents = self.terms_of(system, (most, many), self.degree or max(DEGREES))
            bounds(self.constraints, exponents, self.features_of(system, (most, many)).names, system.state_names)

    def features_of(self, system: System, lags: tuple[int, int]) -> Features:
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

    def terms_of(self, system: System, lags: tuple[int, int], degree: int) -> IntArray:
        """Return the exponents (T, n) of the candidate terms over `features_of`."""
        if self.library is None:
            return monomials(len(self.features_of(system, lags).names), degree)
        return basis_of(self.library, Features(system, lags, tuple(self.functions or ()))).exponents

    def kept_features(self, exponents: IntArray) -> IntArray:
        if self.library is None:
            return super().kept_features(exponents)
        features = self.features_of(self.system, self.lags)
        plain, used = len(features.plain_names), np.sum(exponents, axis=0) > 0
        kept = np.flatnonzero(used | (np.arange(len(used)) < plain))
        self.used_functions_ = [features.functions[i - plain] for i in kept if i >= plain]
        return kept

    def library_of(self, data: Regression, lags: tuple[int, int], degree: int) -> Library:
        """Return the candidate terms of ``data``."""
        weak = None if self.library is None else read_library(self.library).weak
        rows = self.optimizer is not None and counts_rows(self.optimizer)
        exponents = self.terms_of(self.system, lags, degree)
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
        if self.optimizer is None and not self.constraints:
            return library.coefficients(threshold, self.ridge)
        optimizer = self.optimizer or f"STLSQ(threshold={threshold!r}, alpha={self.ridge!r})"
        if not self.constraints:
            return library.found_by(optimizer, seed)
        names = self.features_of(self.system, self.lags).names
        low, high = bounds(
            self.constraints, library.exponents, names, self.system.state_names, as_far_as_there=self.degree is None
        )
        return library.found_within(optimizer, low, high, self.ridge, seed)

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
                return len(self.terms_of(dataset.system, setting[2], 0))
            return library_size(len(self.features_of(dataset.system, setting[2]).names), setting[0])

        return [setting for setting in every if terms(setting) <= MAX_TERMS[self.lag_search]] or [every[0]]

    def _lag_candidates(self) -> list[tuple[int, int]]:
        offered = self.few_lags if self.lag_search == "few" else self.lag_options
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

    def found_by(self, optimizer: str, seed: int) -> Array:
        """Return the coefficients (T, nx) of raw quantities found by an optimiser of pysindy."""
        return run(make_optimizer(optimizer), self.terms, self.targets, seed) * self.unit

    def found_within(self, optimizer: str, low: Array, high: Array, ridge: float, seed: int) -> Array:
        """Return coefficients (T, nx) between ``low`` and ``high`` of the terms selected by an optimiser.

        The constraints are passed to optimisers that support them; the selected terms are refitted within the bounds.
        """
        low, high = low / self.unit, high / self.unit
        found = np.zeros_like(low)
        for state in range(self.targets.shape[1]):
            least, most, target = low[:, state], high[:, state], self.targets[:, state : state + 1]
            free = ~(least == most)
            used = np.zeros(len(free), dtype=bool)
            if free.any():
                rest = target - self.terms @ np.where(free, 0.0, least)[:, None]
                search = make_optimizer(optimizer, **_as_matrices(optimizer, least[free], most[free]))
                used[free] = run(search, self.terms[:, free], rest, seed)[:, 0] != 0
            found[:, state] = bounded_fit(self.terms, target[:, 0], least, most, used, ridge)
        return found * self.unit


def _as_matrices(optimizer: str, low: Array, high: Array) -> dict[str, object]:
    """Return the constraints of one equation in the form of ConstrainedSR3; empty for other optimisers."""
    spec = read_optimizer(optimizer)
    below, above = np.isfinite(high), np.isfinite(low)
    if spec.name != "ConstrainedSR3" or not (below.any() or above.any()):
        return {}
    usual = {"regularizer": "l1", "max_iter": 10_000}  # bounds need a convex penalty and more iterations
    each = np.eye(len(low))
    return {
        "constraint_lhs": np.concatenate([each[below], -each[above]]),
        "constraint_rhs": np.concatenate([high[below], -low[above]]),
        "inequality_constraints": True,
        **{name: value for name, value in usual.items() if name not in spec.parameters},
    }


SENTENCE = re.compile(r"\s*(?P<what>.+?)\s*(?P<sign><=|>=|==|=)\s*(?P<number>[-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*")
WHAT = "'TERM in STATE <= 0', 'damping of STATE <= 0' or 'terms with INPUT in STATE = 0', also with >= and ="


def bounds(
    sentences: Sequence[str],
    exponents: IntArray,
    names: Sequence[str],
    states: Sequence[str],
    *,
    as_far_as_there: bool = False,
) -> tuple[Array, Array]:
    """Return the lowest and highest value (T, nx) of every coefficient. Raises `InvalidArgument`.

    ``exponents`` (T, n) are those of the features ``names``. The damping of a state is the coefficient of the state in
    its own equation. With ``as_far_as_there`` a constraint on a missing term is ignored.
    """
    low, high = np.full((len(exponents), len(states)), -np.inf), np.full((len(exponents), len(states)), np.inf)
    for sentence in sentences:
        found = SENTENCE.fullmatch(sentence)
        if found is None:
            raise InvalidArgument(f"constraints: expected {WHAT}; got {sentence!r}")
        chosen, state = _meant(found["what"], sentence, exponents, names, states)
        if not chosen.any() and not as_far_as_there:
            some = ", ".join(term_name(row, names) for row in exponents[:8])
            raise InvalidArgument(f"constraints: expected a term out of {some}, ...; got {sentence!r}")
        number = float(found["number"])
        if found["sign"] != "<=":
            low[chosen, state] = np.maximum(low[chosen, state], number)
        if found["sign"] != ">=":
            high[chosen, state] = np.minimum(high[chosen, state], number)
    if (low > high).any():
        row, state = np.argwhere(low > high)[0]
        raise InvalidArgument(
            f"constraints: contradiction for {term_name(exponents[row], names)} in {states[state]}: "
            f"at least {low[row, state]:g} and at most {high[row, state]:g}"
        )
    return low, high


def _meant(
    what: str, sentence: str, exponents: IntArray, names: Sequence[str], states: Sequence[str]
) -> tuple[BoolArray, int]:
    """Return the terms (T,) of a constraint, and its state."""
    damping = re.fullmatch(r"damping of (.+)", what)
    term, _, state = (damping[1], "", damping[1]) if damping else what.rpartition(" in ")
    if state.strip() not in states or not term:
        raise InvalidArgument(f"constraints: expected {WHAT} with STATE out of {', '.join(states)}; got {sentence!r}")
    every = re.fullmatch(r"terms with (.+)", term.strip())
    if every:
        chosen = np.any(exponents[:, [every[1].strip() == name for name in names]] > 0, axis=1)
    else:
        wanted = re.sub(r"[\s*]", "", term)
        chosen = np.array([wanted in _spellings(row, names) for row in exponents])
    return np.asarray(chosen, dtype=np.bool_), list(states).index(state.strip())


def _spellings(powers: IntArray, names: Sequence[str]) -> set[str]:
    """Return all spellings of a term without blanks: its factors in any order."""
    parts = factors(powers, names)
    return {re.sub(r"[\s*]", "", "".join(order)) for order in permutations(parts)} if parts else {"1"}


def bounded_fit(terms: Array, target: Array, low: Array, high: Array, used: BoolArray, ridge: float) -> Array:
    """Return the least-squares coefficients (T,) of the terms ``used`` (T,) within bounds (T,), zero for the others.

    A term whose bounds exclude zero is always used.
    """
    used = (used | (low > 0) | (high < 0)) & ~((low == 0) & (high == 0))
    found = np.zeros(len(used))
    fixed = used & (low == high)
    found[fixed] = low[fixed]
    free = used & ~fixed
    if free.any():
        rest = target - terms @ found
        matrix = np.concatenate([terms[:, free], np.sqrt(ridge) * np.eye(int(free.sum()))])
        solution = lsq_linear(matrix, np.concatenate([rest, np.zeros(int(free.sum()))]), (low[free], high[free]))
        found[free] = np.clip(solution.x, low[free], high[free])
    return found
