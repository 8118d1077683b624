"""The marginal likelihood of a Gaussian process with one length an input, and what maximises it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import blas, cho_solve, cholesky, lapack
from scipy.optimize import Bounds, minimize

from sysid_evo.arrays import Array

AMPLITUDE, LENGTH, NOISE = (1.0, 1e-2, 1e2), (3.0, 0.3, 100.0), (0.1, 1e-4, 1.0)
"""Where the search begins, and its bounds: squares for amplitude and noise."""


@dataclass(frozen=True)
class Likely:
    """Amplitude, lengths (n,) and noise of a process, in units of targets and inputs."""

    amplitude: float
    lengths: Array
    noise: float


def squared_exponential(left: Array, right: Array) -> Array:
    """Return exp(-|a - b|^2 / 2) for rows a of ``left`` (A, n) and b of ``right`` (B, n), (A, B)."""
    found = left @ right.T
    found -= 0.5 * np.sum(left**2, axis=1)[:, None]
    found -= 0.5 * np.sum(right**2, axis=1)
    np.minimum(found, 0.0, out=found)
    return np.asarray(np.exp(found, out=found))


def quadratic_form(rows: Array, matrix: Array) -> Array:
    """Return k M k^T for each row k of ``rows`` (B, n) and a symmetric ``matrix`` M (n, n), (B,).

    Twice that of M's triangle, which is half the work, less that of the diagonal, which is counted twice then.
    """
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


def most_likely(inputs: Array, targets: Array, *, told: Callable[[], None]) -> Likely:
    """Return what maximises the marginal likelihood within the bounds; ``told`` is called before every evaluation."""

    def objective(logarithms: Array) -> tuple[float, Array]:
        told()
        return negative_log_likelihood(logarithms, inputs, targets)

    start, low, high = np.log([AMPLITUDE, *[LENGTH] * inputs.shape[1], NOISE]).T
    found = np.exp(minimize(objective, start, method="L-BFGS-B", jac=True, bounds=Bounds(low, high)).x)
    return Likely(float(np.sqrt(found[0])), found[1:-1], float(np.sqrt(found[-1])))


def factor(matrix: Array) -> Array:
    """Return Cholesky's lower factor of a covariance, its diagonal raised as little as makes it one.

    Data without noise make the covariance singular in double precision: the diagonal then grows by
    1e-12 of its mean, and tenfold until it is positive definite.
    """
    raised, jitter = matrix, 1e-13 * float(np.trace(matrix)) / len(matrix)
    while True:
        try:
            return cholesky(raised, lower=True)
        except np.linalg.LinAlgError:
            jitter *= 10.0
            raised = matrix + jitter * np.eye(len(matrix))
