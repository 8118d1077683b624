"""A kernel whose controls are followed by means of the past, over lanes: the step of `DelayEmbedding`."""

from __future__ import annotations

from sysid_evo.engine.compiled.dialect import KernelSource
from sysid_evo.engine.compiled.kernel import DynamicsKernel
from sysid_evo.engine.compiled.lanes import LANES, load, splat, store, view
from sysid_evo.engine.compiled.layout import CACHE_LINE, Layout
from sysid_evo.engine.kernels.stepping import Predictor, copy

HEAD = Layout("nx", "nu", "longest", align=CACHE_LINE)


def with_past(inner: DynamicsKernel, nx: int, nu: int, longest: int) -> Predictor:
    """Return a predictor of the state that ``inner`` steps to; the carry holds ``longest`` states and controls."""
    groups = (longest + 1).bit_length() - 1
    return Predictor(
        KernelSource(step_with_past, {"inner": inner.source}),
        HEAD.pack(inner.parameters, nx=nx, nu=nu, longest=longest),
        nx + nu + groups * (nx + nu) + inner.n_scratch,
    )


def step_with_past(x, u, p, y, scratch):
    """Write the state after one step; the scratch begins with the controls that the inner kernel sees."""
    nx, nu, longest = int(p[HEAD.nx]), int(p[HEAD.nu]), int(p[HEAD.longest])
    copy(u, scratch, nu * LANES)
    row = means(view(x, nx * LANES), nx, longest, scratch, nu)
    row = means(view(x, (1 + longest) * nx * LANES), nu, longest, scratch, row)
    copy(x, y, nx * LANES)
    inner(y, scratch, u, view(p, HEAD.size), view(scratch, row * LANES))


def means(past, count, longest, seen, row):
    """Write the means of ``past`` (longest x count rows) over doubling times from ``row`` on; return what follows."""
    first, width = 0, 1
    while first < longest:
        for channel in range(count):
            total = splat(0.0)
            for back in range(first, first + width):
                total = total + load(past, (back * count + channel) * LANES)
            store(seen, row * LANES, total * (1.0 / float(width)))
            row += 1
        first += width
        width *= 2
    return row
