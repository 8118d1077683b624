"""How markers are reached on a plane: which are missed at first, what follows a miss, and driving around them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from sysid_evo.angles import TURN
from sysid_evo.arrays import Array, BoolArray

NEAR = 2.5
"""A marker is missed if a body that came towards it passes it this close, in radii of the marker, and goes away."""
CAME = 0.5
"""In radii: how much nearer it must have come before, and how much farther it must be after."""
AFTER = 2.0
"""Seconds after a miss that count as what follows it."""
LONGEST = 10.0
"""Seconds within which a full turn around a marker is an orbit."""

Reaction: TypeAlias = Literal["drives on", "stops", "turns back"]
REACTIONS: tuple[Reaction, ...] = ("drives on", "stops", "turns back")


@dataclass(frozen=True)
class Chase:
    """One trial: how many markers came up and were ``reached``, and what followed each miss (``reactions``).

    ``missed`` counts the markers that were missed at least once, ``after`` holds for every miss whose marker was then
    reached how long that took (s), and ``orbiting`` is the share of the time spent in full turns around a marker.
    """

    markers: int
    reached: int
    missed: int
    reactions: tuple[Reaction, ...]
    after: tuple[float, ...]
    orbiting: float


def chase(place: Array, markers: Array, radius: float, forward: Array, dt: float, *, still: float) -> Chase:
    """Return how a body at ``place`` (T + 1, 2) m went for ``markers`` (k, 2), one after the other.

    ``forward`` (T + 1,) is its signed speed, and it stands below ``still``, in m/s.
    """
    begin, reached, missed = 0, 0, 0
    reactions: list[Reaction] = []
    after: list[float] = []
    around = np.zeros(len(place), dtype=bool)
    for marker in markers:
        off = place[begin:] - marker
        distance = np.hypot(off[:, 0], off[:, 1])
        inside = np.flatnonzero(distance[1:] < radius)
        there = bool(len(inside))
        end = begin + 1 + (int(inside[0]) if there else len(distance) - 2)
        leg = slice(begin, end + 1)
        misses = [begin + step for step in _misses(distance[: end - begin + 1], radius)]
        for step in misses:
            reactions.append(_reaction(forward[step : step + 1 + round(AFTER / dt)], still))
            if there:
                after.append((end - step) * dt)
        missed += bool(misses)
        around[leg] |= _orbits(off[: end - begin + 1], max(2, round(LONGEST / dt)))
        reached += there
        begin = end
        if not there or begin >= len(place) - 1:
            break
    return Chase(
        len(markers),
        reached,
        missed,
        tuple(reactions),
        tuple(after),
        float(around[:-1].mean()) if len(around) > 1 else 0.0,
    )


def _misses(distance: Array, radius: float) -> list[int]:
    """Return the steps at which a body that had come nearer passed by and went away again."""
    found: list[int] = []
    farthest, nearest, step, coming = distance[0], distance[0], 0, False
    for k, now in enumerate(distance):
        if not coming:
            farthest = max(farthest, now)
            if now < farthest - CAME * radius:
                coming, nearest, step = True, now, k
        elif now < nearest:
            nearest, step = now, k
        elif now > nearest + CAME * radius:
            if radius <= nearest < NEAR * radius:
                found.append(step)
            coming, farthest = False, now
    return found


def _reaction(forward: Array, still: float) -> Reaction:
    """Return what a body with these speeds does: it turns back once it moves the other way."""
    moving = forward[np.abs(forward) > still]
    if len(moving) and np.sign(moving[-1]) != np.sign(moving[0]):
        return "turns back"
    return "stops" if bool((np.abs(forward) <= still).any()) else "drives on"


def _orbits(off: Array, longest: int) -> BoolArray:
    """Return which samples lie within a full turn around the origin that takes at most ``longest`` steps."""
    angle = np.unwrap(np.arctan2(off[:, 1], off[:, 0]))
    marked = np.zeros(len(angle), dtype=bool)
    if np.ptp(angle) < TURN:
        return marked
    for first in range(len(angle)):
        turned = np.flatnonzero(np.abs(angle[first : first + longest] - angle[first]) >= TURN)
        if len(turned):
            marked[first : first + int(turned[0]) + 1] = True
    return marked
