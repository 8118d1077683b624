"""Radial network for the residual of the physics; it is zero far from the data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve

from model_zoo.features import Features
from model_zoo.gaussian_process import JITTER, cholesky_with_jitter, maximise_likelihood, squared_exponential
from model_zoo.grey_box.equation import GreyBoxEquation
from model_zoo.scaling import deviation, positive
from sysid_evo.models.kernels import Predictor, gaussian_predictor, with_angles
from sysid_evo.types import Array


@dataclass(frozen=True)
class ResidualNetwork:
    """Mean of a sparse Gaussian process without a trend for each measured state.

    It is a sum of radial functions at ``points`` (M, n). ``lengths`` (nx, n) are infinite for inputs without effect;
    ``weights`` (nx, M) include the amplitudes. Far from the data, in units of the lengths, it is zero (deterministic
    training conditional: Quinonero Candela, Rasmussen 2005).
    """

    points: Array
    lengths: Array
    weights: Array

    def __call__(self, inputs: Array) -> Array:
        """Return the addition to the rates of the measured states, (B, nx)."""
        bumps = [squared_exponential(inputs / one, self.points / one) for one in self.lengths]
        return np.stack([bump @ weight for bump, weight in zip(bumps, self.weights, strict=True)], axis=1)

    def predictor(self, structure: GreyBoxEquation) -> Predictor:
        """Return the compiled form, of the structure's carry and the control."""
        nx, n = self.lengths.shape
        n_carry = inputs_of(structure).n_carry
        none = np.zeros((n, nx)), np.zeros(nx)
        bumps = gaussian_predictor(self.points, self.lengths, self.weights, *none, n_carry)
        return with_angles(bumps, structure.extended, (0, structure.delay))


def inputs_of(structure: GreyBoxEquation) -> Features:
    """Return the inputs of the residual, from carry and control."""
    return Features(structure.extended, (0, structure.delay))


def learned_shape(
    structure: GreyBoxEquation,
    inputs: Array,
    targets: Array,
    points: int,
    rng: np.random.Generator,
    report: Callable[[], None],
) -> tuple[ResidualNetwork, Array]:
    """Return a residual with points, lengths and amplitudes (as weights of one) chosen, and the noise (nx,).

    Lengths maximise the marginal likelihood at ``points`` random samples. Actuators with lags replace the commands as
    inputs.
    """
    rows = np.sort(rng.choice(len(inputs), size=min(points, len(inputs)), replace=False))
    counted = len(structure.extended.regressor_names) if structure.lagged else inputs.shape[1]
    scale, size = deviation(inputs)[:counted], positive(targets.std(axis=0))
    nx = targets.shape[1]
    lengths, amplitude, noise = np.full((nx, inputs.shape[1]), np.inf), np.empty(nx), np.empty(nx)
    for j in range(nx):
        found = maximise_likelihood(inputs[rows, :counted] / scale, targets[rows, j] / size[j], report=report)
        amplitude[j], lengths[j, :counted], noise[j] = found[0] * size[j], found[1] * scale, found[2] * size[j]
    return ResidualNetwork(inputs[rows], lengths, np.repeat(amplitude[:, None], len(rows), axis=1)), noise


def conditioned(shape: ResidualNetwork, noise: Array, inputs: Array, targets: Array) -> ResidualNetwork:
    """Return the residual of this shape fitted to all of ``inputs`` (N, n) and ``targets`` (N, nx)."""
    weights = np.empty_like(shape.weights)
    for j, length in enumerate(shape.lengths):
        square = shape.weights[j, 0] ** 2
        points = shape.points / length
        own = square * (squared_exponential(points, points) + JITTER * np.eye(len(points)))
        cross = square * squared_exponential(points, inputs / length)
        posterior = cholesky_with_jitter(own + cross @ cross.T / noise[j] ** 2)
        weights[j] = square * cho_solve((posterior, True), cross @ targets[:, j]) / noise[j] ** 2
    return replace(shape, weights=weights)
