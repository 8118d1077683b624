"""The equation of a car (`model_zoo.car.physics`) over lanes, for `HybridOde` and `Parametrised`."""

from __future__ import annotations

from sysid_evo.kernels import LANES, QUARTER, Layout, load_quarter, splat, store, view, where_at_most, where_less

HEAD = Layout("forward", "lateral", "yaw_rate", "drive", "steer", "nx", "dt", "oldest_command")
PHYSICAL = HEAD.size
"""Where the parameters of the equation begin; what only one of the kernels has follows them."""
OWN = PHYSICAL + 8


def car_rate(x, u, p, y, scratch):
    """Write the known part of dx/dt (a predictor, see `sysid_evo.engine.kernels.stepping`)."""
    forward, yaw_rate, lateral = (
        int(p[HEAD.forward]) * LANES,
        int(p[HEAD.yaw_rate]) * LANES,
        int(p[HEAD.lateral]) * LANES,
    )
    drive, steer = int(p[HEAD.drive]) * LANES, int(p[HEAD.steer]) * LANES
    physical = view(p, PHYSICAL)
    clear(y, int(p[HEAD.nx]))
    for lane in range(0, LANES, QUARTER):
        speed, turn = load_quarter(x, forward + lane), load_quarter(x, yaw_rate + lane)
        command = load_quarter(u, steer + lane)
        store(y, forward + lane, speed_rate(speed, load_quarter(u, drive + lane), physical))
        store(y, yaw_rate + lane, turn_rate(speed, turn, command, physical))
        if lateral >= 0:
            store(y, lateral + lane, -load_quarter(x, lateral + lane) * p[OWN])


def equation_one(x, u, p, y, scratch):
    """Write the next state of the paper's Equation 1 (a predictor)."""
    forward, yaw_rate, oldest = int(p[HEAD.forward]) * LANES, int(p[HEAD.yaw_rate]) * LANES, p[HEAD.oldest_command]
    drive, steer = int(p[HEAD.drive]) * LANES, int(p[HEAD.steer]) * LANES
    acting = view(x, int(oldest) * LANES) if oldest > 0.0 else u
    physical, dt = view(p, PHYSICAL), p[HEAD.dt]
    clear(y, int(p[HEAD.nx]))
    for lane in range(0, LANES, QUARTER):
        speed, turn = load_quarter(x, forward + lane), load_quarter(x, yaw_rate + lane)
        throttle, wheel = load_quarter(acting, drive + lane), load_quarter(acting, steer + lane)
        faster = speed + dt * speed_rate(speed, throttle, physical)
        turned = turn + dt * turn_rate(speed, turn, wheel, physical)
        store(y, forward + lane, settled(faster, throttle, p[OWN], p[OWN + 2]))
        store(y, yaw_rate + lane, settled(turned, wheel, p[OWN + 1], p[OWN + 3]))


def clear(y, rows):
    """Write zeros."""
    for row in range(rows):
        store(y, row * LANES, splat(0.0))


def speed_rate(speed, drive, p):
    """Thrust and drag, as in `model_zoo.car.physics`."""
    return p[0] * max(drive, 0.0) - p[1] * max(-drive, 0.0) - speed * p[4] - speed * abs(speed) * p[5]


def turn_rate(speed, turn, steer, p):
    """Steering and drag, as in `model_zoo.car.physics`."""
    return speed * (p[2] * max(steer, 0.0) - p[3] * max(-steer, 0.0)) - turn * p[6] - turn * abs(turn) * p[7]


def settled(after, command, least, most):
    """A next value: still below ``least`` without a command, at most ``most``."""
    moving = min(max(after, -most), most)
    return where_less(abs(after), least, where_at_most(abs(command), 0.0, 0.0, moving), moving)
