"""Base class of polynomial families: monomials, step, printed equations, compiled form, stability."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np

from model_zoo.features import (
    Features,
    between_limits,
    integrals,
    less,
    next_state,
    next_state_predictor,
    offsets_of,
    quotient,
)
from sysid_evo.data import Dataset
from sysid_evo.models import DynamicsModel
from sysid_evo.models.kernels import Predictor, polynomial_predictor, with_angles, within
from sysid_evo.models.kernels.shells import SeenRow, of_functions
from sysid_evo.models.learned import Declared, Numbers
from sysid_evo.models.stochastic import StochasticModel
from sysid_evo.system import System
from sysid_evo.types import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Regression:
    """Regressors (N, n >= nx), targets (N, nx), and measurements: features ``measured`` (N, n), ``states`` (N, nx).

    ``added`` (nx,) marks states whose targets are changes. ``sample`` (N,) numbers the steps, with a gap between steps
    that are not consecutive.
    """

    regressors: Array
    targets: Array
    measured: Array
    states: Array
    added: BoolArray
    sample: IntArray | None = None

    def __getitem__(self, rows: IntArray) -> Regression:
        sample = None if self.sample is None else self.sample[rows]
        measured, states = self.measured[rows], self.states[rows]
        return Regression(self.regressors[rows], self.targets[rows], measured, states, self.added, sample)


class PolynomialModel(StochasticModel):
    """A family whose step is a polynomial of features of (carry, control), clipped to the training range.

    The polynomial gives the next state, or the change of an integral (`integrals`). A differential equation overrides
    `regression`, `_left_sides`, `next_state` and `predictor`. An offset is subtracted from channels far from zero, such
    as a map coordinate or a temperature in kelvin: monomials of 1e6 + x are nearly collinear, so that neither fits nor
    thresholds can separate them.
    """

    model_class = "polynomial"
    periodic = True

    def record(self, dataset: Dataset) -> None:
        super().record(dataset)
        self.__dict__.pop("offsets_", None)
        if offsets := offsets_of(dataset):
            self.offsets_ = list(offsets)

    @property
    def offsets(self) -> tuple[float, ...]:
        """Offsets subtracted from states and controls (nx + nu); () for none, as in older stored models."""
        return tuple(getattr(self, "offsets_", ()))

    def _features_of(self, system: System, lags: tuple[int, int]) -> Features:
        """Return the features of the polynomial, also before the lags are chosen."""
        return Features(system, lags, offsets=self.offsets)

    @property
    def features(self) -> Features:
        """The features of the polynomial."""
        return self._features_of(self.system, self.lags)

    def regression(self, dataset: Dataset, lags: tuple[int, int]) -> Regression:
        """Return regressors and targets for the polynomial."""
        data = dataset.transitions(state_lags=lags[0], control_lags=lags[1], moving=True)
        features, added = self._features_of(dataset.system, lags), integrals(dataset)
        seen = features(data.carry, data.control)
        targets = data.after - np.where(added, data.state, self._zero_of(added))
        found = Regression(seen, targets, seen, data.state, added)
        return found[np.flatnonzero(between_limits(dataset.system, data.after))]

    def _zero_of(self, added: Array | BoolArray) -> Array:
        """Return the zero points (nx,) of the targets: 0 for changes (``added``), offsets for the others."""
        return np.where(added, 0.0, self.offsets[: len(added)] or 0.0)

    def set_learned(self, data: Regression, coefficients: Array, exponents: IntArray) -> None:
        """Store the terms with a coefficient as right-hand side, with the range of ``data``."""
        zero = self._zero_of(data.added)
        if zero.any():  # offsets of the targets become a constant
            if exponents.any(axis=1).all():
                exponents = np.concatenate([np.zeros_like(exponents[:1]), exponents])
                coefficients = np.concatenate([np.zeros_like(coefficients[:1]), coefficients])
            coefficients = coefficients + zero * ~exponents.any(axis=1, keepdims=True)
        used = np.flatnonzero(np.any(coefficients != 0, axis=1))
        used = used if len(used) else np.array([0])
        seen = self._kept_features(exponents[used])
        self.coefficients_ = np.ascontiguousarray(coefficients[used])
        self.exponents_ = np.ascontiguousarray(exponents[used][:, seen])
        self.low_, self.high_ = data.measured.min(axis=0)[seen], data.measured.max(axis=0)[seen]
        self.added_ = data.added.astype(np.float64)

    def learned_arrays(self) -> Mapping[str, Declared]:
        seen, nx = len(self.features.names), self.system.nx
        return {
            "coefficients_": ("terms", nx),
            "exponents_": Numbers("terms", seen, whole=True, least=0, most=MAX_EXPONENT),
            "low_": (seen,),
            "high_": (seen,),
            "added_": (nx,),
            "offsets_": Numbers(nx + self.system.nu, optional=True),
            "state_bounds_": Numbers(2, nx, infinite=True, rising=True),  # its `stability` needs both
            "training_sample_": ("pairs", nx + self.system.nu),
        }

    def _kept_features(self, exponents: IntArray) -> IntArray:
        """Return which features to keep, including those of terms with ``exponents`` (T, n); by default all."""
        return np.arange(exponents.shape[1])

    def polynomial(self, carry: Array, control: Array) -> Array:
        """Return the right-hand side (B, nx), its features clipped to the training range."""
        inputs = np.clip(self.features(carry, control), self.low_, self.high_)
        return evaluate(inputs, self.exponents_) @ self.coefficients_

    def next_state(self, carry: Array, control: Array) -> Array:
        return next_state(self.added_, carry[:, : self.system.nx], self.polynomial(carry, control))

    def predictor(self) -> Predictor | None:
        return next_state_predictor(self.added_, self.right_side())

    def right_side(self) -> Predictor:
        """Return the compiled form of the polynomial of the clipped features."""
        if self.features.functions or self.offsets:
            return self._of_rows()
        seen = len(self.features.names) - self.system.nu
        sums = polynomial_predictor(self.exponents_, self.coefficients_, seen, self.system.nu)
        clipped = within(sums, self.low_, self.high_, seen)
        return with_angles(clipped, self.system, self.lags)

    def _of_rows(self) -> Predictor:
        """Return the compiled form for features that are functions of (carry, control), or have offsets subtracted."""
        ranges = zip(self.features.rows, self.low_, self.high_, strict=True)
        rows = [SeenRow(*row, low, high) for row, low, high in ranges]
        return predictor_of_rows(rows, self.layout.size, self.exponents_, self.coefficients_)

    @cached_property
    def stability(self) -> Stability:
        """Growth of disturbances and outcome of simulations; computed on first use."""
        return stability(self.variant(stochastic=False))

    @property
    def fit_note(self) -> str:
        """Notes on the training data, and on an unstable equation."""
        return "; ".join(part for part in (super().fit_note, self.stability.sentence) if part)

    def _left_sides(self) -> list[tuple[str, str]]:
        """Return the left side of each equation and its unit."""
        states = zip(self.system.states, self.added_, self._zero_of(self.added_), strict=True)
        return [(less(f"{c.name}[+1]", zero) + (f" - {c.name}" if added else ""), c.unit) for c, added, zero in states]

    def coefficients(self) -> Array:
        """Return the coefficients (nx, T) of the terms in `equations`, zeros included, as pysindy's method does."""
        return self._printed().T

    def _printed(self) -> Array:
        """Return the coefficients (T, nx) without the part that belongs to the left-hand side."""
        constant = ~self.exponents_.any(axis=1, keepdims=True)
        return self.coefficients_ - constant * self._zero_of(self.added_)

    def equations(self) -> list[str]:
        """Return one equation for each state, with the unit of every coefficient in brackets."""
        features, coefficients = self.features, self._printed()
        return [
            equation(left, unit, coefficients[:, channel], self.exponents_, features.shown_names, features.units)
            for channel, (left, unit) in enumerate(self._left_sides())
        ]


