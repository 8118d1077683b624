"""Family gaussian_process: a sparse Gaussian process, its conditioning, inducing points and likelihood."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Self

import numpy as np
from scipy.linalg import blas, cho_solve, cholesky, lapack
from scipy.optimize import Bounds, minimize

from model_zoo.features import Features
from model_zoo.scaling import ChannelScaling, positive
from sysid_evo import Dataset, register_model
from sysid_evo.models.kernels import Predictor, gaussian_predictor, with_angles
from sysid_evo.models.learned import Declared, Numbers
from sysid_evo.models.parameters import Limit, at_least
from sysid_evo.models.stochastic import StochasticModel
from sysid_evo.progress import Counter, Progress
from sysid_evo.types import Array, IntArray
from sysid_evo.validation.folds import recording_or_time_folds
from sysid_evo.validation.held_out import HeldOutError, best_candidate, count_fits, lag_candidates

JITTER = 1e-6
"""Added to the diagonal of the covariance of the inducing points, as a share of the squared amplitude."""

LINEAR_RIDGE = 1e-3
TRIAL_INDUCING = 120
"""Largest number of inducing points while lags are chosen."""

SUBSETS, SUBSET_STEPS = 3, 300
"""Random parts of the data whose hyper-parameters are averaged, and steps of each at least: others vary too much."""


@register_model("gaussian_process")
class GaussianProcess(StochasticModel):
    """Sparse Gaussian process for the acceleration, added to a linear model that alone predicts far from the data.

    The linear part is fitted first, by ridge regression. The covariance is squared exponential with one length per
    input of (carry, control). Lengths, amplitude and noise maximise the marginal likelihood on random steps, 300 or
    ``inducing`` if these are more; the geometric mean of three such fits is used. The inducing points are chosen half
    at random, half where the variance given the others is largest. All data are then used by the deterministic training
    conditional (Seeger 2003; Quinonero Candela, Rasmussen 2005, equation 20): mean k_* S K_uf y / s^2, variance k_** -
    k_* (K_uu^-1 - S) k_*^T + s^2 with S = (K_uu + K_uf K_fu / s^2)^-1. Periodic states enter as sine and cosine. Lags
    left at None are chosen by the simulation error over one second on held-out blocks of time.

    With ``stochastic``, every step adds normal noise of that variance, scaled as in `StochasticModel` on held-out
    recordings (blocks of time of a single one).
    """

    knowledge = "dark grey"
    model_class = "neighbours"
    periodic = True
    precision = "float64"  # its large weights cancel
    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": {"inducing": 60, "state_lags": 0, "control_lags": 2},
        "paper": {"inducing": 400},
    }
    limits: ClassVar[dict[str, Limit]] = {"inducing": at_least(2)}

    inducing: int = 250
    state_lags: int | None = None
    control_lags: int | None = None
    max_steps: int | None = 100_000

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        options = lag_candidates(self.state_lags, self.control_lags, ((0, 0), (0, 3), (1, 3)))
        counter = Counter(progress, (count_fits(options) + 1) * dataset.system.nx + 1)
        blocks = HeldOutError.of(dataset, 1)
        lags = best_candidate(
            options, lambda lags: blocks.error(lambda learned: self._trial(learned, lags, rng, counter))
        )
        self.record_lags(lags)
        self._learn(dataset, rng, counter)
        if self.stochastic:
            parts = []  # models with the same hyper-parameters and inducing points
            for seen, unseen in recording_or_time_folds(dataset):
                parts.append((self.variant(stochastic=False), unseen))
                parts[-1][0]._condition(seen)
            self._spread_on(parts, rng, lambda: counter.advance(0), own_deviation=True)
        return self

    def learned_arrays(self) -> Mapping[str, Declared]:
        n, nx = Features(self.system, self.lags).n_carry + self.system.nu, self.system.nx
        return {
            "points_": ("points", n),
            "lengths_": Numbers(nx, n, least=np.finfo(float).tiny),
            "amplitude_": (nx,),
            "noise_": (nx,),
            "slope_": (n, nx),
            "intercept_": (nx,),
            "weights_": (nx, "points"),
            "reduction_": (nx, "points", "points"),
        }

    def acceleration(self, carry: Array, control: Array) -> Array:
        return self.predicted(carry, control, with_variance=False)[0]

    def _with_deviation(self, carry: Array, control: Array) -> tuple[Array, Array]:
        mean, variance = self.predicted(carry, control)
        after = self.system.integrate(carry[:, : self.system.nx], mean)
        return after, np.sqrt(variance) * self.system.dt

    def predictor(self) -> Predictor | None:
        if self.stochastic:
            return None
        bumps = gaussian_predictor(
            self.points_,
            self.lengths_,
            self.weights_ * self.amplitude_[:, None] ** 2,
            self.slope_,
            self.intercept_,
            Features(self.system, self.lags).n_carry,
        )
        return with_angles(bumps, self.system, self.lags)

    def predicted(self, carry: Array, control: Array, *, with_variance: bool = True) -> tuple[Array, Array]:
        """Return mean and variance (B, nx) of the acceleration; the variance is 0 unless ``with_variance``."""
        inputs = Features(self.system, self.lags)(carry, control)
        mean = np.empty((len(inputs), self.system.nx))
        variance = np.zeros_like(mean)
        for channel in range(self.system.nx):
            kernel = self._kernel(inputs, self.points_, channel)
            mean[:, channel] = kernel @ self.weights_[channel]
            if with_variance:
                explained = quadratic_form(kernel, self.reduction_[channel])
                prior = self.amplitude_[channel] ** 2
                variance[:, channel] = np.maximum(prior - explained, 0.0) + self.noise_[channel] ** 2
        return mean + inputs @ self.slope_ + self.intercept_, variance

    def _kernel(self, left: Array, right: Array, channel: int) -> Array:
        """Return the covariance (A, B) of inputs (A, n) and (B, n)."""
        found = squared_exponential(left / self.lengths_[channel], right / self.lengths_[channel])
        found *= self.amplitude_[channel] ** 2
        return found

    def _trial(
        self, dataset: Dataset, lags: tuple[int, int], rng: np.random.Generator, counter: Counter
    ) -> GaussianProcess:
        """Return a smaller model fitted to ``dataset``, with the state bounds of this one."""
        inducing = min(TRIAL_INDUCING, self.inducing)
        trial = self.variant(state_lags=lags[0], control_lags=lags[1], inducing=inducing, stochastic=False)
        trial._learn(dataset, rng, counter)
        return trial

    def _learn(self, dataset: Dataset, rng: np.random.Generator, counter: Counter) -> None:
        """Choose inducing points and hyper-parameters, then condition on all data."""
        inputs, targets = self._residuals(dataset)
        _, scale = ChannelScaling.of(dataset).of_inputs(self.layout)
        count, size = min(self.inducing, len(inputs)), positive(targets.std(axis=0))
        part = min(max(self.inducing, SUBSET_STEPS), len(inputs))
        subsets = [np.sort(rng.choice(len(inputs), size=part, replace=False)) for _ in range(SUBSETS)]
        nx, n = targets.shape[1], inputs.shape[1]
        self.lengths_, self.amplitude_, self.noise_ = np.empty((nx, n)), np.empty(nx), np.empty(nx)
        for channel in range(nx):
            found = [
                maximise_likelihood(
                    inputs[rows] / scale, targets[rows, channel] / size[channel], report=lambda: counter.advance(0)
                )
                for rows in subsets
            ]
            amplitude, lengths, noise = map(_geometric_mean, zip(*found, strict=True))
            self.amplitude_[channel], self.noise_[channel] = amplitude * size[channel], noise * size[channel]
            self.lengths_[channel] = lengths * scale
            counter.advance()
        self.points_ = inputs[inducing_rows(inputs, self.lengths_, count, rng)]
        self._condition(dataset)

    def _residuals(self, dataset: Dataset) -> tuple[Array, Array]:
        """Fit the linear part; return inputs (N, n) and residuals of the accelerations (N, nx)."""
        data = dataset.transitions(state_lags=self.lags[0], control_lags=self.lags[1], moving=True)
        inputs = Features(dataset.system, self.lags)(data.carry, data.control)
        targets = dataset.system.acceleration(data.state, data.after)
        _, scale = ChannelScaling.of(dataset).of_inputs(self.layout)
        centre = inputs.mean(axis=0)
        gram = (inputs - centre).T @ (inputs - centre) + LINEAR_RIDGE * len(inputs) * np.diag(scale**2)
        self.slope_ = np.linalg.solve(gram, (inputs - centre).T @ (targets - targets.mean(axis=0)))
        self.intercept_ = targets.mean(axis=0) - centre @ self.slope_
        return inputs, targets - inputs @ self.slope_ - self.intercept_

    def _condition(self, dataset: Dataset) -> None:
        """Set the linear part, weights and variance reduction from all of ``dataset``."""
        inputs, targets = self._residuals(dataset)
        points, nx = self.points_, targets.shape[1]
        identity = np.eye(len(points))
        self.weights_, self.reduction_ = np.empty((nx, len(points))), np.empty((nx, len(points), len(points)))
        for channel in range(nx):
            square = self.noise_[channel] ** 2
            own = self._kernel(points, points, channel) + JITTER * self.amplitude_[channel] ** 2 * identity
            cross = self._kernel(points, inputs, channel)
            posterior = cholesky_with_jitter(own + cross @ cross.T / square)
            self.weights_[channel] = cho_solve((posterior, True), cross @ targets[:, channel]) / square
            prior = cho_solve((cholesky_with_jitter(own), True), identity)
            self.reduction_[channel] = prior - cho_solve((posterior, True), identity)


def _geometric_mean(values: Sequence[Array | float]) -> Array:
    return np.asarray(np.exp(np.mean(np.log(np.array(values)), axis=0)))


POOL = 3000
"""Random steps from which inducing points are chosen."""
LEAST = 1e-10
"""Variance, as a share of the prior's, below which a step is known up to rounding."""


