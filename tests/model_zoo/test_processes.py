"""The likelihood of a Gaussian process, its gradient and its maximum are right."""

from __future__ import annotations

import warnings

import numpy as np

from model_zoo.gaussian_process import most_likely, negative_log_likelihood, quadratic_form, squared_exponential
from sysid_evo.types import Array


def waves(n_inputs: int = 3) -> tuple[Array, Array]:
    """Return inputs (N, n) and targets (N,) that depend on the first input, with noise."""
    rng = np.random.default_rng(0)
    inputs = rng.standard_normal((40, n_inputs))
    return inputs, np.sin(2.0 * inputs[:, 0]) + 0.1 * rng.standard_normal(40)


def test_the_gradient_of_the_likelihood_is_its_derivative() -> None:
    inputs, targets = waves()
    at = np.log([1.3, 0.8, 2.0, 3.0, 0.05])
    _, gradient = negative_log_likelihood(at, inputs, targets)
    for place, step in enumerate(1e-6 * np.eye(len(at))):
        ahead, back = (negative_log_likelihood(at + sign * step, inputs, targets)[0] for sign in (1.0, -1.0))
        np.testing.assert_allclose(gradient[place], (ahead - back) / 2e-6, atol=1e-6)


def test_the_maximum_is_the_one_that_scikit_learn_finds() -> None:
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    inputs, targets = waves()
    kernel = ConstantKernel(1.0, (1e-2, 1e2)) * RBF(np.full(3, 3.0), (0.3, 100.0)) + WhiteKernel(0.1, (1e-4, 1.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # two inputs do not matter: their lengths are at the bound
        theirs = GaussianProcessRegressor(kernel).fit(inputs, targets)
    ours = most_likely(inputs, targets, told=lambda: None)
    logarithms = np.log([ours.amplitude**2, *ours.lengths, ours.noise**2])
    value, _ = negative_log_likelihood(logarithms, inputs, targets)
    np.testing.assert_allclose(-value, theirs.log_marginal_likelihood_value_, atol=1e-4)
    np.testing.assert_allclose(logarithms, theirs.kernel_.theta, atol=0.01)


def test_the_squared_exponential_is_what_it_says() -> None:
    left, right = np.random.default_rng(1).standard_normal((2, 5, 3))
    apart = left[:, None] - right
    np.testing.assert_allclose(squared_exponential(left, right), np.exp(-0.5 * np.sum(apart**2, axis=2)), rtol=1e-12)


def test_a_quadratic_form_by_half_a_matrix_is_that_of_the_whole() -> None:
    rng = np.random.default_rng(2)
    rows, root = rng.standard_normal((7, 5)), rng.standard_normal((5, 5))
    matrix = root + root.T
    np.testing.assert_allclose(quadratic_form(rows, matrix), np.sum((rows @ matrix) * rows, axis=1), atol=1e-12)
