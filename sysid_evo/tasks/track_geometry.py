"""Random closed tracks between two walls: centre line, and distance of points from it.

A track goes once around a centre c. In direction phi from there, its centre line is at the distance::

    r(phi) = R (1 + sum over k = 2 .. 5 of a_k cos(k phi) + b_k sin(k phi))

so that no search is needed to locate a point. The offset of a point at distance rho in direction phi is
n = (rho - r) r / sqrt(r^2 + r'^2): its distance from the centre line, to first order. At the walls, |n| is half the
width.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from sysid_evo.angles import TURN
from sysid_evo.randomness import TASK_STREAM, generator
from sysid_evo.types import Array

HARMONICS = (2, 3, 4, 5)
NUMBERS = 5 + 2 * len(HARMONICS)
"""Parameters of a track: centre x, y (m), R (m), a_k, b_k for each k, least and greatest curvature (1/m)."""
MAX_RAY_STEPS = 16
"""Largest number of steps along a ray."""
LAST_STEP = 5e-3
"""Length (m) of the last step along a ray: given the order of convergence, it ends within about 0.1 mm of the wall."""
TINY = 1e-9
"""Smallest divisor (m)."""
WALL_POINTS = 181
"""Number of points of a wall to draw."""
CURVATURE_POINTS = 96
"""Number of directions in which the curvature of a centre line is computed."""


class Place(NamedTuple):
    """Positions of points (B,) on their tracks, in m.

    ``distance`` is that from the centre in direction ``cosine``, ``sine``; in this direction, ``middle`` is the
    distance of the centre line, ``slope`` and ``bend`` are dr/dphi and d2r/dphi2, and ``per_radian`` is the length of
    centre line per radian. ``offset`` is positive outwards.
    """

    distance: Array
    cosine: Array
    sine: Array
    middle: Array
    slope: Array
    bend: Array
    per_radian: Array
    offset: Array

    def rise(self, way_x: Array, way_y: Array) -> Array:
        """Return the derivative of the offset along a direction of length 1."""
        middle, slope, along = self.middle, self.slope, self.per_radian
        turned = slope * (slope * slope - middle * self.bend) / along**3
        across = ((self.distance - middle) * turned - slope * middle / along) / self.distance
        outwards, onwards = way_x * self.cosine + way_y * self.sine, way_y * self.cosine - way_x * self.sine
        return outwards * middle / along + across * onwards


@lru_cache(maxsize=64)
def tracks_of(seeds: tuple[int, ...], radius: float, bends: float) -> Array:
    """Return the track of each seed, (E, NUMBERS).

    Read-only and cached: all models of an ensemble are run in the same trials.
    """
    drawn = np.array([draw_track(generator(seed, TASK_STREAM), radius, bends) for seed in seeds])
    drawn.flags.writeable = False
    return drawn


def draw_track(rng: np.random.Generator, radius: float, bends: float) -> Array:
    """Return the parameters (NUMBERS,) of a track that begins in the origin, along x, counter-clockwise.

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
    track = np.concatenate([centre, [radius], pairs.ravel(), [0.0, 0.0]])
    track[-2:] = _curvatures(track)
    return track


def place_of(track: Array, x: Array, y: Array) -> Place:
    """Return the positions of the points ``x``, ``y`` (B,) on the tracks (B, NUMBERS)."""
    dx, dy = x - track[:, 0], y - track[:, 1]
    distance = np.sqrt(dx * dx + dy * dy) + TINY
    cosine, sine = dx / distance, dy / distance
    middle, slope, bend = _centre_line(track, cosine, sine)
    per_radian = np.sqrt(middle * middle + slope * slope)
    offset = (distance - middle) * middle / per_radian
    return Place(distance, cosine, sine, middle, slope, bend, per_radian, offset)


