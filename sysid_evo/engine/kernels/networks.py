"""Multi-layer perceptrons over lanes: one network, or the mean of several of the same shape."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.engine.kernels.runge_kutta import move_rows
from sysid_evo.engine.kernels.stepping import copy
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import LANES, Layout, Predictor, load, splat, store, view

HEAD = Layout("n_networks", "n_layers", "n_carry", "n_control")

Layers: TypeAlias = Sequence[tuple[Array, Array]]
"""Weights (n_in, n_out) and bias (n_out,) of every layer; hidden layers are tanh, the last is linear."""


def network_predictor(networks: Sequence[Layers], n_carry: int, n_control: int) -> Predictor:
    """Return a predictor of the mean output of several networks of one shape.

    Their inputs are ``n_carry`` rows of the carry, then ``n_control`` of the control.
    """
    return _predictor(network, networks, n_carry, n_control)


def separate_networks_predictor(networks: Sequence[Layers], n_carry: int, n_control: int) -> Predictor:
    """Return a predictor whose outputs are those of the first network, then of the second, and so on.

    The networks have one shape and the same inputs, those of `network_predictor`.
    """
    return _predictor(separate_networks, networks, n_carry, n_control)


def _predictor(function: Any, networks: Sequence[Layers], n_carry: int, n_control: int) -> Predictor:
    sizes = [networks[0][0][0].shape[0], *(weights.shape[1] for weights, _ in networks[0])]
    if sizes[0] != n_carry + n_control or any(
        [weights.shape[1] for weights, _ in layers] != sizes[1:] for layers in networks
    ):
        raise InvalidArgument(f"networks: expected {n_carry} + {n_control} inputs and equal shapes, got {sizes}")
    flat = [np.concatenate([bias, weights.ravel()]) for layers in networks for weights, bias in layers]
    parameters = HEAD.pack(
        sizes, *flat, n_networks=len(networks), n_layers=len(sizes) - 1, n_carry=n_carry, n_control=n_control
    )
    return Predictor(function, parameters, n_scratch=sizes[0] + 3 * max(sizes))


def network(x, u, p, y, scratch):
    """Write the mean output of all networks (a predictor, see `stepping`)."""
    n_networks = int(p[HEAD.n_networks])
    room, weights = view(scratch, gather(x, u, p, scratch)), view(p, HEAD.size + int(p[HEAD.n_layers]) + 1)
    n_out = int(p[HEAD.size + int(p[HEAD.n_layers])])
    weights = view(weights, forward(p, weights, scratch, room, y))
    if n_networks > 1:
        other = view(room, 2 * widest(p) * LANES)
        for _ in range(1, n_networks):
            weights = view(weights, forward(p, weights, scratch, room, other))
            move_rows(y, other, 1.0, y, n_out)
        share = 1.0 / float(n_networks)
        for i in range(n_out * LANES):
            y[i] *= share


def separate_networks(x, u, p, y, scratch):
    """Write the outputs of every network one after the other (a predictor, see `stepping`)."""
    room, weights = view(scratch, gather(x, u, p, scratch)), view(p, HEAD.size + int(p[HEAD.n_layers]) + 1)
    size = int(p[HEAD.size + int(p[HEAD.n_layers])]) * LANES
    for member in range(int(p[HEAD.n_networks])):
        weights = view(weights, forward(p, weights, scratch, room, view(y, member * size)))


def gather(x, u, p, scratch):
    """Write the inputs of the networks to the head of ``scratch``; return where they end."""
    n_carry, n_control = int(p[HEAD.n_carry]), int(p[HEAD.n_control])
    copy(x, scratch, n_carry * LANES)
    copy(u, view(scratch, n_carry * LANES), n_control * LANES)
    return (n_carry + n_control) * LANES


def widest(p):
    """Return the number of rows of the widest layer."""
    rows = 0
    for layer in range(int(p[HEAD.n_layers]) + 1):
        rows = max(rows, int(p[HEAD.size + layer]))
    return rows


def forward(p, weights, inputs, room, y):
    """Write the output of one network; return how many weights it has."""
    n_layers, even, place = int(p[HEAD.n_layers]), room, 0
    odd = view(room, widest(p) * LANES)
    for layer in range(n_layers):
        n_in, n_out = int(p[HEAD.size + layer]), int(p[HEAD.size + layer + 1])
        source = inputs if layer == 0 else (even if layer % 2 == 1 else odd)
        if layer == n_layers - 1:
            dense(source, n_in, view(weights, place), y, n_out)
        else:
            target = even if layer % 2 == 0 else odd
            dense(source, n_in, view(weights, place), target, n_out)
            squash(target, n_out * LANES)
        place += n_out * (n_in + 1)
    return place


def squash(x, count):
    """Replace ``count`` numbers, whole rows, by their tanh."""
    for first in range(0, count, LANES):
        store(x, first, math.tanh(load(x, first)))


def dense(x, n_in, p, y, n_out):
    """y_j = b_j + sum_i W_ij x_i for every lane, four outputs at a time so that a row is read once for all."""
    j = 0
    while j + 4 <= n_out:
        bias = view(p, j)
        a, b, c, d = splat(bias[0]), splat(bias[1]), splat(bias[2]), splat(bias[3])
        for i in range(n_in):
            row, w = load(x, i * LANES), view(p, (1 + i) * n_out + j)
            a = a + splat(w[0]) * row
            b = b + splat(w[1]) * row
            c = c + splat(w[2]) * row
            d = d + splat(w[3]) * row
        store(y, j * LANES, a)
        store(y, (j + 1) * LANES, b)
        store(y, (j + 2) * LANES, c)
        store(y, (j + 3) * LANES, d)
        j += 4
    while j < n_out:
        a = splat(p[j])
        for i in range(n_in):
            a = a + splat(p[n_out + i * n_out + j]) * load(x, i * LANES)
        store(y, j * LANES, a)
        j += 1
