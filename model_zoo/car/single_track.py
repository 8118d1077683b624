"""Family single_track: a car with saturating tyres, as a grey box.

The equations are functions of plain numbers, as for kernels, and also run on arrays (`model_zoo.grey_box`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal

from model_zoo.car.planar_car import PlanarCarModel
from model_zoo.grey_box.model import GreyBox
from model_zoo.grey_box.parameters import Parameter
from sysid_evo import PlanarBody, System, register_model
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.kernels import Layout

AT_REST = 0.05
"""Speed in m/s at which three quarters of the rolling resistance act."""
MIN_LOAD = 0.1
"""Smallest load of an axle, as a share of its load at rest."""

PARAMETERS = (
    Parameter("thrust_forward", 4.0, 0.2, 40.0, "m/s^2"),
    Parameter("thrust_backward", 3.0, 0.2, 40.0, "m/s^2"),
    Parameter("back_emf", 0.5, 0.0, 10.0, "1/s"),
    Parameter("drag_linear", 0.5, 0.0, 10.0, "1/s"),
    Parameter("drag_quadratic", 0.05, 0.0, 3.0, "1/m"),
    Parameter("rolling_resistance", 0.3, 0.0, 5.0, "m/s^2"),
    Parameter("steer_left", 0.3, 0.03, 0.8, "rad"),
    Parameter("steer_right", 0.3, 0.03, 0.8, "rad"),
    Parameter("steer_offset", 0.0, -0.2, 0.2, "rad"),
    Parameter("front_axle", 0.1, 0.02, 3.0, "m"),
    Parameter("rear_axle", 0.1, 0.02, 3.0, "m"),
    Parameter("gyration_radius", 0.1, 0.01, 3.0, "m"),
    Parameter("front_grip", 4.0, 0.3, 30.0, "m/s^2"),
    Parameter("rear_grip", 4.0, 0.3, 30.0, "m/s^2"),
    Parameter("front_stiffness", 6.0, 0.5, 60.0, "1/rad"),
    Parameter("rear_stiffness", 6.0, 0.5, 60.0, "1/rad"),
    Parameter("traction_limit", 6.0, 0.5, 60.0, "m/s^2"),
    Parameter("thrust_grip_loss", 0.4, 0.0, 0.95, "1"),
    Parameter("load_transfer", 0.02, 0.0, 0.15, "s^2/m"),
    Parameter("slip_floor", 1.0, 0.2, 4.0, "m/s"),
)
"""Parameters of both tyre models. Forces are per mass, in units of acceleration."""
MAGIC = (Parameter("tyre_shape", 1.4, 0.5, 2.5, "1"), Parameter("tyre_curvature", 0.0, -5.0, 1.0, "1"))
"""Pacejka's C and E."""

P = Layout(*(parameter.name for parameter in (*PARAMETERS, *MAGIC)))


def pacejka_rate(state: Any, control: Any, p: Any) -> Any:
    """Return the rates with Pacejka's magic formula: D sin(C atan(s - E (s - atan s))), s = B slip."""
    front_slip, rear_slip = slips(state, control, p)
    front_grip, rear_grip = grips(state, control, p)
    front = front_grip * magic(p[P.front_stiffness] * front_slip, p[P.tyre_shape], p[P.tyre_curvature])
    rear = rear_grip * magic(p[P.rear_stiffness] * rear_slip, p[P.tyre_shape], p[P.tyre_curvature])
    return body_rates(state, control, p, front, rear)


def tanh_rate(state: Any, control: Any, p: Any) -> Any:
    """Return the rates with the simplest tyre that saturates: D tanh(B slip)."""
    front_slip, rear_slip = slips(state, control, p)
    front_grip, rear_grip = grips(state, control, p)
    front = front_grip * math.tanh(p[P.front_stiffness] * front_slip)
    rear = rear_grip * math.tanh(p[P.rear_stiffness] * rear_slip)
    return body_rates(state, control, p, front, rear)


def magic(slip: Any, shape: Any, curvature: Any) -> Any:
    """Return the share of the grip that a scaled slip uses."""
    bent = slip - curvature * (slip - math.atan2(slip, 1.0))
    return math.sin(shape * math.atan2(bent, 1.0))


def slips(state: Any, control: Any, p: Any) -> Any:
    """Return sideways speed over speed at the front and the rear wheels; the speed has a lower bound."""
    u, v, r = state
    angle = steering_angle(control, p)
    pace = math.sqrt(u * u + p[P.slip_floor] * p[P.slip_floor])
    front = (u * math.sin(angle) - (v + p[P.front_axle] * r) * math.cos(angle)) / pace
    return front, (p[P.rear_axle] * r - v) / pace


