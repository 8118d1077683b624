"""Linear feedback with weights that are all the same, and a strength for every lane."""

from __future__ import annotations

import math

from sysid_evo.arrays import Array
from sysid_evo.kernels import LANES, ControllerKernel, KernelSource, Layout

HEAD = Layout("n_inputs", "n_outputs")


def lqr_kernel(rest: Array, feedback: Array) -> ControllerKernel:
    """Return the compiled form of `Lqr` with its tables (n_inputs + 1, n_outputs)."""
    n_inputs, n_outputs = len(rest) - 1, rest.shape[1]
    return ControllerKernel(KernelSource(lqr), HEAD.pack(rest, feedback, n_inputs=n_inputs, n_outputs=n_outputs))


def lqr(theta, memory, observation, raw, parameters, scratch):
    """Outputs at rest plus so much of the feedback, see `Lqr`."""
    n_inputs, n_outputs = int(parameters[HEAD.n_inputs]), int(parameters[HEAD.n_outputs])
    size = (n_inputs + 1) * n_outputs
    for j in range(n_outputs):
        for lane in range(LANES):
            at = HEAD.size + n_inputs * n_outputs + j
            rest, feedback = parameters[at], parameters[at + size]
            for i in range(n_inputs):
                at = HEAD.size + i * n_outputs + j
                rest += parameters[at] * observation[i * LANES + lane]
                feedback += parameters[at + size] * observation[i * LANES + lane]
            strength = math.exp(min(max(theta[lane], -5.0), 5.0))
            raw[j * LANES + lane] = min(max(rest + strength * feedback, -1.0), 1.0)
