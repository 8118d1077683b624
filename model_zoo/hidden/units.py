"""What the hidden units of a state space do: a smooth step, a kink, a cube."""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array

UNITS = ("smooth", "kinked", "cubic")
BOUND = 3.0
"""A cube stands still beyond it, so that nothing runs away."""


def values(kind: str, s: Array) -> Array:
    """Return tanh s, (sqrt(s^2 + 1) - 1) / 2 or s^3 / 3, the last with its argument within `BOUND`.

    The kink is the smooth ramp of Barron (2021) without s / 2, which the linear part holds.
    """
    if kind == "smooth":
        return np.tanh(s)
    if kind == "kinked":
        return 0.5 * (np.sqrt(s**2 + 1.0) - 1.0)
    return np.clip(s, -BOUND, BOUND) ** 3 / 3.0


def slopes(kind: str, s: Array) -> Array:
    """Return the derivatives of `values`."""
    if kind == "smooth":
        return 1.0 - np.tanh(s) ** 2
    if kind == "kinked":
        return 0.5 * s / np.sqrt(s**2 + 1.0)
    return np.where(np.abs(s) < BOUND, s**2, 0.0)
