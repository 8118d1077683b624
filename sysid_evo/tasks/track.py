"""Closed tracks between two walls, drawn at random: their centre line, and how far a point lies from it.

A track goes once round a centre c. In the direction phi as seen from there, its centre line lies at the distance::

    r(phi) = R (1 + sum over k = 2 .. 5 of a_k cos(k phi) + b_k sin(k phi))

so that where a point lies is known without a search. The offset of a point at distance rho in direction phi is
n = (rho - r) r / sqrt(r^2 + r'^2): its distance from the centre line, to first order. The walls are where |n| is half
the width.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sysid_evo.angles import TURN
from sysid_evo.arrays import Array

HARMONICS = (2, 3, 4, 5)
NUMBERS = 3 + 2 * len(HARMONICS)
"""Of a track: centre x and y (m), R (m), then a_k and b_k in turn."""
WALK = 12
"""Steps that are taken along a ray."""
CAREFUL = 0.9
"""Share of the distance to the nearer wall that such a step covers: the offset is right to first order only."""
DRAWN = 181
"""Points of a wall that is drawn."""


class Place(NamedTuple):
    """Where points (B,) lie on their tracks, in m.

    Direction ``cosine`` and ``sine`` from the centre, the centre line's distance ``middle`` from it, its ``slope``
    dr/dphi, the length ``per_radian`` of centre line for each radian, and the ``offset``, positive outwards.
    """

    cosine: Array
    sine: Array
    middle: Array
    slope: Array
    per_radian: Array
    offset: Array


def draw_track(rng: np.random.Generator, radius: float, bends: float) -> Array:
    """Return the numbers (NUMBERS,) of a track that begins in the origin, along x, counter-clockwise.

    Each harmonic adds up to ``bends`` / ``radius`` to the curvature.
    """
    orders = np.array(HARMONICS)
    size, phase = bends * rng.random(len(orders)) / (orders**2 - 1.0), TURN * rng.random(len(orders))
    middle = radius * (1.0 + (size * np.cos(phase)).sum())
    slope = -radius * (orders * size * np.sin(phase)).sum()
    tangent = math.atan2(middle, slope)
    phase = phase + orders * tangent
    centre = -middle * np.array([math.cos(tangent), -math.sin(tangent)])
    pairs = np.stack([size * np.cos(phase), -size * np.sin(phase)], axis=1)
    return np.concatenate([centre, [radius], pairs.ravel()])


def place_of(track: Array, x: Array, y: Array) -> Place:
    """Return where the points ``x``, ``y`` (B,) lie on the tracks (B, NUMBERS)."""
    dx, dy = x - track[:, 0], y - track[:, 1]
    distance = np.sqrt(dx * dx + dy * dy) + 1e-9
    cosine, sine = dx / distance, dy / distance
    middle, slope = _centre_line(track, cosine, sine)
    per_radian = np.sqrt(middle * middle + slope * slope)
    return Place(cosine, sine, middle, slope, per_radian, (distance - middle) * middle / per_radian)


def _centre_line(track: Array, cosine: Array, sine: Array) -> tuple[Array, Array]:
    """Return r and r' in these directions."""
    middle, slope = np.ones_like(cosine), np.zeros_like(cosine)
    c, s = cosine, sine
    for i, order in enumerate(HARMONICS):
        c, s = c * cosine - s * sine, s * cosine + c * sine
        a, b = track[:, 3 + 2 * i], track[:, 4 + 2 * i]
        middle = middle + (a * c + b * s)
        slope = slope + order * (b * c - a * s)
    return track[:, 2] * middle, track[:, 2] * slope


def distance_to_wall(track: Array, x: Array, y: Array, angle: Array, half: float, reach: float) -> Array:
    """Return how far (m) the wall lies from points (B,) in direction ``angle`` (rad), at most ``reach``.

    It is found by walking along the ray, each step as long as the nearer wall is far, so that a wall at a flat angle
    seems a little nearer than it is.
    """
    way_x, way_y = np.cos(angle), np.sin(angle)
    gone = np.zeros_like(x)
    for _ in range(WALK):
        place = place_of(track, x + gone * way_x, y + gone * way_y)
        gone = np.minimum(gone + CAREFUL * np.maximum(half - np.abs(place.offset), 0.0), reach)
    return gone


def at_offset(track: Array, place: Place, offset: Array) -> tuple[Array, Array]:
    """Return the points (B,) in the directions of ``place`` that have this offset."""
    distance = place.middle + offset * place.per_radian / place.middle
    return track[:, 0] + distance * place.cosine, track[:, 1] + distance * place.sine


def wall(track: Array, offset: float) -> Array:
    """Return the line (DRAWN, 2) m at an offset from the centre line of one track (NUMBERS,)."""
    angle = np.linspace(0.0, TURN, DRAWN)
    tracks = np.tile(track, (DRAWN, 1))
    place = place_of(tracks, track[0] + np.cos(angle), track[1] + np.sin(angle))
    return np.stack(at_offset(tracks, place, np.full(DRAWN, offset)), axis=1)
