"""How the benchmark's networks learn: random hidden layers, the last one by least squares, perhaps all of it after."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from sysid_evo.arrays import Array

ROWS = 1500  # transitions that a small network is trained on
EVALUATIONS = 60
RIDGE = 1e-5


def random_layer(inputs: Array, width: int, *, seed: int = 0) -> tuple[Array, Array]:
    """Return weights (n_in, width) and bias (width,) that bring ``inputs`` (N, n_in) to deviation 0.7."""
    rng = np.random.default_rng(seed)
    scale = np.maximum(inputs.std(axis=0), 1e-6)
    weights = rng.standard_normal((inputs.shape[1], width)) * 0.7 / np.sqrt(inputs.shape[1]) / scale[:, None]
    return weights, 0.3 * rng.standard_normal(width) - inputs.mean(axis=0) @ weights


def last_layer(units: Array, target: Array) -> tuple[Array, Array]:
    """Return weights (width, ...) and bias (...) of the ridge regression of ``target`` (N, ...) on ``units``."""
    columns = np.concatenate([units, np.ones((len(units), 1))], axis=1)
    ridge = RIDGE * len(units) * np.eye(columns.shape[1])
    found = np.linalg.solve(columns.T @ columns + ridge, columns.T @ target)
    return found[:-1], found[-1]


def small_network(inputs: Array, target: Array, hidden: int, *, seed: int = 0) -> tuple[Array, Array, Array, Array]:
    """Return weights and bias of both layers of a network that gives ``target`` (N,) for ``inputs`` (N, n_in).

    Shapes (n_in, hidden), (hidden,), (hidden,), (1,). Levenberg-Marquardt from a random hidden layer.
    """
    first, bias = random_layer(inputs, hidden, seed=seed)
    second, last = last_layer(np.tanh(inputs @ first + bias), target)
    chosen = np.random.default_rng(seed).permutation(len(inputs))[:ROWS]
    x, y, n_in = inputs[chosen], target[chosen], inputs.shape[1]

    def layers(flat: Array) -> tuple[Array, Array, Array, Array]:
        weights, *rest = np.split(flat, [n_in * hidden, (n_in + 1) * hidden, (n_in + 2) * hidden])
        return weights.reshape(n_in, hidden), *rest

    def error(flat: Array) -> Array:
        first, bias, second, last = layers(flat)
        return np.tanh(x @ first + bias) @ second + last - y

    def jacobian(flat: Array) -> Array:
        first, bias, second, _ = layers(flat)
        units = np.tanh(x @ first + bias)
        slope = (1.0 - units**2) * second
        by_first = (x[:, :, None] * slope[:, None, :]).reshape(len(x), -1)
        return np.concatenate([by_first, slope, units, np.ones((len(x), 1))], axis=1)

    begin = np.concatenate([first.ravel(), bias, second, [last]])
    return layers(least_squares(error, begin, jacobian, method="lm", max_nfev=EVALUATIONS).x)
