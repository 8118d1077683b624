"""Family narx: a polynomial whose terms are selected one by one by orthogonal least squares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

import numpy as np

from model_zoo.polynomial.model import (
    DEGREES,
    MAX_TERMS,
    PolynomialModel,
    Regression,
    evaluate,
    library_size,
    monomials,
)
from model_zoo.scaling import root_mean_square
from sysid_evo import Dataset, DynamicsModel, register_model
from sysid_evo.models.parameters import Limit, at_least
from sysid_evo.progress import Counter, Progress
from sysid_evo.types import Array, IntArray
from sysid_evo.validation.folds import FOLDS
from sysid_evo.validation.held_out import HeldOutError, best_candidate, count_fits, lag_candidates

COUNTS = (8, 12, 16, 24, 32, 48)
OFFERED = {"all": ((0, 0), (0, 2), (1, 2), (1, 3), (2, 4)), "few": ((0, 0), (0, 3), (1, 3))}
INDEPENDENT = 1e-10
ROWS = 8192
"""Rows of monomials in memory at a time."""


@register_model("narx")
class Narx(PolynomialModel):
    """Polynomial of lagged states and controls whose terms are selected one by one (NARX).

    x_{k+1} = sum of ``terms`` monomials up to ``degree``, selected for each state by forward orthogonal least squares
    (Chen, Billings, Luo 1989): terms enter in the order of their error reduction ratio, the share of the target's
    energy explained by a candidate made orthogonal to the terms before it. ``degree``, ``terms`` and lags left at None
    are chosen by the simulation error over one second on held-out blocks of time; with ``lag_search="few"`` among no
    lags, (0, 3) and (1, 3). Inputs are clipped to the training range; periodic states enter as sine and cosine; of an
    integral (`integrals`) the change is predicted.
    """

    knowledge = "black"
    fast_fit = True
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"degree": None, "terms": 32, "lag_search": "few"}}
    limits: ClassVar[dict[str, Limit]] = {"degree": at_least(1), "terms": at_least(1)}

    degree: int | None = 2
    terms: int | None = None
    state_lags: int | None = None
    control_lags: int | None = None
    lag_search: Literal["all", "few"] = "all"
    max_steps: int | None = 100_000

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        pairs = lag_candidates(self.state_lags, self.control_lags, OFFERED[self.lag_search])
        counts = COUNTS if self.terms is None else (self.terms,)
        settings = [(count, lags, degree) for lags, degree in self._libraries(dataset, pairs) for count in counts]
        counter = Counter(progress, count_fits(settings) * FOLDS + 1)
        blocks, chosen = HeldOutError.of(dataset), {}

        def learned(part: Dataset, count: int, lags: tuple[int, int], degree: int) -> DynamicsModel:
            data, key = self.regression(part, lags), (lags, degree, part.names)
            if key not in chosen:  # the order does not depend on the number of terms
                compressed = Compressed.of(data, degree)
                chosen[key] = compressed, compressed.selection(max(counts))
            trial = self.variant(terms=count, degree=degree, state_lags=lags[0], control_lags=lags[1])
            trial._learn(data, count, *chosen[key])
            return trial

        self.terms_, lags, self.degree_ = best_candidate(
            settings, lambda setting: blocks.error(lambda part: learned(part, *setting), report=counter.advance)
        )
        self.record_lags(lags)
        data = self.regression(dataset, lags)
        compressed = Compressed.of(data, self.degree_)
        self._learn(data, self.terms_, compressed, compressed.selection(self.terms_))
        counter.advance()
        self.calibrate(dataset, rng, lambda: counter.advance(0))
        return self

    def _libraries(self, dataset: Dataset, pairs: list[tuple[int, int]]) -> list[tuple[tuple[int, int], int]]:
        """Return lags and degrees to try, without large libraries if there is a smaller one."""
        if self.degree is not None:
            return [(lags, self.degree) for lags in pairs]
        every = [(lags, degree) for lags in pairs for degree in DEGREES]
        sizes = [library_size(len(self._features_of(dataset.system, lags).names), degree) for lags, degree in every]
        smallest = min(DEGREES)
        pairs_sizes = zip(every, sizes, strict=True)
        return [
            library for library, size in pairs_sizes if size <= MAX_TERMS[self.lag_search] or library[1] == smallest
        ]

    def _learn(self, data: Regression, count: int, compressed: Compressed, order: list[IntArray]) -> None:
        """Fit the first ``count`` terms of each state by least squares."""
        coefficients = np.zeros((len(compressed.exponents), len(order)))
        for i, terms in enumerate(order):
            chosen, target = terms[:count], compressed.targets[:, i]
            coefficients[chosen, i], *_ = np.linalg.lstsq(compressed.library[:, chosen], target, rcond=None)
        self.set_learned(data, coefficients / compressed.sizes[:, None], compressed.exponents)


@dataclass(frozen=True)
class Compressed:
    """A least-squares problem in few rows: the QR decomposition of N rows of monomials and targets.

    All inner products of the columns of ``library`` (n, T) and ``targets`` (n, nx), and so all least-squares fits and
    their errors, equal those of all N rows; n is at most T + nx. The library holds monomials with ``exponents`` (T,
    inputs) of inputs divided by their size; ``sizes`` (T,) are the resulting divisors of the monomials.
    """

    library: Array
    targets: Array
    exponents: IntArray
    sizes: Array

    @classmethod
    def of(cls, data: Regression, degree: int) -> Compressed:
        """Compress ``data``, `ROWS` at a time."""
        size, exponents = root_mean_square(data.regressors), monomials(data.regressors.shape[1], degree)
        rest = np.empty((0, len(exponents) + data.targets.shape[1]))
        for first in range(0, len(data.regressors), ROWS):
            part = slice(first, first + ROWS)
            library = evaluate(data.regressors[part] / size, exponents)
            rows = np.concatenate([rest, np.column_stack([library, data.targets[part]])])
            rest = np.asarray(np.linalg.qr(rows, mode="r"))
        return cls(rest[:, : len(exponents)], rest[:, len(exponents) :], exponents, np.prod(size**exponents, axis=1))

    def selection(self, count: int) -> list[IntArray]:
        """Return, for each state, the terms in the order in which they enter."""
        return [forward_selection(self.library, target, count) for target in self.targets.T]


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
