"""Lane code of the networks."""

from __future__ import annotations

import math

from sysid_evo.kernels import LANES, QUARTER, Layout, load, load_quarter, splat, splat_quarter, store, view


def recurrent(theta, memory, observation, raw, parameters, scratch):
    """h = tanh(W_in o + W_h h) and W_out h, see `RecurrentNetwork`."""
    for first in range(0, LANES, QUARTER):
        own, seen, before, after = (
            view(theta, first),
            view(observation, first),
            view(memory, first),
            view(scratch, first),
        )
        sums(own, seen, before, after, N_INPUTS, HIDDEN)
    for j in range(HIDDEN):
        store(memory, j * LANES, math.tanh(load(scratch, j * LANES)))
    outward = view(theta, (N_INPUTS + HIDDEN) * HIDDEN * LANES)
    for j in range(N_OUTPUTS):
        total = splat(0.0)
        for i in range(HIDDEN):
            total = total + load(outward, (i * N_OUTPUTS + j) * LANES) * load(memory, i * LANES)
        store(raw, j * LANES, total)


def sums(weights, seen, before, after, n_inputs, hidden):
    """W_in o + W_h h in sixteen lanes, six units at a time, then two, so that a row is read once for all."""
    j = 0
    while j + 6 <= hidden:
        a, b, c = splat_quarter(0.0), splat_quarter(0.0), splat_quarter(0.0)
        d, e, f = splat_quarter(0.0), splat_quarter(0.0), splat_quarter(0.0)
        for i in range(n_inputs + hidden):
            row = load_quarter(seen, i * LANES) if i < n_inputs else load_quarter(before, (i - n_inputs) * LANES)
            own = view(weights, (i * hidden + j) * LANES)
            a = a + load_quarter(own, 0) * row
            b = b + load_quarter(own, LANES) * row
            c = c + load_quarter(own, 2 * LANES) * row
            d = d + load_quarter(own, 3 * LANES) * row
            e = e + load_quarter(own, 4 * LANES) * row
            f = f + load_quarter(own, 5 * LANES) * row
        store(after, j * LANES, a)
        store(after, (j + 1) * LANES, b)
        store(after, (j + 2) * LANES, c)
        store(after, (j + 3) * LANES, d)
        store(after, (j + 4) * LANES, e)
        store(after, (j + 5) * LANES, f)
        j += 6
    while j + 2 <= hidden:
        a, b = splat_quarter(0.0), splat_quarter(0.0)
        for i in range(n_inputs + hidden):
            row = load_quarter(seen, i * LANES) if i < n_inputs else load_quarter(before, (i - n_inputs) * LANES)
            own = view(weights, (i * hidden + j) * LANES)
            a = a + load_quarter(own, 0) * row
            b = b + load_quarter(own, LANES) * row
        store(after, j * LANES, a)
        store(after, (j + 1) * LANES, b)
        j += 2
    if j < hidden:
        a = splat_quarter(0.0)
        for i in range(n_inputs + hidden):
            row = load_quarter(seen, i * LANES) if i < n_inputs else load_quarter(before, (i - n_inputs) * LANES)
            a = a + load_quarter(weights, (i * hidden + j) * LANES) * row
        store(after, j * LANES, a)


HEAD = Layout("n_layers", "widest")


def feed_forward(theta, memory, observation, raw, parameters, scratch):
    """W h + b, layer after layer, with tanh in between, see `FeedForward`."""
    n_layers, even = int(parameters[HEAD.n_layers]), view(scratch, 0)
    odd = view(scratch, int(parameters[HEAD.widest]) * LANES)
    weights = view(theta, 0)
    for layer in range(n_layers):
        n_in, n_out = int(parameters[HEAD.size + layer]), int(parameters[HEAD.size + layer + 1])
        source = observation if layer == 0 else (even if layer % 2 == 1 else odd)
        target = raw if layer == n_layers - 1 else (even if layer % 2 == 0 else odd)
        for j in range(n_out):
            total = load(weights, (n_in * n_out + j) * LANES)
            for i in range(n_in):
                total = total + load(weights, (i * n_out + j) * LANES) * load(source, i * LANES)
            store(target, j * LANES, total)
        if layer < n_layers - 1:
            for i in range(n_out * LANES):
                target[i] = math.tanh(target[i])
        weights = view(weights, (n_in + 1) * n_out * LANES)
