"""Angles: wrapping, and rotation in the plane, for numbers, arrays, tensors and lanes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sysid_evo.types import Array

TURN = 2.0 * math.pi


def wrap(difference: Array, period: float = TURN) -> Array:
    """Return values as the same ones in (-period / 2, period / 2], for angles in rad (-pi, pi]."""
    wrapped = difference - period * np.round(difference / period)
    return np.where(wrapped <= -0.5 * period, wrapped + period, wrapped)


def rotate(x: Any, y: Any, angle: Any) -> tuple[Any, Any]:
    """Return the vector (x, y) turned counter-clockwise by ``angle`` in radians: numbers or arrays.

    Sine and cosine come from the tangent t of half the angle, s = 2 t / (1 + t^2) and
    c = 2 / (1 + t^2) - 1: NumPy has vector instructions for it, and none for double sines.
    """
    half = np.tan(0.5 * angle)
    share = 2.0 / (1.0 + half * half)
    return turn(x, y, share - 1.0, share * half)


def turn(x: Any, y: Any, cos: Any, sin: Any) -> tuple[Any, Any]:
    """Return the vector (x, y) turned by the angle with this cosine and sine: numbers, arrays, tensors, lanes."""
    return cos * x - sin * y, sin * x + cos * y


def frame_change(forward: Any, lateral: Any, yaw_rate: Any) -> tuple[Any, Any]:
    """Return how the turning frame changes the two speeds per second: numbers, arrays, tensors, lanes."""
    return yaw_rate * lateral, -yaw_rate * forward
