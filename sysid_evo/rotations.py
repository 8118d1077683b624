"""Rotations in space: rotation vectors and unit quaternions (w, x, y, z), for numbers and lanes.

`sysid_evo.laws.array_form` converts these functions to arrays.
"""

from __future__ import annotations

import math
from typing import Any

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
