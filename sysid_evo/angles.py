"""Angles and rotations: wrapping, rotation in the plane and in space, for numbers, arrays, tensors and lanes.

Rotations in space are rotation vectors or unit quaternions (w, x, y, z); `sysid_evo.laws.array_form` converts their
functions to arrays.
"""

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


SMALLEST = 1e-24
"""Added to squared angles and norms, so that nothing is divided by 0; negligible in single precision."""


def quaternion(x: Any, y: Any, z: Any) -> Any:
    """Return the unit quaternion of a rotation about the vector (x, y, z) by its length in rad."""
    angle = math.sqrt(x * x + y * y + z * z + SMALLEST)
    share = math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), share * x, share * y, share * z


def product(w: Any, x: Any, y: Any, z: Any, v: Any, a: Any, b: Any, c: Any) -> Any:
    """Return the quaternion (w, x, y, z) (v, a, b, c): first the second rotation, then the first."""
    return (
        w * v - x * a - y * b - z * c,
        w * a + x * v + y * c - z * b,
        w * b - x * c + y * v + z * a,
        w * c + x * b - y * a + z * v,
    )


def unit(w: Any, x: Any, y: Any, z: Any) -> Any:
    """Return the quaternion with norm 1."""
    share = 1.0 / math.sqrt(w * w + x * x + y * y + z * z + SMALLEST)
    return share * w, share * x, share * y, share * z


def rotated(w: Any, x: Any, y: Any, z: Any, a: Any, b: Any, c: Any) -> Any:
    """Return the vector (a, b, c) rotated by the unit quaternion (w, x, y, z)."""
    p, q, r = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return a + w * p + (y * r - z * q), b + w * q + (z * p - x * r), c + w * r + (x * q - y * p)
