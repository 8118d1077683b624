"""The Gaussian process of the zoo and that of scikit-learn."""

import warnings

import numpy as np
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from model_zoo.gaussian_process import maximise_likelihood, negative_log_likelihood


def test_the_maximum_is_the_one_that_scikit_learn_finds():
    rng = np.random.default_rng(0)
    inputs = rng.standard_normal((40, 3))
    targets = np.sin(2.0 * inputs[:, 0]) + 0.1 * rng.standard_normal(40)
    kernel = ConstantKernel(1.0, (1e-2, 1e2)) * RBF(np.full(3, 3.0), (0.3, 100.0)) + WhiteKernel(0.1, (1e-4, 1.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # two inputs do not matter: their lengths are at the bound
        theirs = GaussianProcessRegressor(kernel).fit(inputs, targets)
    amplitude, lengths, noise = maximise_likelihood(inputs, targets, report=lambda: None)
    logarithms = np.log([amplitude**2, *lengths, noise**2])
    value, _ = negative_log_likelihood(logarithms, inputs, targets)
    np.testing.assert_allclose(-value, theirs.log_marginal_likelihood_value_, atol=1e-4)
    np.testing.assert_allclose(logarithms, theirs.kernel_.theta, atol=0.01)
