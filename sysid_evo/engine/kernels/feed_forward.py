"""The feed-forward network over lanes: every lane has a parameter vector of its own."""

from __future__ import annotations

import math

from sysid_evo.kernels import LANES, ControllerKernel, KernelSource, Layout, load, store, view

HEAD = Layout("n_layers", "widest")


def feed_forward_kernel(sizes: tuple[int, ...]) -> ControllerKernel:
    """Return the compiled form of `FeedForward` with layers of these sizes, inputs first."""
    parameters = HEAD.pack(sizes, n_layers=len(sizes) - 1, widest=max(sizes))
    return ControllerKernel(KernelSource(feed_forward), parameters, 2 * max(sizes), before_tanh=True)


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
