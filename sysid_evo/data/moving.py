"""Which samples of an episode are not part of a standstill."""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array, BoolArray
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System

STANDSTILL_SPEED = 0.05  # m/s
STANDSTILL_YAW_RATE = 0.1  # rad/s
STANDSTILL_TIME = 0.5  # s
MARGIN_TIME = 0.25  # s, kept on either side, so that launches and stops stay in


def moving_rows(states: Array, system: System) -> BoolArray:
    """Return a mask (T + 1,) that is false where a planar body stands still.

    A standstill is at least 0.5 s below 0.05 m/s and 0.1 rad/s; its first and last 0.25 s count as
    moving. A system without a planar motion always moves.
    """
    if not isinstance(system.motion, PlanarBody):
        return np.ones(len(states), dtype=bool)
    forward, lateral, yaw_rate = system.motion.indices(system.state_names)
    speed = np.abs(states[:, forward]) if lateral is None else np.hypot(states[:, forward], states[:, lateral])
    slow = (speed < STANDSTILL_SPEED) & (np.abs(states[:, yaw_rate]) < STANDSTILL_YAW_RATE)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]]).astype(np.int8)))
    moving = np.ones(len(states), dtype=bool)
    margin = round(MARGIN_TIME / system.dt)
    begin, end = edges.reshape(-1, 2).T
    long = end - begin >= round(STANDSTILL_TIME / system.dt)
    for first, last in zip(begin[long].tolist(), end[long].tolist(), strict=True):
        first = first + margin if first > 0 else first
        last = last - margin if last < len(states) else last
        moving[first : max(first, last)] = False
    return moving