def grips(state: Any, control: Any, p: Any) -> Any:
    """Return the largest sideways accelerations of both axles: thrust reduces that of the rear, and shifts the load."""
    used = traction(state, control, p) / p[P.traction_limit]
    shift = p[P.load_transfer] * p[P.traction_limit] * used
    front = p[P.front_grip] * max(1.0 - shift, MIN_LOAD)
    rear = p[P.rear_grip] * max(1.0 + shift, MIN_LOAD) * (1.0 - p[P.thrust_grip_loss] * used * used)
    return front, rear


def body_rates(state: Any, control: Any, p: Any, front: Any, rear: Any) -> Any:
    """Return the rates under sideways forces per mass, without the rotation of the frame."""
    u, _, _ = state
    angle = steering_angle(control, p)
    drag = (p[P.drag_linear] + p[P.drag_quadratic] * abs(u)) * u
    rolling = p[P.rolling_resistance] * math.tanh(u / AT_REST)
    across = front * math.cos(angle)
    turning = (p[P.front_axle] * across - p[P.rear_axle] * rear) / (p[P.gyration_radius] * p[P.gyration_radius])
    along = traction(state, control, p) - drag - rolling - front * math.sin(angle)
    return along, across + rear, turning


def traction(state: Any, control: Any, p: Any) -> Any:
    """Return the thrust per mass: the motor's, which falls with speed, limited by the grip of the tyres."""
    u, _, _ = state
    drive, _ = control
    motor = p[P.thrust_forward] * max(drive, 0.0) - p[P.thrust_backward] * max(-drive, 0.0)
    motor = motor - p[P.back_emf] * abs(drive) * u
    return p[P.traction_limit] * math.tanh(motor / p[P.traction_limit])


def steering_angle(control: Any, p: Any) -> Any:
    """Return the angle of the front wheels, positive to the left."""
    _, steer = control
    return p[P.steer_left] * max(steer, 0.0) - p[P.steer_right] * max(-steer, 0.0) + p[P.steer_offset]


@register_model("single_track")
class SingleTrack(GreyBox, PlanarCarModel):
    """Single-track car with saturating tyres, load transfer, and lag and delay of the actuators (grey box).

    With forward speed u, lateral speed v, yaw rate r, steering angle d and forces per mass::

        du/dt = T - (drag + quadratic |u|) u - rolling tanh(u / 0.05) - F_f sin d + v r
        dv/dt = F_f cos d + F_r - u r
        dr/dt = (a F_f cos d - b F_r) / k^2
        T     = limit tanh((thrust drive - back_emf |drive| u) / limit)
        s_f   = (u sin d - (v + a r) cos d) / pace,  s_r = (b r - v) / pace,  pace = sqrt(u^2 + floor^2)

    ``tyre="pacejka"``: F = D sin(C atan(B s - E (B s - atan B s))), C and E the same for both axles (Pacejka 2012,
    chapter 4); ``tyre="tanh"``: F = D tanh(B s). The rear grip D falls with the square of T / limit, and
    ``load_transfer`` of T shifts to the rear. ``drive`` and ``steer`` name the controls with these roles. The fit and
    the other parameters are those of all grey boxes (docs/grey_box.md).
    """

    knowledge = "grey"
    tyre: Literal["pacejka", "tanh"] = "pacejka"
    substeps: int = 3
    actuator_lag: bool = True
    command_delay: bool = True

    @property
    def law(self) -> Callable[..., Any]:
        return pacejka_rate if self.tyre == "pacejka" else tanh_rate

    def law_parameters(self) -> tuple[Parameter, ...]:
        return (*PARAMETERS, *MAGIC) if self.tyre == "pacejka" else PARAMETERS

    def check_system(self, system: System) -> None:
        PlanarCarModel.check_system(self, system)
        assert isinstance(system.motion, PlanarBody)
        if system.motion.lateral is None:
            raise IncompatibleSystem(
                "SingleTrack needs the lateral speed for the slip of its tyres, but the motion names no channel for "
                "it; use the family parametrised instead"
            )
        GreyBox.check_system(self, system)

    def channel_indices(self, system: System) -> tuple[tuple[int, ...], tuple[int, ...]]:
        assert isinstance(system.motion, PlanarBody)
        forward, lateral, yaw_rate = system.motion.indices(system.state_names)
        assert lateral is not None
        names = system.control_names
        return (forward, lateral, yaw_rate), (names.index(self.drive), names.index(self.steer))
