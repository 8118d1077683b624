"""The compiled forms of motions: a body on a plane, and a system without a motion."""

from __future__ import annotations

import math

from sysid_evo import angles
from sysid_evo.angles import TURN
from sysid_evo.kernels import (
    LANES,
    QUARTER,
    Layout,
    MotionKernel,
    load,
    load_quarter,
    nearest,
    store,
    view,
    where_at_most,
)

ROLES = Layout("forward", "lateral", "yaw_rate")
PER_TURN = 1.0 / TURN


def integrate_straight(state, after, nx, dt, p):
    """Write state + dt acceleration."""
    for row in range(nx):
        store(after, row * LANES, load(state, row * LANES) + dt * load(after, row * LANES))


def turn_nothing(state, rate, p):
    """Do not change the rate."""
    return


def move_nothing(pose, before, after, dt, p):
    """Do not change the pose."""
    return


STRAIGHT = MotionKernel(integrate_straight, turn_nothing, move_nothing)
"""For a system without a motion: no turning frame and no pose."""


def planar_body_kernel(forward: int, lateral: int | None, yaw_rate: int) -> MotionKernel:
    """Return the compiled form of `PlanarBody` with its roles in the given rows of the state."""
    roles = ROLES.pack(forward=forward, lateral=-1 if lateral is None else lateral, yaw_rate=yaw_rate)
    return MotionKernel(integrate, turn, move, roles)


def integrate(state, after, nx, dt, p):
    """R(-r dt) (x + dt acceleration), see `PlanarBody`."""
    integrate_straight(state, after, nx, dt, p)
    lateral = int(p[ROLES.lateral])
    if lateral >= 0:
        along, across = view(after, int(p[ROLES.forward]) * LANES), view(after, lateral * LANES)
        yaw_rate = view(state, int(p[ROLES.yaw_rate]) * LANES)
        for lane in range(0, LANES, QUARTER):
            angle = load_quarter(yaw_rate, lane) * dt
            ahead, aside = load_quarter(along, lane), load_quarter(across, lane)
            forward, sideways = angles.turn(ahead, aside, math.cos(angle), -math.sin(angle))
            store(along, lane, forward)
            store(across, lane, sideways)


def turn(state, rate, p):
    """Add (r v, -r u) to the rates of u and v."""
    lateral = int(p[ROLES.lateral])
    if lateral >= 0:
        forward = int(p[ROLES.forward]) * LANES
        along, across = view(state, forward), view(state, lateral * LANES)
        yaw_rate = view(state, int(p[ROLES.yaw_rate]) * LANES)
        along_rate, across_rate = view(rate, forward), view(rate, lateral * LANES)
        forward_change, lateral_change = angles.frame_change(load(along, 0), load(across, 0), load(yaw_rate, 0))
        store(along_rate, 0, load(along_rate, 0) + forward_change)
        store(across_rate, 0, load(across_rate, 0) + lateral_change)


def move(pose, before, after, dt, p):
    """Move x, y and heading as `PlanarBody.move` does; the heading stays in (-pi, pi]."""
    forward, yaw_rate = int(p[ROLES.forward]) * LANES, int(p[ROLES.yaw_rate]) * LANES
    lateral = int(p[ROLES.lateral]) * LANES
    sideways = 0.5 * dt if lateral >= 0 else 0.0
    u0, u1, r0, r1 = view(before, forward), view(after, forward), view(before, yaw_rate), view(after, yaw_rate)
    v0, v1 = view(before, max(lateral, 0)), view(after, max(lateral, 0))
    y, heading = view(pose, LANES), view(pose, 2 * LANES)
    for lane in range(0, LANES, QUARTER):
        turned = 0.5 * dt * (load_quarter(r0, lane) + load_quarter(r1, lane))
        along = 0.5 * dt * (load_quarter(u0, lane) + load_quarter(u1, lane))
        across = sideways * (load_quarter(v0, lane) + load_quarter(v1, lane))
        middle = load_quarter(heading, lane) + 0.5 * turned
        dx, dy = angles.turn(along, across, math.cos(middle), math.sin(middle))
        store(pose, lane, load_quarter(pose, lane) + dx)
        store(y, lane, load_quarter(y, lane) + dy)
        store(heading, lane, wrap(load_quarter(heading, lane) + turned))


def wrap(angle):
    """Return an angle, or a row of angles, wrapped to (-pi, pi], as `sysid_evo.angles.wrap` does."""
    angle = angle - TURN * nearest(angle * PER_TURN)
    return where_at_most(angle, -math.pi, angle + TURN, angle)
