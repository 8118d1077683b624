"""A predictor that sees the sine and the cosine of periodic states instead of these."""

from __future__ import annotations

import math

import numpy as np

from sysid_evo.angles import TURN
from sysid_evo.engine.kernels.stepping import copy
from sysid_evo.kernels import CACHE_LINE, LANES, KernelSource, Layout, Predictor, padded, view
from sysid_evo.system import System

HEAD = Layout("n_carry", "n_seen", "own", align=CACHE_LINE)


def with_angles(inner: Predictor, system: System, lags: tuple[int, int] = (0, 0)) -> Predictor:
    """Return a predictor that shows ``inner`` each periodic state of the carry as sine and cosine, see `regressors`.

    The carry holds the state, ``lags[0]`` earlier states and ``lags[1]`` earlier controls.
    """
    if not system.periods:
        return inner
    per_state = [TURN / system.periods[i] if i in system.periods else 0.0 for i in range(system.nx)]
    per_row = np.array([*per_state * (1 + lags[0]), *[0.0] * (system.nu * lags[1])])
    n_seen = len(per_row) + int(np.count_nonzero(per_row))
    rows = padded(per_row)
    parameters = HEAD.pack(
        rows,
        inner.parameters,
        n_carry=len(per_row),
        n_seen=n_seen,
        own=HEAD.size + len(rows),
    )
    return Predictor(
        KernelSource(seen_as_angles, inner.bindings),
        parameters,
        n_seen + inner.n_scratch,
        prepare=KernelSource(prepare_inner, inner.bindings),
    )


def prepare_inner(u, p, scratch):
    """Prepare what is inside; its room comes after what it is shown."""
    prepare(u, view(p, int(p[HEAD.own])), view(scratch, int(p[HEAD.n_seen]) * LANES))


def seen_as_angles(x, u, p, y, scratch):
    """Predict from the sines and cosines."""
    row = 0
    for i in range(int(p[HEAD.n_carry])):
        factor, here, there = p[HEAD.size + i], view(x, i * LANES), view(scratch, row * LANES)
        if factor > 0.0:
            for lane in range(LANES):
                there[lane] = math.sin(factor * here[lane])
                there[LANES + lane] = math.cos(factor * here[lane])
            row += 2
        else:
            copy(here, there, LANES)
            row += 1
    predict(scratch, u, view(p, int(p[HEAD.own])), y, view(scratch, int(p[HEAD.n_seen]) * LANES))
