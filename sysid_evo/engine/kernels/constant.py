"""Controls that never change, over lanes."""

from __future__ import annotations

from sysid_evo.arrays import Array
from sysid_evo.kernels import LANES, ControllerKernel, KernelSource, Layout

HEAD = Layout("n_outputs")


def constant_kernel(neutral: Array) -> ControllerKernel:
    """Return the compiled form of `Constant` with the outputs ``neutral`` (n_outputs,) at rest."""
    return ControllerKernel(KernelSource(constant), HEAD.pack(neutral, n_outputs=len(neutral)))


def constant(theta, memory, observation, raw, parameters, scratch):
    """y = y_0 + b within [-1, 1], see `Constant`."""
    for row in range(int(parameters[HEAD.n_outputs])):
        neutral = parameters[HEAD.size + row]
        for lane in range(LANES):
            i = row * LANES + lane
            raw[i] = min(max(neutral + theta[i], -1.0), 1.0)
