"""How the benchmark's networks learn."""

from __future__ import annotations

import warnings

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPRegressor

from sysid_evo.arrays import Array

ITERATIONS = 150


def trained_network(
    inputs: Array, target: Array, hidden: tuple[int, ...], *, seed: int = 0
) -> list[tuple[Array, Array]]:
    """Return weights (n_in, n_out) and bias (n_out,) of every layer of a tanh network: ``target`` (N, n) by ``inputs``.

    It is stopped early, which is good enough to drive on.
    """
    network = MLPRegressor(
        hidden_layer_sizes=hidden, activation="tanh", solver="lbfgs", alpha=1e-3, max_iter=ITERATIONS, random_state=seed
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        network.fit(inputs, target if target.shape[1] > 1 else target[:, 0])
    return [
        (np.asarray(weights, dtype=np.float64), np.asarray(bias, dtype=np.float64))
        for weights, bias in zip(network.coefs_, network.intercepts_, strict=True)
    ]
