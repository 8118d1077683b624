"""Covariance matrix adaptation (CMA-ES) in plain NumPy, with a wide initial distribution."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.strategies.strategy import EvolutionStrategy, StrategyState
from sysid_evo.randomness import keyed_generator
from sysid_evo.registry.registry import register_strategy
from sysid_evo.types import Array, IntArray, check_shape

ELITE = 15
"""Number of candidates of the last generation in the elite, in addition to the mean."""
CONDITION = 1e14
"""Largest condition number of C. Above it, small eigenvalues are rounding errors, and some are negative."""
SHRINKAGE = 0.01
"""The smallest eigenvalue shrinks at most to this share in one decomposition. With few candidates in one or two
dimensions, an update with axes that are several generations old could make it negative."""
SMALLEST, LARGEST = 1e-100, 1e100
"""Bounds of sigma and of the eigenvalues of C, within which all candidates are finite."""


@dataclass(frozen=True)
class LearningRates:
    """The constants of CMA-ES for n parameters and a population of lambda candidates.

    ``w`` (lambda,): weights, best candidate first; the first ``mu`` are positive and have the sum 1. ``gap``: number of
    generations between two decompositions of C. ``chi_n``: E ||N(0, I)||.
    """

    w: Array
    mu: int
    mu_eff: float
    c_sigma: float
    d_sigma: float
    c_c: float
    c_1: float
    c_mu: float
    gap: float
    chi_n: float

    @classmethod
    def of(cls, n: int, population: int) -> LearningRates:
        """Return the constants of the tutorial's table 1, two of them as in version 4.5 of its author's ``cma``."""
        w, mu = math.log((population + 1) / 2) - np.log(np.arange(1, population + 1)), population // 2  # (49)
        better, worse = w[:mu], w[mu:]
        mu_eff, mu_eff_minus = (float(part.sum() ** 2 / (part**2).sum()) for part in (better, worse))
        # (55) as in cma: 3 instead of 5, and more damping for large populations. With 50 candidates a sphere then takes
        # a quarter more evaluations.
        c_sigma = min(0.5, (mu_eff + 2) / (n + mu_eff + 3))
        more = max(1.0, 3 * (1 - 0.5 ** (n / 9)))
        d_sigma = 1 + 2 * max(0.0, more * math.sqrt((mu_eff - 1) / (n + 1)) - 1) + c_sigma
        c_c = (4 + mu_eff / n) / (n + 4 + 2 * mu_eff / n)  # (56)
        c_1 = min(2.0, population / 3) / ((n + 1.3) ** 2 + mu_eff)  # (57), less for fewer than 6, as in cma
        c_mu = min(1 - c_1, 2 * (0.25 + mu_eff + 1 / mu_eff - 2) / ((n + 2) ** 2 + mu_eff))  # (58)
        no_decay, like_mu = 1 + c_1 / c_mu, 1 + 2 * mu_eff_minus / (mu_eff + 2)  # (50), (51)
        alpha = min(no_decay, like_mu, (1 - c_1 - c_mu) / (n * c_mu))  # (52): C stays positive definite
        w = np.concatenate([better / better.sum(), alpha * worse / -worse.sum()])  # (53)
        # Appendix B.2 decomposes C ten times as often, which took most of the time in a hundred dimensions. With this
        # gap C changes by about 1 / n between decompositions, and the candidates differ little.
        gap = 1 / (n * (c_1 + c_mu))
        chi_n = math.sqrt(2) * math.exp(math.lgamma((n + 1) / 2) - math.lgamma(n / 2))
        return cls(w, mu, mu_eff, c_sigma, d_sigma, c_c, c_1, c_mu, gap, chi_n)


@register_strategy("cma_es")
class CmaEs(EvolutionStrategy):
    """CMA-ES with cumulative step-size adaptation and negative weights (active CMA).

    A generation is ``population`` candidates drawn from the adapted normal distribution, and the mean of that
    distribution. The mean does not enter the update; under noisy fitness it is often the best candidate. ``sigma`` is
    the initial standard deviation around ``initial`` (default 0), in units of ``first_steps`` (n_parameters,) for each
    parameter (default 1). The default is wide, so that the units of a network
    saturate; racing controllers were found there. Random numbers come from a generator keyed by (seed, generation).

    Source: Hansen, "The CMA evolution strategy: a tutorial" (2016, revised 2023, arXiv:1604.00772), appendix A. The
    letters are the tutorial's, and numbers in brackets are those of its equations.
    """

    def __init__(
        self, *, n_parameters: int, seed: int, population: int = 50, sigma: float = 3.0, initial: Array | None = None,
        first_steps: Array | None = None,
    ) -> None:  # fmt: skip
        if n_parameters < 1 or population < 4 or not 0.0 < sigma < np.inf:
            raise InvalidArgument(
                f"cma_es: expected n_parameters >= 1, population >= 4, sigma > 0, "
                f"got {n_parameters}, {population}, {sigma}"
            )
        self.n_parameters, self.seed = n_parameters, seed
        self.population, self.sigma = population, sigma
        self.rates = LearningRates.of(n_parameters, population)
        centre = np.zeros(n_parameters) if initial is None else check_shape("initial", initial, (n_parameters,))
        self._m, self._sigma = centre.copy(), float(sigma)
        ones = np.ones(n_parameters)
        lengths = ones if first_steps is None else check_shape("first_steps", first_steps, (n_parameters,))
        self._C, self._B, self._D = np.diag(lengths**2), np.eye(n_parameters), lengths.copy()
        self._p_c, self._p_sigma = np.zeros(n_parameters), np.zeros(n_parameters)
        self._elite = centre[None].copy()
        self.generation = self._decomposed = 0

    @property
    def elite(self) -> Array:
        return self._elite

    @property
    def state(self) -> StrategyState:
        arrays = {"mean": self._m, "covariance": self._C, "axes": self._B, "lengths": self._D, "elite": self._elite}
        arrays |= {"path": self._p_c, "sigma_path": self._p_sigma}
        copies = {name: array.copy() for name, array in arrays.items()}
        return {"generation": self.generation, "decomposed": self._decomposed, "sigma": self._sigma, **copies}

    def restore(self, state: StrategyState) -> None:
        n = self.n_parameters
        shapes: dict[str, tuple[int | None, ...]] = dict.fromkeys(("mean", "lengths", "path", "sigma_path"), (n,))
        shapes |= {"covariance": (n, n), "axes": (n, n), "elite": (None, n)}
        expected = {*shapes, "generation", "decomposed", "sigma"}
        if set(state) != expected:
            raise InvalidArgument(
                f"cma_es: expected a state with {', '.join(sorted(expected))}, "
                f"got {', '.join(sorted(state)) or 'nothing'}"
            )
        # Copies are C-ordered, like the original arrays: another order changes the rounding of products.
        found = {name: check_shape(f"state: {name}", state[name], shape).copy() for name, shape in shapes.items()}
        self._m, self._C, self._B, self._D = (found[name] for name in ("mean", "covariance", "axes", "lengths"))
        self._p_c, self._p_sigma, self._elite = (found[name] for name in ("path", "sigma_path", "elite"))
        self.generation, self._decomposed = int(state["generation"]), int(state["decomposed"])
        self._sigma = float(state["sigma"])

    def ask(self) -> Array:
        rng = keyed_generator(self.seed, self.generation)
        self._z = rng.standard_normal((self.population, self.n_parameters))  # (38), one row for each candidate
        self._y = (self._z * self._D) @ self._B.T  # (39)
        return np.concatenate([self._m + self._sigma * self._y, self._m[None]])  # (40)

    def _update(self, population: Array, fitness: Array, behaviour: Array) -> None:
        if len(population) != self.population + 1:
            raise InvalidArgument(f"cma_es: expected {self.population + 1} candidates, got {len(population)}")
        best = np.argsort(-fitness, kind="stable")  # only ranks are used, so -inf is a valid fitness
        mean = self.population
        kept = best[:ELITE] if mean in best[:ELITE] else [*best[:ELITE], mean]
        self._elite = population[kept].copy()
        self._adapt(best[best != mean])
        self.generation += 1
        if self.generation >= self._decomposed + self.rates.gap:
            self._decompose()

    def _adapt(self, best_first: IntArray) -> None:
        """Update mean, step size and covariance from the candidates' ranking."""
        n, rates, w = self.n_parameters, self.rates, self.rates.w
        mu_eff, c_sigma, c_c, c_1, c_mu = rates.mu_eff, rates.c_sigma, rates.c_c, rates.c_1, rates.c_mu
        z, y = self._z[best_first], self._y[best_first]
        z_w, y_w = (w[: rates.mu] @ steps[: rates.mu] for steps in (z, y))  # (41)
        self._m = self._m + self._sigma * y_w  # (42)
        isotropic = self._B @ z_w  # C^(-1/2) <y>_w, since y = B D z; this avoids a division by D or sigma
        self._p_sigma = (1 - c_sigma) * self._p_sigma + math.sqrt(c_sigma * (2 - c_sigma) * mu_eff) * isotropic  # (43)
        length = float(np.linalg.norm(self._p_sigma)) / rates.chi_n
        factor = math.exp(min(1.0, c_sigma / rates.d_sigma * (length - 1)))
        self._sigma = min(max(self._sigma * factor, SMALLEST), LARGEST)  # (44)
        # While sigma grows fast, p_c is not updated, so that C does not grow instead of sigma.
        expected = math.sqrt(1 - (1 - c_sigma) ** (2 * (self.generation + 1)))  # the path began with 0
        h_sigma = float(length < (1.4 + 2 / (n + 1)) * expected)
        self._p_c = (1 - c_c) * self._p_c + h_sigma * math.sqrt(c_c * (2 - c_c) * mu_eff) * y_w  # (45)
        w_o = w * np.where(w >= 0, 1.0, n / (z**2).sum(axis=1))  # (46)
        kept = 1 + c_1 * (1 - h_sigma) * c_c * (2 - c_c) - c_1 - c_mu * w.sum()
        self._C = kept * self._C + c_1 * np.outer(self._p_c, self._p_c) + c_mu * (w_o[:, None] * y).T @ y  # (47)

    def _decompose(self) -> None:
        """Compute the axes B and their lengths D, C = B D^2 B^T."""
        squares, axes = np.linalg.eigh((self._C + self._C.T) / 2)
        least = max(SHRINKAGE * self._D.min() ** 2, squares[-1] / CONDITION, SMALLEST)
        limited = np.clip(squares, least, LARGEST)
        self._B, self._D = axes, np.sqrt(limited)
        if (limited != squares).any():
            self._C = (self._B * limited) @ self._B.T
        self._decomposed = self.generation