def _centre_line(track: Array, cosine: Array, sine: Array) -> tuple[Array, Array, Array]:
    """Return r, r' and r'' in the directions ``cosine``, ``sine``."""
    middle, slope, bend = np.ones_like(cosine), np.zeros_like(cosine), np.zeros_like(cosine)
    c, s = cosine, sine
    for i, order in enumerate(HARMONICS):
        c, s = c * cosine - s * sine, s * cosine + c * sine
        a, b = track[:, 3 + 2 * i], track[:, 4 + 2 * i]
        wave = a * c + b * s
        middle = middle + wave
        slope = slope + order * (b * c - a * s)
        bend = bend - order * order * wave
    return track[:, 2] * middle, track[:, 2] * slope, track[:, 2] * bend


def _curvatures(track: Array) -> tuple[float, float]:
    """Return the least and the greatest curvature (1/m) of the centre line of one track (NUMBERS,)."""
    angle = np.linspace(0.0, TURN, CURVATURE_POINTS, endpoint=False)
    middle, slope, bend = _centre_line(track[None], np.cos(angle), np.sin(angle))
    curvature = (middle**2 + 2.0 * slope**2 - middle * bend) / (middle**2 + slope**2) ** 1.5
    return float(curvature.min()), float(curvature.max())


def distance_to_wall(track: Array, x: Array, y: Array, angle: Array, half: float, reach: float) -> Array:
    """Return the distance (m) from points (B,) to the wall in direction ``angle`` (rad), at most ``reach``; 0 behind.

    The ray is followed by `step_to_wall` until a step is no longer than ``LAST_STEP``.
    """
    way_x, way_y = np.cos(angle), np.sin(angle)
    gone, moving = np.zeros_like(x), np.ones(len(x), dtype=bool)
    for _ in range(MAX_RAY_STEPS):
        place = place_of(track, x + gone * way_x, y + gone * way_y)
        step = step_to_wall(place.offset, place.rise(way_x, way_y), half, *track[:, -2:].T)
        further = np.where(moving, np.clip(gone + step, 0.0, reach), gone)
        gone, moving = further, np.abs(further - gone) > LAST_STEP
        if not moving.any():
            break
    return gone


def step_to_wall(offset: Array, rise: Array, half: float, least: Array, greatest: Array) -> Array:
    """Return a lower bound (B,) m of the distance to the wall along a ray; exact if the track is a circle.

    ``offset`` (m) is the present offset, ``rise`` its derivative along the ray. If the centre line has the constant
    curvature k, a wall is a circle of radius 1 / k + h, with h = half outside and - half inside. From the offset n, a
    ray hits it after::

        t = (h - n) (2 + k (h + n)) / (b + sqrt(b^2 + k (h - n) (2 + k (h + n)))),     b = (1 + k n) rise

    This is for the outer wall; for the inner one the root is subtracted, and there is no hit if its argument is
    negative. The curvature lies between ``least`` and ``greatest`` (1/m): the outer wall is never closer than with the
    greatest, the inner one never closer than with the least. Close to a wall the step is as accurate as Newton's.
    """
    outer, inner = half - offset, half + offset
    lead, room = (1.0 + greatest * offset) * rise, outer * (2.0 + greatest * inner)
    out = room / np.maximum(lead + np.sqrt(np.maximum(lead * lead + greatest * room, 0.0)), TINY)
    lead, room = (1.0 + least * offset) * rise, inner * (2.0 - least * outer)
    root = lead * lead - least * room
    within = room / np.maximum(np.where(root >= 0.0, np.sqrt(np.maximum(root, 0.0)) - lead, 0.0), TINY)
    return np.minimum(out, within)


def at_offset(track: Array, place: Place, offset: Array) -> tuple[Array, Array]:
    """Return the points x, y (B,) in the directions of ``place`` with this ``offset``."""
    distance = place.middle + offset * place.per_radian / place.middle
    return track[:, 0] + distance * place.cosine, track[:, 1] + distance * place.sine


def wall(track: Array, offset: float) -> Array:
    """Return the line (DRAWN, 2) m at an offset from the centre line of one track (NUMBERS,)."""
    angle = np.linspace(0.0, TURN, WALL_POINTS)
    tracks = np.tile(track, (WALL_POINTS, 1))
    place = place_of(tracks, track[0] + np.cos(angle), track[1] + np.sin(angle))
    return np.stack(at_offset(tracks, place, np.full(WALL_POINTS, offset)), axis=1)
