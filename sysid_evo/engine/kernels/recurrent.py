"""The recurrent network over lanes: every lane has a parameter vector of its own."""

from __future__ import annotations

import math

from sysid_evo.engine.compiled.dialect import KernelSource
from sysid_evo.engine.compiled.kernel import ControllerKernel
from sysid_evo.engine.compiled.lanes import LANES, load, splat, store
from sysid_evo.engine.compiled.layout import Layout

HEAD = Layout("n_inputs", "hidden", "n_outputs")


def recurrent_kernel(n_inputs: int, hidden: int, n_outputs: int) -> ControllerKernel:
    """Return the compiled form of `RecurrentNetwork`."""
    sizes = HEAD.pack(n_inputs=n_inputs, hidden=hidden, n_outputs=n_outputs)
    return ControllerKernel(KernelSource(recurrent), sizes, hidden)


def recurrent(theta, memory, observation, raw, parameters, scratch):
    """h = tanh(W_in o + W_h h), y = tanh(W_out h), see `RecurrentNetwork`."""
    n_inputs, hidden, n_outputs = (
        int(parameters[HEAD.n_inputs]),
        int(parameters[HEAD.hidden]),
        int(parameters[HEAD.n_outputs]),
    )
    for j in range(hidden):
        total = splat(0.0)
        for i in range(n_inputs):
            total = total + load(theta, (i * hidden + j) * LANES) * load(observation, i * LANES)
        for i in range(hidden):
            total = total + load(theta, ((n_inputs + i) * hidden + j) * LANES) * load(memory, i * LANES)
        store(scratch, j * LANES, total)
    for i in range(hidden * LANES):
        memory[i] = math.tanh(scratch[i])
    outward = (n_inputs + hidden) * hidden
    for j in range(n_outputs):
        total = splat(0.0)
        for i in range(hidden):
            total = total + load(theta, (outward + i * n_outputs + j) * LANES) * load(memory, i * LANES)
        store(raw, j * LANES, total)
    for i in range(n_outputs * LANES):
        raw[i] = math.tanh(raw[i])