def inducing_rows(inputs: Array, lengths: Array, count: int, rng: np.random.Generator) -> IntArray:
    """Return ``count`` rows of ``inputs`` (N, n), sorted: half at random, the others where the variance is largest.

    The variance is the sum over K processes with ``lengths`` (K, n) and amplitude 1, given the rows chosen before
    (pivoted Cholesky; Burt, Rasmussen, van der Wilk 2020, section 4.2.2). Without the random half most rows would be
    outliers.
    """
    pool = rng.choice(len(inputs), size=min(POOL, len(inputs)), replace=False)
    count = min(count, len(pool))
    near, few = inputs[pool], count // 2
    left = np.ones((len(lengths), len(pool)))
    factors = np.zeros((len(lengths), count, len(pool)))
    chosen: list[int] = []
    for number in range(count):
        row = number if number < few else int(np.argmax(left.sum(axis=0)))  # -1 for rows already chosen
        chosen.append(row)
        for known, factor, length in zip(left, factors, lengths, strict=True):
            if known[row] <= LEAST:
                continue
            apart = (near - near[row]) / length
            covariance = np.exp(-0.5 * np.einsum("ij,ij->i", apart, apart))
            factor[number] = (covariance - factor[:number, row] @ factor[:number]) / np.sqrt(known[row])
            known -= factor[number] ** 2
        np.maximum(left, 0.0, out=left)
        left[:, chosen] = -1.0
    found: IntArray = np.sort(pool[chosen])
    return found


