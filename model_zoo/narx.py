"""Polynomial NARX: terms chosen one by one by orthogonal least squares."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from model_zoo.channels.features import Features
from model_zoo.sparse.polynomial import equation, evaluate, left_sides, monomials
from model_zoo.validation.held_out import FOLDS, HeldOut, best, lag_candidates, trials
from sysid_evo.arrays import Array, IntArray
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.hyperparameters import Limit, at_least
from sysid_evo.progress import Counter, Progress
from sysid_evo.registry import register_model

if TYPE_CHECKING:
    from sysid_evo.engine.compiled.kernel import DynamicsKernel

COUNTS = (8, 12, 16, 24, 32, 48)
INDEPENDENT = 1e-10


@register_model("narx")
class Narx(DynamicsModel):
    """x_{k+1} = sum of ``terms`` monomials of lagged states and controls, one selection for each state.

    Terms enter in the order of their error reduction ratio, the share of the target's energy that a
    candidate explains once it is made orthogonal to those chosen (Chen, Billings, Luo 1989, forward
    orthogonal least squares). ``terms`` and lags left at None are chosen by the simulation error
    over one second on held-out blocks of time. Inputs are clipped to the training range;
    a periodic state stands as its sine and cosine, and its change is predicted.
    """

    knowledge = "black"
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"terms": 12, "state_lags": 0, "control_lags": 0}}
    limits: ClassVar[dict[str, Limit]] = {"degree": at_least(1), "terms": at_least(1)}

    degree: int = 2
    terms: int | None = None
    state_lags: int | None = None
    control_lags: int | None = None
    rest_hold: bool = False

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        pairs = lag_candidates(self.state_lags, self.control_lags, ((0, 0), (0, 2), (1, 2), (1, 3), (2, 4)))
        counts = COUNTS if self.terms is None else (self.terms,)
        settings = [(count, lags) for lags in pairs for count in counts]
        counter = Counter(progress, trials(settings) * FOLDS + 1)
        blocks, orders = HeldOut.of(dataset), {}

        def learned(part: Dataset, count: int, lags: tuple[int, int]) -> DynamicsModel:
            key = lags, part.names  # the order of the terms does not depend on how many are taken
            if key not in orders:
                orders[key] = self._selection(part, lags, max(counts))
            trial = self.variant(terms=count, state_lags=lags[0], control_lags=lags[1])
            trial._learn(part, lags, count, orders[key])
            return trial

        count, lags = best(
            settings, lambda setting: blocks.error(lambda part: learned(part, *setting), told=counter.advance)
        )
        self.keep_lags(lags)
        self.terms_ = count
        self._learn(dataset, lags, count, self._selection(dataset, lags, count))
        counter.advance()
        return self

    def next_state(self, carry: Array, control: Array) -> Array:
        features = Features(self.system, self.lags)
        inputs = np.clip(features(carry, control), self.low_, self.high_)
        return features.anchor(carry[:, : self.system.nx]) + evaluate(inputs, self.exponents_) @ self.coefficients_

    def kernel(self) -> DynamicsKernel | None:
        from sysid_evo.engine.kernels import polynomial_predictor, stepping_kernel, within

        if not Features(self.system, self.lags).plain:
            return None
        sums = polynomial_predictor(self.exponents_, self.coefficients_, self.n_carry, self.system.nu)
        predictor = within(sums, self.low_, self.high_, self.n_carry)
        return stepping_kernel(predictor, self.system, output="next_state", lags=self.lags, rest_band=self.rest_band)

    def equations(self) -> list[str]:
        """Return one equation for each state, with the unit of every coefficient in brackets."""
        features = Features(self.system, self.lags)
        sides = left_sides(self.system)
        return [
            equation(left, unit, self.coefficients_[:, i], self.exponents_, features.names, features.units)
            for i, (left, unit) in enumerate(sides)
        ]

    def _selection(self, dataset: Dataset, lags: tuple[int, int], count: int) -> list[IntArray]:
        """Return, for each state, the terms in the order in which they enter."""
        data = dataset.transitions(state_lags=lags[0], control_lags=lags[1], moving=True)
        features = Features(dataset.system, lags)
        inputs, after = features(data.carry, data.control), data.after - features.anchor(data.state)
        library = evaluate(inputs / _size(inputs), monomials(inputs.shape[1], self.degree))
        return [forward_selection(library, after[:, i], count) for i in range(after.shape[1])]

    def _learn(self, dataset: Dataset, lags: tuple[int, int], count: int, order: list[IntArray]) -> None:
        data = dataset.transitions(state_lags=lags[0], control_lags=lags[1], moving=True)
        features = Features(dataset.system, lags)
        inputs, after = features(data.carry, data.control), data.after - features.anchor(data.state)
        scale, exponents = _size(inputs), monomials(inputs.shape[1], self.degree)
        library = evaluate(inputs / scale, exponents)
        coefficients = np.zeros((len(exponents), after.shape[1]))
        for i, terms in enumerate(order):
            solution, *_ = np.linalg.lstsq(library[:, terms[:count]], after[:, i], rcond=None)
            coefficients[terms[:count], i] = solution
        used = np.flatnonzero(np.any(coefficients != 0, axis=1))
        used = used if len(used) else np.array([0])
        self.exponents_ = exponents[used]
        self.coefficients_ = coefficients[used] / np.prod(scale ** exponents[used], axis=1)[:, None]
        self.low_, self.high_ = inputs.min(axis=0), inputs.max(axis=0)


def forward_selection(library: Array, target: Array, count: int) -> IntArray:
    """Return up to ``count`` columns of ``library`` (N, T) in the order of their error reduction ratio."""
    rest, residual = library.copy(), target.copy()
    original = np.sum(library**2, axis=0)
    energy = float(target @ target)
    chosen: list[int] = []
    while len(chosen) < min(count, library.shape[1]) and float(residual @ residual) > INDEPENDENT**2 * energy:
        size = np.sum(rest**2, axis=0)
        usable = size > INDEPENDENT * original
        usable[chosen] = False
        if not usable.any():
            break
        gain = np.where(usable, (rest.T @ residual) ** 2 / np.where(usable, size, 1.0), -1.0)
        best = int(np.argmax(gain))
        chosen.append(best)
        direction = rest[:, best] / np.sqrt(size[best])
        rest -= np.outer(direction, direction @ rest)
        residual = residual - direction * (direction @ residual)
    return np.array(chosen or [0], dtype=np.int64)


def _size(inputs: Array) -> Array:
    size = np.sqrt(np.mean(inputs**2, axis=0))
    return np.where(size > 0, size, 1.0)
