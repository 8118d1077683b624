"""The compiled forms of motions: a body on a plane, a rigid body in space, and a system without a motion."""

from __future__ import annotations

import math

import numpy as np

from sysid_evo import angles
from sysid_evo.angles import TURN, product, quaternion, rotated, unit
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


def rigid_body_kernel(speeds: list[int], rates: list[int], up: list[int]) -> MotionKernel:
    """Return the compiled form of `RigidBody` with its vectors in the given rows of the state."""
    return MotionKernel(integrate_in_space, turn_in_space, move_in_space, np.array([*speeds, *rates, *up], dtype=float))


def integrate_in_space(state, after, nx, dt, p):
    """R(-a) (x + dt acceleration) for the velocities and up, see `RigidBody`."""
    integrate_straight(state, after, nx, dt, p)
    roll, pitch, yaw = int(p[3]) * LANES, int(p[4]) * LANES, int(p[5]) * LANES
    for lane in range(0, LANES, QUARTER):
        here, there = view(state, lane), view(after, lane)
        w, x, y, z = quaternion(
            -0.5 * dt * (load_quarter(here, roll) + load_quarter(there, roll)),
            -0.5 * dt * (load_quarter(here, pitch) + load_quarter(there, pitch)),
            -0.5 * dt * (load_quarter(here, yaw) + load_quarter(there, yaw)),
        )
        for first in range(0, 9, 6):
            i, j, k = int(p[first]) * LANES, int(p[first + 1]) * LANES, int(p[first + 2]) * LANES
            a, b, c = rotated(w, x, y, z, load_quarter(there, i), load_quarter(there, j), load_quarter(there, k))
            store(there, i, a)
            store(there, j, b)
            store(there, k, c)


def turn_in_space(state, rate, p):
    """Add v x r and up x r to the rates of change of v and up."""
    roll, pitch, yaw = int(p[3]) * LANES, int(p[4]) * LANES, int(p[5]) * LANES
    for lane in range(0, LANES, QUARTER):
        here, change = view(state, lane), view(rate, lane)
        x, y, z = load_quarter(here, roll), load_quarter(here, pitch), load_quarter(here, yaw)
        for first in range(0, 9, 6):
            i, j, k = int(p[first]) * LANES, int(p[first + 1]) * LANES, int(p[first + 2]) * LANES
            a, b, c = load_quarter(here, i), load_quarter(here, j), load_quarter(here, k)
            store(change, i, load_quarter(change, i) + (b * z - c * y))
            store(change, j, load_quarter(change, j) + (c * x - a * z))
            store(change, k, load_quarter(change, k) + (a * y - b * x))


def move_in_space(pose, before, after, dt, p):
    """Move position and attitude as `RigidBody.move` does; the attitude keeps norm 1."""
    u, v, w = int(p[0]) * LANES, int(p[1]) * LANES, int(p[2]) * LANES
    roll, pitch, yaw = int(p[3]) * LANES, int(p[4]) * LANES, int(p[5]) * LANES
    for lane in range(0, LANES, QUARTER):
        here, start, end = view(pose, lane), view(before, lane), view(after, lane)
        share = 0.25 * dt
        hw, hx, hy, hz = quaternion(
            share * (load_quarter(start, roll) + load_quarter(end, roll)),
            share * (load_quarter(start, pitch) + load_quarter(end, pitch)),
            share * (load_quarter(start, yaw) + load_quarter(end, yaw)),
        )
        mw, mx, my, mz = product(
            load_quarter(here, 3 * LANES), load_quarter(here, 4 * LANES),
            load_quarter(here, 5 * LANES), load_quarter(here, 6 * LANES), hw, hx, hy, hz,
        )  # fmt: skip
        dx, dy, dz = rotated(
            mw, mx, my, mz,
            load_quarter(start, u) + load_quarter(end, u),
            load_quarter(start, v) + load_quarter(end, v),
            load_quarter(start, w) + load_quarter(end, w),
        )  # fmt: skip
        store(here, 0, load_quarter(here, 0) + 0.5 * dt * dx)
        store(here, LANES, load_quarter(here, LANES) + 0.5 * dt * dy)
        store(here, 2 * LANES, load_quarter(here, 2 * LANES) + 0.5 * dt * dz)
        qw, qx, qy, qz = product(mw, mx, my, mz, hw, hx, hy, hz)
        qw, qx, qy, qz = unit(qw, qx, qy, qz)
        store(here, 3 * LANES, qw)
        store(here, 4 * LANES, qx)
        store(here, 5 * LANES, qy)
        store(here, 6 * LANES, qz)