AMPLITUDE, LENGTH, NOISE = (1.0, 1e-2, 1e2), (3.0, 0.3, 100.0), (0.1, 1e-4, 1.0)
"""Initial value and bounds of the search; squares for amplitude and noise."""


def squared_exponential(left: Array, right: Array) -> Array:
    """Return exp(-|a - b|^2 / 2) for rows a of ``left`` (A, n) and b of ``right`` (B, n), (A, B)."""
    found = left @ right.T
    found -= 0.5 * np.sum(left**2, axis=1)[:, None]
    found -= 0.5 * np.sum(right**2, axis=1)
    np.minimum(found, 0.0, out=found)
    return np.asarray(np.exp(found, out=found))


def quadratic_form(rows: Array, matrix: Array) -> Array:
    """Return k M k^T (B,) for each row k of ``rows`` (B, n) and a symmetric ``matrix`` M (one triangle is used)."""
    product = blas.dtrmm(1.0, matrix.T, rows.T, lower=0)
    product *= 2.0
    product -= np.diag(matrix)[:, None] * rows.T
    return np.asarray(np.einsum("nb,nb->b", product, rows.T))


def negative_log_likelihood(logarithms: Array, inputs: Array, targets: Array) -> tuple[float, Array]:
    """Return minus the log marginal likelihood of ``targets`` (N,) at ``inputs`` (N, n), and its gradient.

    ``logarithms`` are those of amplitude^2, of the lengths (n,) and of noise^2; K = amplitude^2 E + noise^2 I, E the
    squared exponential. By a parameter p the gradient is tr((K^-1 - a a^T) dK/dp) / 2 with a = K^-1 y (Rasmussen,
    Williams 2006, equation 5.9). That of all lengths is two products with W = (K^-1 - a a^T) * amplitude^2 E, since
    the sum of W_ij (x_i - x_j)^2 is 2 (sum of x_i^2 W_ij - x^T W x).
    """
    square, noise = np.exp(logarithms[0]), np.exp(logarithms[-1])
    scaled = inputs / np.exp(logarithms[1:-1])
    smooth = square * squared_exponential(scaled, scaled)
    covariance = smooth + noise * np.eye(len(inputs))
    try:
        lower = cholesky(covariance, lower=True, check_finite=False)
    except np.linalg.LinAlgError:
        return np.inf, np.zeros_like(logarithms)
    weights = cho_solve((lower, True), targets, check_finite=False)
    value = 0.5 * targets @ weights + np.log(np.diag(lower)).sum() + 0.5 * len(inputs) * np.log(2.0 * np.pi)
    half, _ = lapack.dpotri(lower, lower=1)  # of the inverse; the other half stays zero
    apart = half + half.T - np.outer(weights, weights)
    apart[np.diag_indices(len(half))] -= np.diag(half)
    by_noise = 0.5 * noise * np.trace(apart)
    apart *= smooth
    moments = np.sum(scaled**2 * apart.sum(axis=1)[:, None], axis=0) - np.sum(scaled * (apart @ scaled), axis=0)
    return float(value), np.concatenate([[0.5 * apart.sum()], moments, [by_noise]])