MAX_EXPONENT = 99
"""Largest exponent accepted from a file, far beyond any degree that data support."""
DEGREES = (2, 3)
"""Degrees that are tried if none is given."""
MAX_TERMS: Mapping[str, int] = {"all": 250, "few": 150}
"""Terms of the largest library that is tried, by `lag_search`."""


def library_size(n_inputs: int, degree: int) -> int:
    """Return the number of monomials up to ``degree``."""
    return math.comb(n_inputs + degree, degree)


def monomials(n_inputs: int, degree: int) -> IntArray:
    """Return the exponents (T, n_inputs) of all monomials up to ``degree``, constant first, by rising degree."""
    rows = [
        np.bincount(np.array(chosen, dtype=np.int64), minlength=n_inputs)
        for order in range(degree + 1)
        for chosen in combinations_with_replacement(range(n_inputs), order)
    ]
    return np.array(rows, dtype=np.int64)


def evaluate(inputs: Array, exponents: IntArray) -> Array:
    """Return the monomials (B, T) of ``inputs`` (B, n), computed factor by factor for all terms at once."""
    rows = np.concatenate([inputs.T, np.ones((1, len(inputs)))])
    used = exponents.cumsum(axis=1)
    degree = int(used[:, -1].max(initial=0)) if used.size else 0
    terms = rows[np.sum(used <= 0, axis=1)]
    for power in range(1, degree):
        terms *= rows[np.sum(used <= power, axis=1)]  # after its last factor a term is multiplied by 1
    return terms.T


def predictor_of_rows(rows: Sequence[SeenRow], held: int, exponents: IntArray, coefficients: Array) -> Predictor:
    """Return the compiled polynomial of ``rows``, functions of (carry, control); the carry has ``held`` elements."""
    of_carry = [i for i, row in enumerate(rows) if row.place < held]
    of_control = [i for i, row in enumerate(rows) if row.place >= held]
    sums = polynomial_predictor(exponents[:, [*of_carry, *of_control]], coefficients, len(of_carry), len(of_control))
    controls = [rows[i]._replace(place=rows[i].place - held) for i in of_control]
    return of_functions(sums, [rows[i] for i in of_carry], controls)


