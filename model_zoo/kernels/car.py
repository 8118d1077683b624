"""The equation of a car (`model_zoo.car.physics`) over lanes, for `HybridOde` and `Parametrised`."""

from __future__ import annotations

from sysid_evo.engine.compiled.lanes import LANES, view
from sysid_evo.engine.compiled.layout import Layout

HEAD = Layout("forward", "lateral", "yaw_rate", "drive", "steer", "nx", "dt", "oldest_command")
PHYSICAL = HEAD.size
"""Where the parameters of the equation begin; what only one of the kernels has follows them."""
OWN = PHYSICAL + 8


def car_rate(x, u, p, y, scratch):
    """Write the known part of dx/dt (a predictor, see `sysid_evo.engine.kernels.stepping`)."""
    for i in range(int(p[HEAD.nx]) * LANES):
        y[i] = 0.0
    forward, yaw_rate = int(p[HEAD.forward]) * LANES, int(p[HEAD.yaw_rate]) * LANES
    if p[HEAD.lateral] >= 0.0:
        damp(view(x, int(p[HEAD.lateral]) * LANES), p[OWN], view(y, int(p[HEAD.lateral]) * LANES))
    drive_and_turn(
        view(x, forward), view(x, yaw_rate), view(u, int(p[HEAD.drive]) * LANES), view(u, int(p[HEAD.steer]) * LANES),
        view(p, PHYSICAL), view(y, forward), view(y, yaw_rate),
    )  # fmt: skip


def equation_one(x, u, p, y, scratch):
    """Write the next state of the paper's Equation 1 (a predictor)."""
    forward, yaw_rate = int(p[HEAD.forward]) * LANES, int(p[HEAD.yaw_rate]) * LANES
    for i in range(int(p[HEAD.nx]) * LANES):
        y[i] = 0.0
    drive, steer = view(u, int(p[HEAD.drive]) * LANES), view(u, int(p[HEAD.steer]) * LANES)
    if p[HEAD.oldest_command] > 0.0:
        command = view(x, int(p[HEAD.oldest_command]) * LANES)
        drive, steer = view(command, int(p[HEAD.drive]) * LANES), view(command, int(p[HEAD.steer]) * LANES)
    drive_and_turn(
        view(x, forward), view(x, yaw_rate), drive, steer, view(p, PHYSICAL), view(y, forward), view(y, yaw_rate)
    )
    settle(view(x, forward), drive, p[HEAD.dt], p[OWN], p[OWN + 2], view(y, forward))
    settle(view(x, yaw_rate), steer, p[HEAD.dt], p[OWN + 1], p[OWN + 3], view(y, yaw_rate))


def damp(sideways, drag, rate):
    """rate = -drag sideways."""
    for lane in range(LANES):
        rate[lane] = -sideways[lane] * drag


def drive_and_turn(speed, turn, drive, steer, p, speed_rate, turn_rate):
    """Thrust, steering and drag, line by line as in `model_zoo.car.physics`."""
    u_f, u_b, r_l, r_r, d_ul, d_uv, d_rl, d_rv = p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7]
    for lane in range(LANES):
        u, r, u1, u2 = speed[lane], turn[lane], drive[lane], steer[lane]
        speed_rate[lane] = u_f * max(u1, 0.0) - u_b * max(-u1, 0.0) - u * d_ul - u * abs(u) * d_uv
        turn_rate[lane] = u * (r_l * max(u2, 0.0) - r_r * max(-u2, 0.0)) - r * d_rl - r * abs(r) * d_rv


def settle(before, command, dt, least, most, rate):
    """Turn a rate into the next value: still below ``least`` without a command, at most ``most``."""
    for lane in range(LANES):
        after = before[lane] + dt * rate[lane]
        still = (abs(after) < least) & (command[lane] == 0.0)
        rate[lane] = 0.0 if still else min(max(after, -most), most)
