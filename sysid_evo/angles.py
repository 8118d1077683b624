"""Angles: wrapping, and rotation in the plane, for numbers, arrays, tensors and lanes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sysid_evo.types import Array

TURN = 2.0 * math.pi


def wrap(difference: Array, period: float = TURN) -> Array:
    """Return values wrapped to (-period / 2, period / 2], for angles in rad (-pi, pi]."""
    wrapped = difference - period * np.round(difference / period)
    return np.where(wrapped <= -0.5 * period, wrapped + period, wrapped)


def rotate(x: Any, y: Any, angle: Any) -> tuple[Any, Any]:
    """Return the vector (x, y) rotated counter-clockwise by ``angle`` in radians: numbers or arrays.

    Sine and cosine are computed from the tangent t of half the angle, s = 2 t / (1 + t^2) and
    c = 2 / (1 + t^2) - 1, because NumPy has vector instructions for tangents but not for double sines.
    """
    half = np.tan(0.5 * angle)
    share = 2.0 / (1.0 + half * half)
    return turn(x, y, share - 1.0, share * half)


def turn(x: Any, y: Any, cos: Any, sin: Any) -> tuple[Any, Any]:
    """Return the vector (x, y) rotated by the angle with this cosine and sine: numbers, arrays, tensors, lanes."""
    return cos * x - sin * y, sin * x + cos * y


def frame_change(forward: Any, lateral: Any, yaw_rate: Any) -> tuple[Any, Any]:
    """Return the rates of change of both speeds due to the turning frame: numbers, arrays, tensors, lanes."""
    return yaw_rate * lateral, -yaw_rate * forward
