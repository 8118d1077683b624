"""Any fine kernel repeated under a held control, see `HeldControl`."""

from __future__ import annotations

from sysid_evo.kernels import LANES, DynamicsKernel, KernelSource, Layout, view

HEAD = Layout("repeats", "n_noise")


def held_kernel(fine: DynamicsKernel, repeats: int, n_noise: int) -> DynamicsKernel:
    """Return the kernel that repeats ``fine``, which takes ``n_noise`` rows of noise each time."""
    return DynamicsKernel(
        KernelSource(held, {"fine": fine.source}),
        HEAD.pack(fine.parameters, repeats=repeats, n_noise=n_noise),
        fine.n_scratch,
    )


def held(carry, control, noise, parameters, scratch):
    """Repeat the fine step, each time with the next rows of noise."""
    own, rows = view(parameters, HEAD.size), int(parameters[HEAD.n_noise]) * LANES
    for k in range(int(parameters[HEAD.repeats])):
        fine(carry, control, view(noise, k * rows), own, scratch)
