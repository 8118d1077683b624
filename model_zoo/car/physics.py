"""The equation of a car on a plane (paper, Equation 1, without its thresholds)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

PHYSICAL = (
    ("thrust_forward", "m/s^2"),
    ("thrust_backward", "m/s^2"),
    ("turn_left", "rad/m/s"),
    ("turn_right", "rad/m/s"),
    ("drag_linear", "1/s"),
    ("drag_viscous", "1/m"),
    ("yaw_drag_linear", "1/s"),
    ("yaw_drag_viscous", "1/rad"),
)


def accelerations(u: Any, r: Any, u1: Any, u2: Any, parameters: Sequence[Any]) -> tuple[Any, Any]:
    """Return the rates of forward speed u and yaw rate r under drive u1 and steer u2 (+1 = left).

    ``parameters`` are U_f, U_b, R_l, R_r, D_ul, D_uv, D_rl, D_rv, in the order of `PHYSICAL`::

        du/dt = U_f max(u1, 0) - U_b max(-u1, 0) - u D_ul - u |u| D_uv
        dr/dt = u (R_l max(u2, 0) - R_r max(-u2, 0)) - r D_rl - r |r| D_rv
    """
    u_f, u_b, r_l, r_r, d_ul, d_uv, d_rl, d_rv = parameters
    thrust = u_f * positive_part(u1) - u_b * positive_part(-u1)
    turning = u * (r_l * positive_part(u2) - r_r * positive_part(-u2))
    return thrust - u * d_ul - u * abs(u) * d_uv, turning - r * d_rl - r * abs(r) * d_rv


def positive_part(value: Any) -> Any:
    """Return max(value, 0), exactly."""
    return 0.5 * (value + abs(value))
