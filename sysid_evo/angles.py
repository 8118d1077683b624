"""Angles and other quantities that come round again."""

from __future__ import annotations

import math

import numpy as np

from sysid_evo.arrays import Array

TURN = 2.0 * math.pi


def wrap(difference: Array, period: float = TURN) -> Array:
    """Return values as the same ones in (-period / 2, period / 2], for angles in rad (-pi, pi]."""
    wrapped = difference - period * np.round(difference / period)
    return np.where(wrapped <= -0.5 * period, wrapped + period, wrapped)