def term_name(exponents: IntArray, names: Sequence[str]) -> str:
    """Return one monomial as text, such as ``forward_speed^2 steer``; ``1`` for the constant."""
    pairs = zip(exponents, names, strict=True)
    return " ".join(name if power == 1 else f"{name}^{power}" for power, name in pairs if power) or "1"


def equation(
    left: str, unit: str, coefficients: Array, exponents: IntArray, names: Sequence[str], units: Sequence[str]
) -> str:
    """Return one equation; every coefficient (T,) that is not zero is followed by its unit in brackets."""
    parts = []
    for value, powers in zip(coefficients, exponents, strict=True):
        if value:
            dimension = quotient(unit, zip(units, (int(power) for power in powers), strict=True))
            name = term_name(powers, names)
            factor = f"{abs(value):.4g}" + (f" [{dimension}]" if dimension else "")
            parts.append(("- " if value < 0 else "+ ") + factor + ("" if name == "1" else f" {name}"))
    right = " ".join(parts) if parts else "0"
    return f"{left} = {right.removeprefix('+ ')}"


SIMULATED_SECONDS = 25.0
"""Length of a simulation in s."""
MAX_STEPS = 1000
N_SIMULATIONS = 32
HOLD_STEPS = 10
"""Steps for which a simulation holds each control."""
STATES = 64
"""Recorded states at which the equation is linearised."""
REPORTED_GROWTH = 0.1
"""Growth rate in 1/s above which it is reported."""
MOST = 0.5
"""Share of recorded states with such growth above which it is reported."""
STEP = 1e-4


@dataclass(frozen=True)
class Stability:
    """Growth rates of small disturbances in 1/s, and outcome of simulations from recorded states.

    ``at_rest`` is the rate at the neutral state and control, ``visited`` (N,) those at recorded states and controls;
    disturbances decay if it is below 0. ``escaped`` is the share of simulations of ``seconds`` under recorded controls,
    in random order, that reach the state bounds.
    """

    at_rest: float
    visited: Array
    escaped: float
    seconds: float

    @property
    def sentence(self) -> str:
        """The warnings about the model; empty if there are none."""
        found = []
        if self.escaped > 0:
            found.append(
                f"unstable: {100 * self.escaped:.0f} % of simulations of {self.seconds:g} s from recorded states "
                "reach the state bounds"
            )
        if self.at_rest > REPORTED_GROWTH:
            found.append(f"small disturbances at rest grow by {self.at_rest:.1f} 1/s")
        share = float((self.visited > REPORTED_GROWTH).mean())
        if share > MOST:
            found.append(f"small disturbances grow at {100 * share:.0f} % of recorded states")
        return "; ".join(found)


def stability(model: DynamicsModel) -> Stability:
    """Return the `Stability` of a fitted model; deterministic."""
    system, rng = model.system, np.random.default_rng(0)
    nx = system.nx
    states, controls = model.training_sample_[:, :nx], model.training_sample_[:, nx:]
    some = rng.integers(len(states), size=STATES)
    rest = growth(model, system.neutral_state[None], system.neutral_control[None])
    steps = min(MAX_STEPS, max(1, round(SIMULATED_SECONDS / system.dt)))
    began = rng.integers(len(states), size=N_SIMULATIONS)
    pieces = rng.integers(len(controls), size=(N_SIMULATIONS, -(-steps // HOLD_STEPS)))
    history = np.repeat(states[began][:, None], model.n_lags + 1, axis=1)
    past = np.tile(system.neutral_control, (N_SIMULATIONS, model.n_lags, 1))
    runs = model.simulate(history, past, np.repeat(controls[pieces], HOLD_STEPS, axis=1)[:, :steps])
    low, high = model.state_bounds_
    with np.errstate(invalid="ignore"):
        escaped = ~np.isfinite(runs) | (runs <= low) | (runs >= high)
    return Stability(
        float(rest[0]),
        growth(model, states[some], controls[some]),
        float(escaped.any(axis=(1, 2)).mean()),
        steps * system.dt,
    )


def growth(model: DynamicsModel, states: Array, controls: Array) -> Array:
    """Return the growth rate (N,) in 1/s of the fastest small disturbance of the carry, under held controls."""
    system, lags = model.system, model.n_lags
    carry = model.start(np.repeat(states[:, None], lags + 1, axis=1), np.repeat(controls[:, None], lags, axis=1))
    spread = np.where(np.isfinite(np.ptp(carry, axis=0)), np.ptp(carry, axis=0), 0.0)
    usual = np.ptp(model.training_sample_[:, : system.nx], axis=0).max()
    size = STEP * np.where(spread > 0, spread, usual if usual > 0 else 1.0)
    columns = []
    for place in range(carry.shape[1]):
        off = np.zeros(carry.shape[1])
        off[place] = size[place]
        with np.errstate(all="ignore"):
            columns.append((model.step(carry + off, controls) - model.step(carry - off, controls)) / (2 * size[place]))
    jacobian = np.nan_to_num(np.stack(columns, axis=2))
    fastest = np.abs(np.linalg.eigvals(jacobian)).max(axis=1)
    return np.asarray(np.log(np.maximum(fastest, np.finfo(float).tiny)) / system.dt)
