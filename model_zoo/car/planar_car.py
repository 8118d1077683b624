"""Which channels drive and steer a planar car, and its equation (paper, Equation 1) in NumPy and compiled."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

from sysid_evo.errors import IncompatibleSystem
from sysid_evo.kernels import LANES, QUARTER, Layout, load_quarter, splat, store, view, where_at_most, where_less
from sysid_evo.models import DynamicsModel, require_planar
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System
from sysid_evo.types import Array

CarRoles: TypeAlias = tuple[int, int | None, int, int, int]
"""Positions of forward speed, lateral speed (None without one), yaw rate, drive and steer."""


class PlanarCarModel(DynamicsModel):
    """A family of planar cars; ``drive`` and ``steer`` name the controls with these roles."""

    drive: str = "drive"
    steer: str = "steer"

    def check_system(self, system: System) -> None:
        require_planar(self, system)
        for role, name in (("drive", self.drive), ("steer", self.steer)):
            if name not in system.control_names:
                raise IncompatibleSystem(
                    f"{type(self).__name__} needs a control for the role {role}: expected {name!r}, got "
                    f"{', '.join(system.control_names) or 'no controls'}; name yours with {role}=..."
                )

    @property
    def roles(self) -> CarRoles:
        """Positions of forward speed, lateral speed, yaw rate, drive and steer."""
        assert isinstance(self.system.motion, PlanarBody)
        names = self.system.control_names
        of_states = self.system.motion.indices(self.system.state_names)
        return (*of_states, names.index(self.drive), names.index(self.steer))

    def kernel_parameters(self, oldest_command: int = 0) -> Array:
        """Return the first parameters of both kernels of a car."""
        forward, lateral, yaw_rate, drive, steer = self.roles
        return HEAD.pack(
            forward=forward,
            lateral=-1 if lateral is None else lateral,
            yaw_rate=yaw_rate,
            drive=drive,
            steer=steer,
            nx=self.system.nx,
            dt=self.system.dt,
            oldest_command=oldest_command,
        )


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
"""The parameters of the equation, and their units."""


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


HEAD = Layout("forward", "lateral", "yaw_rate", "drive", "steer", "nx", "dt", "oldest_command")
"""First parameters of both kernels; the parameters of the equation follow."""

OWN = HEAD.size + len(PHYSICAL)
"""Position of the first parameter that only one of the kernels has."""


def car_rate(x, u, p, y, scratch):
    """Write the known part of dx/dt of `HybridOde` (a predictor, see `sysid_evo.models.kernels.stepping`)."""
    forward, yaw_rate, lateral = (
        int(p[HEAD.forward]) * LANES,
        int(p[HEAD.yaw_rate]) * LANES,
        int(p[HEAD.lateral]) * LANES,
    )
    drive, steer = int(p[HEAD.drive]) * LANES, int(p[HEAD.steer]) * LANES
    physical = view(p, HEAD.size)
    clear(y, int(p[HEAD.nx]))
    for lane in range(0, LANES, QUARTER):
        speed, turn = load_quarter(x, forward + lane), load_quarter(x, yaw_rate + lane)
        command = load_quarter(u, steer + lane)
        store(y, forward + lane, speed_rate(speed, load_quarter(u, drive + lane), physical))
        store(y, yaw_rate + lane, turn_rate(speed, turn, command, physical))
        if lateral >= 0:
            store(y, lateral + lane, -load_quarter(x, lateral + lane) * p[OWN])


def equation_one(x, u, p, y, scratch):
    """Write the next state of `Parametrised`, the paper's Equation 1 (a predictor)."""
    forward, yaw_rate, oldest = int(p[HEAD.forward]) * LANES, int(p[HEAD.yaw_rate]) * LANES, p[HEAD.oldest_command]
    drive, steer = int(p[HEAD.drive]) * LANES, int(p[HEAD.steer]) * LANES
    acting = view(x, int(oldest) * LANES) if oldest > 0.0 else u
    physical, dt = view(p, HEAD.size), p[HEAD.dt]
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
    """Return thrust and drag, as in `accelerations`."""
    return p[0] * max(drive, 0.0) - p[1] * max(-drive, 0.0) - speed * p[4] - speed * abs(speed) * p[5]


def turn_rate(speed, turn, steer, p):
    """Return steering and drag, as in `accelerations`."""
    return speed * (p[2] * max(steer, 0.0) - p[3] * max(-steer, 0.0)) - turn * p[6] - turn * abs(turn) * p[7]


def settled(after, command, least, most):
    """Return a next value: zero below ``least`` without a command, at most ``most`` in size."""
    moving = min(max(after, -most), most)
    return where_less(abs(after), least, where_at_most(abs(command), 0.0, 0.0, moving), moving)
