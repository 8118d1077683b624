"""How a differential equation goes on outside the data: bounded, and back towards them."""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array, BoolArray

MARGIN = 0.1
"""Share of the range of a state within which what drives it further out fades away."""


def limits(states: Array, rates: Array, endless: BoolArray) -> Array:
    """Return what bounds the continuation (5, nx): lowest and highest state, 1 / margin, lowest and highest rate.

    ``states`` and ``rates`` (N, nx) are those of the training data; a state that is ``endless`` (nx,), such as a
    position, has no bounds.
    """
    low, high = states.min(axis=0), states.max(axis=0)
    width = np.where(high > low, high - low, 1.0)
    found = np.stack([low, high, 1.0 / (MARGIN * width), rates.min(axis=0), rates.max(axis=0)])
    free = np.array([[-np.inf], [np.inf], [1.0], [-np.inf], [np.inf]])
    return np.where(endless, free, found)


def continued(rate: Array, turning: Array, state: Array, bounds: Array, dt: float) -> Array:
    """Return dx/dt (B, nx) of a learned ``rate`` and the known ``turning`` of the frame.

    The rate stays within those of the data. Of a state above its range, what drives it further up fades to nothing
    over a tenth of the range, and the excess decays with the time constant dt; likewise below. So beyond the margin
    every state moves back, whatever the polynomial says there, and no state gets further than the margin and what
    one step of bounded rates adds.
    """
    low, high, per_margin, slowest, fastest = bounds
    total = np.clip(rate, slowest, fastest) + turning
    above, below = np.maximum(state - high, 0.0), np.maximum(low - state, 0.0)
    up = np.maximum(total, 0.0) * np.maximum(1.0 - above * per_margin, 0.0)
    down = np.minimum(total, 0.0) * np.maximum(1.0 - below * per_margin, 0.0)
    return up + down - (above - below) / dt
