"""What a system without a motion does, over lanes: nothing turns, and there is no pose."""

from __future__ import annotations

from sysid_evo.engine.compiled.lanes import LANES, load, store


def integrate_straight(state, after, nx, dt, p):
    """Write state + dt acceleration."""
    for row in range(nx):
        store(after, row * LANES, load(state, row * LANES) + dt * load(after, row * LANES))


def turn_nothing(state, rate, p):
    """Leave the rate as it is."""
    return


def move_nothing(pose, before, after, dt, p):
    """Leave the pose as it is."""
    return