def maximise_likelihood(inputs: Array, targets: Array, *, report: Callable[[], None]) -> tuple[float, Array, float]:
    """Return amplitude, lengths (n,) and noise, in units of targets and inputs, of the largest marginal likelihood.

    They are within the bounds; ``report`` is called before every evaluation.
    """

    def objective(logarithms: Array) -> tuple[float, Array]:
        report()
        return negative_log_likelihood(logarithms, inputs, targets)

    start, low, high = np.log([AMPLITUDE, *[LENGTH] * inputs.shape[1], NOISE]).T
    found = np.exp(minimize(objective, start, method="L-BFGS-B", jac=True, bounds=Bounds(low, high)).x)
    return float(np.sqrt(found[0])), found[1:-1], float(np.sqrt(found[-1]))


def cholesky_with_jitter(matrix: Array) -> Array:
    """Return the lower Cholesky factor of a covariance, its diagonal raised only as far as necessary.

    Noise-free data make the covariance singular in double precision: the diagonal then grows by 1e-12 of its mean, and
    tenfold until the matrix is positive definite.
    """
    raised, jitter = matrix, 1e-13 * float(np.trace(matrix)) / len(matrix)
    while True:
        try:
            return cholesky(raised, lower=True)
        except np.linalg.LinAlgError:
            jitter *= 10.0
            raised = matrix + jitter * np.eye(len(matrix))
