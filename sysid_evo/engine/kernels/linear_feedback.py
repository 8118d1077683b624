"""Linear feedback over lanes: every lane has a parameter vector of its own."""

from __future__ import annotations

from sysid_evo.kernels import LANES, ControllerKernel, KernelSource, Layout, load, store

HEAD = Layout("n_inputs", "n_outputs")


def linear_feedback_kernel(places: tuple[int, ...], n_outputs: int) -> ControllerKernel:
    """Return the compiled form of `LinearFeedback` of the observations in ``places``."""
    return ControllerKernel(KernelSource(linear_feedback), HEAD.pack(places, n_inputs=len(places), n_outputs=n_outputs))


def linear_feedback(theta, memory, observation, raw, parameters, scratch):
    """y = W o + b within [-1, 1], see `LinearFeedback`."""
    n_inputs, n_outputs = int(parameters[HEAD.n_inputs]), int(parameters[HEAD.n_outputs])
    for j in range(n_outputs):
        total = load(theta, (n_inputs * n_outputs + j) * LANES)
        for i in range(n_inputs):
            seen = load(observation, int(parameters[HEAD.size + i]) * LANES)
            total = total + load(theta, (i * n_outputs + j) * LANES) * seen
        store(raw, j * LANES, total)
    for i in range(n_outputs * LANES):
        raw[i] = min(max(raw[i], -1.0), 1.0)
