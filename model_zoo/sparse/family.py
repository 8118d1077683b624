"""A family whose right-hand side is a polynomial of few terms: what is learned, stepped, compiled and printed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from model_zoo.channels.features import Features
from model_zoo.channels.integrals import between_limits, integrals, next_state, next_state_predictor
from model_zoo.sparse.polynomial import equation, evaluate
from model_zoo.sparse.stability import Stability, stability
from model_zoo.validation.uncertain import Uncertain
from sysid_evo.arrays import Array, BoolArray, IntArray
from sysid_evo.data import Dataset
from sysid_evo.system import System

if TYPE_CHECKING:
    from sysid_evo.engine.kernels import Predictor


@dataclass(frozen=True)
class Regression:
    """Regressors (N, n), n at least nx, and targets (N, nx); what was ``measured``: features (N, n), states (N, nx).

    ``added`` (nx,) says of which states the targets are changes. ``sample`` (N,) numbers the steps, with a gap where
    one does not follow the one before.
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


class PolynomialFamily(Uncertain):
    """A family that steps by a polynomial of features of (carry, control), clipped to the training range.

    The polynomial is the next state, or the change of an integral, see `integrals`; a differential equation says so
    in its own `regression`, `left_sides`, `next_state` and `predictor`. Its variables may be functions of the inputs.
    """

    structure = "polynomial"
    periodic = True

    def features_of(self, system: System, lags: tuple[int, int]) -> Features:
        """Return what the polynomial sees of (carry, control), also before the lags are chosen."""
        return Features(system, lags)

    @property
    def features(self) -> Features:
        """What the polynomial sees of (carry, control)."""
        return self.features_of(self.system, self.lags)

    def regression(self, dataset: Dataset, lags: tuple[int, int]) -> Regression:
        """Return what the polynomial is fitted to."""
        data = dataset.transitions(state_lags=lags[0], control_lags=lags[1], moving=True)
        features, added = self.features_of(dataset.system, lags), integrals(dataset)
        seen = features(data.carry, data.control)
        found = Regression(seen, data.after - np.where(added, data.state, 0.0), seen, data.state, added)
        return found[np.flatnonzero(between_limits(dataset.system, data.after))]

    def adopt(self, data: Regression, coefficients: Array, exponents: IntArray) -> None:
        """Make the terms with a coefficient the right-hand side, in the range of ``data``."""
        used = np.flatnonzero(np.any(coefficients != 0, axis=1))
        used = used if len(used) else np.array([0])
        seen = self.kept_features(exponents[used])
        self.coefficients_ = np.ascontiguousarray(coefficients[used])
        self.exponents_ = np.ascontiguousarray(exponents[used][:, seen])
        self.low_, self.high_ = data.measured.min(axis=0)[seen], data.measured.max(axis=0)[seen]
        self.added_ = data.added.astype(np.float64)

    def kept_features(self, exponents: IntArray) -> IntArray:
        """Return which features to go on with, those of terms with ``exponents`` (T, n) among them; by default all."""
        return np.arange(exponents.shape[1])

    def polynomial(self, carry: Array, control: Array) -> Array:
        """Return the right-hand side (B, nx), its features clipped to the training range."""
        inputs = np.clip(self.features(carry, control), self.low_, self.high_)
        return evaluate(inputs, self.exponents_) @ self.coefficients_

    def next_state(self, carry: Array, control: Array) -> Array:
        return next_state(self.added_, carry[:, : self.system.nx], self.polynomial(carry, control))

    def predictor(self) -> Predictor | None:
        right_side = self.right_side()
        return None if right_side is None else next_state_predictor(self.added_, right_side)

    def right_side(self) -> Predictor | None:
        """Return the compiled form of the polynomial of the clipped features."""
        from sysid_evo.engine.kernels import polynomial_predictor, with_angles, within

        if self.features.functions:
            return self._of_functions()
        seen = len(self.features.names) - self.system.nu
        sums = polynomial_predictor(self.exponents_, self.coefficients_, seen, self.system.nu)
        clipped = within(sums, self.low_, self.high_, seen)
        return with_angles(clipped, self.system, self.lags)

    def _of_functions(self) -> Predictor:
        """Return the compiled form where some features are functions of (carry, control)."""
        from sysid_evo.engine.kernels import polynomial_predictor
        from sysid_evo.engine.kernels.functions import SeenRow, of_functions

        rows, held = self.features.rows, self.layout.size
        found = [
            SeenRow(row.function, row.place if row.place < held else row.place - held, row.factor, low, high)
            for row, low, high in zip(rows, self.low_, self.high_, strict=True)
        ]
        of_carry = [i for i, row in enumerate(rows) if row.place < held]
        of_control = [i for i, row in enumerate(rows) if row.place >= held]
        exponents = self.exponents_[:, [*of_carry, *of_control]]
        sums = polynomial_predictor(exponents, self.coefficients_, len(of_carry), len(of_control))
        return of_functions(sums, [found[i] for i in of_carry], [found[i] for i in of_control])

    @cached_property
    def stability(self) -> Stability:
        """How disturbances grow and how free runs end; found when it is asked for."""
        return stability(self.variant(stochastic=False))

    @property
    def fit_note(self) -> str:
        """What there is to say of the data that it learned from, and of an equation that runs away."""
        return ", and ".join(part for part in (super().fit_note, self.stability.sentence) if part)

    def left_sides(self) -> list[tuple[str, str]]:
        """Return the left side of each equation and its unit."""
        pairs = zip(self.system.states, self.added_, strict=True)
        return [(f"{c.name}[+1]" + (f" - {c.name}" if added else ""), c.unit) for c, added in pairs]

    def equations(self) -> list[str]:
        """Return one equation for each state, with the unit of every coefficient in brackets."""
        features = self.features
        return [
            equation(left, unit, self.coefficients_[:, channel], self.exponents_, features.names, features.units)
            for channel, (left, unit) in enumerate(self.left_sides())
        ]
