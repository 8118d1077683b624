"""The mean of a sparse Gaussian process over lanes: a linear part and squared-exponential kernels."""

from __future__ import annotations

import math

import numpy as np

from sysid_evo.kernels import LANES, Layout, Predictor, load, splat, store, view
from sysid_evo.models.kernels.stepping import copy
from sysid_evo.types import Array, check_shape

HEAD = Layout("n_carry", "n_control", "n_out", "n_points")


def gaussian_predictor(
    points: Array, lengths: Array, weights: Array, slope: Array, intercept: Array, n_carry: int
) -> Predictor:
    """Return a predictor of y_j = intercept_j + z slope_j + sum_m weights_jm exp(-|(z - points_m) / lengths_j|^2 / 2).

    z is the carry's rows, then the control's: ``points`` (M, n), ``lengths`` (n_out, n), ``weights``
    (n_out, M), ``slope`` (n, n_out), ``intercept`` (n_out,).
    """
    n_out, n = lengths.shape
    check_shape("points", points, (None, n))
    check_shape("weights", weights, (n_out, len(points)))
    check_shape("slope", slope, (n, n_out))
    check_shape("intercept", intercept, (n_out,))
    channels = [
        np.concatenate(
            [
                [intercept[j]],
                slope[:, j],
                math.sqrt(0.5) / lengths[j],
                np.concatenate([weights[j][:, None], points * (math.sqrt(0.5) / lengths[j])], axis=1).ravel(),
            ]
        )
        for j in range(n_out)
    ]
    parameters = HEAD.pack(*channels, n_carry=n_carry, n_control=n - n_carry, n_out=n_out, n_points=len(points))
    return Predictor(bumps, parameters, n_scratch=2 * n + 1, reads=(n_carry, n - n_carry), writes=n_out)


def bumps(x, u, p, y, scratch):
    """Write the mean of every output (a predictor, see `stepping`)."""
    n_carry, n_control, n_points = int(p[HEAD.n_carry]), int(p[HEAD.n_control]), int(p[HEAD.n_points])
    n = n_carry + n_control
    inputs, scaled = scratch, view(scratch, n * LANES)
    bump = view(scaled, n * LANES)
    copy(x, inputs, n_carry * LANES)
    copy(u, view(inputs, n_carry * LANES), n_control * LANES)
    own = view(p, HEAD.size)
    for output in range(int(p[HEAD.n_out])):
        total = splat(own[0])
        for i in range(n):
            row = load(inputs, i * LANES)
            total = total + splat(own[1 + i]) * row
            store(scaled, i * LANES, splat(own[1 + n + i]) * row)
        there = view(y, output * LANES)
        store(there, 0, total)
        point = view(own, 1 + 2 * n)
        for _ in range(n_points):
            square = splat(0.0)
            for i in range(n):
                off = load(scaled, i * LANES) - splat(point[1 + i])
                square = square + off * off
            store(bump, 0, square)
            weight = point[0]
            for lane in range(LANES):
                there[lane] += weight * math.exp(-bump[lane])
            point = view(point, n + 1)
        own = point
