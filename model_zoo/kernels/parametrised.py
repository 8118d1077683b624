"""Equation (1) over lanes, see `Parametrised`."""

from __future__ import annotations

from sysid_evo.engine.compiled.lanes import LANES, view

FORWARD, LATERAL, YAW_RATE, DRIVE, STEER, DT, OLDEST_COMMAND, PARAMETERS = range(8)


def equation_one(x, u, p, y, scratch):
    """Write the next state (a predictor, see `sysid_evo.engine.kernels.stepping`)."""
    forward, yaw_rate = int(p[FORWARD]) * LANES, int(p[YAW_RATE]) * LANES
    if p[LATERAL] >= 0.0:
        sideways = view(y, int(p[LATERAL]) * LANES)
        for lane in range(LANES):
            sideways[lane] = 0.0
    drive, steer = view(u, int(p[DRIVE]) * LANES), view(u, int(p[STEER]) * LANES)
    if p[OLDEST_COMMAND] > 0.0:
        command = view(x, int(p[OLDEST_COMMAND]) * LANES)
        drive, steer = view(command, int(p[DRIVE]) * LANES), view(command, int(p[STEER]) * LANES)
    advance(
        view(x, forward), view(x, yaw_rate), drive, steer,
        view(p, PARAMETERS), p[DT], view(y, forward), view(y, yaw_rate),
    )  # fmt: skip


def advance(speed, turn, drive, steer, p, dt, next_speed, next_turn):
    """Thrust, steering, drag, static friction and top speeds, line by line as in `Parametrised`."""
    u_f, u_b, r_l, r_r, d_ul, d_uv, d_rl, d_rv = p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7]
    u_min, r_min, u_max, r_max = p[8], p[9], p[10], p[11]
    for lane in range(LANES):
        u, r, u1, u2 = speed[lane], turn[lane], drive[lane], steer[lane]
        thrust = u_f * max(u1, 0.0) - u_b * max(-u1, 0.0)
        turning = u * (r_l * max(u2, 0.0) - r_r * max(-u2, 0.0))
        u_after = u + dt * (thrust - u * d_ul - u * abs(u) * d_uv)
        r_after = r + dt * (turning - r * d_rl - r * abs(r) * d_rv)
        u_still = (abs(u_after) < u_min) & (u1 == 0.0)
        r_still = (abs(r_after) < r_min) & (u2 == 0.0)
        next_speed[lane] = 0.0 if u_still else min(max(u_after, -u_max), u_max)
        next_turn[lane] = 0.0 if r_still else min(max(r_after, -r_max), r_max)
