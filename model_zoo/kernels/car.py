"""The equation of a car (`model_zoo.car.physics`) over lanes, for `HybridOde` and `Parametrised`."""

from __future__ import annotations

from sysid_evo.engine.compiled.lanes import LANES, view

FORWARD, LATERAL, YAW_RATE, DRIVE, STEER, NX, DT, OLDEST_COMMAND, PHYSICAL = range(9)
STATIC = PHYSICAL + 8


def car_rate(x, u, p, y, scratch):
    """Write the known part of dx/dt (a predictor, see `sysid_evo.engine.kernels.stepping`)."""
    for i in range(int(p[NX]) * LANES):
        y[i] = 0.0
    forward, yaw_rate = int(p[FORWARD]) * LANES, int(p[YAW_RATE]) * LANES
    if p[LATERAL] >= 0.0:
        damp(view(x, int(p[LATERAL]) * LANES), p[STATIC], view(y, int(p[LATERAL]) * LANES))
    drive_and_turn(
        view(x, forward), view(x, yaw_rate), view(u, int(p[DRIVE]) * LANES), view(u, int(p[STEER]) * LANES),
        view(p, PHYSICAL), view(y, forward), view(y, yaw_rate),
    )  # fmt: skip


def equation_one(x, u, p, y, scratch):
    """Write the next state of the paper's Equation 1 (a predictor)."""
    forward, yaw_rate = int(p[FORWARD]) * LANES, int(p[YAW_RATE]) * LANES
    for i in range(int(p[NX]) * LANES):
        y[i] = 0.0
    drive, steer = view(u, int(p[DRIVE]) * LANES), view(u, int(p[STEER]) * LANES)
    if p[OLDEST_COMMAND] > 0.0:
        command = view(x, int(p[OLDEST_COMMAND]) * LANES)
        drive, steer = view(command, int(p[DRIVE]) * LANES), view(command, int(p[STEER]) * LANES)
    drive_and_turn(
        view(x, forward), view(x, yaw_rate), drive, steer, view(p, PHYSICAL), view(y, forward), view(y, yaw_rate)
    )
    settle(view(x, forward), drive, p[DT], p[STATIC], p[STATIC + 2], view(y, forward))
    settle(view(x, yaw_rate), steer, p[DT], p[STATIC + 1], p[STATIC + 3], view(y, yaw_rate))


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
