"""Pure pursuit: drive a planar body along the arc to the waypoint."""

from __future__ import annotations

import copy
import math
from typing import ClassVar, Self

from sysid_evo.controllers.controller import ControllerLaw, LawController, control_indices, observation_indices
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import Layout, splat
from sysid_evo.registry.registry import register_controller
from sysid_evo.tasks.task import Task

SHOWN = ("forward_speed", "yaw_rate", "waypoint_angle", "waypoint_distance")
DAMPING = 0.1
"""Damping (s) for a parameter of 1."""
CLOSEST = 0.05
"""Lower bound (m) of the distance to the waypoint."""
STRAIGHTEST = 1e-3
"""Lower bound (1/m) of the curvature of an arc."""


@register_controller("pursuit")
class Pursuit(LawController):
    """Pure pursuit of the next waypoint, as fast as the arc to it allows.

    With the waypoint at angle a and distance d, the arc there has the curvature c; for a waypoint behind, it is that
    for a waypoint at the side::

        c = 2 sin(a) / d,   or  2 sign(a) / d  for |a| > pi / 2
        steer = look c - damping yaw_rate
        drive = gain (sqrt(acceleration / |c|) - forward_speed)

    limited to [-1, 1]; left and forward are positive. With ``backward`` the robot drives in reverse: a is the angle
    from the tail, the speed is that backward, drive and look c change sign. ``look`` (m) is the gain of the steering,
    ``acceleration`` (m/s2) the available lateral acceleration, ``gain`` is in s/m. The four parameters are the
    logarithms of look, acceleration and gain, relative to the given values, and the damping in units of 0.1 s; zeros
    change nothing. ``drive`` and ``steer`` name the controls; any others stay neutral.
    """

    is_baseline: ClassVar[bool] = True
    n_parameters = 4

    def __init__(
        self,
        *,
        look: float = 0.7,
        acceleration: float = 10.0,
        gain: float = 0.5,
        backward: bool = False,
        drive: str = "drive",
        steer: str = "steer",
    ) -> None:
        if not all(0.0 < value < math.inf for value in (look, acceleration, gain)):
            raise InvalidArgument(f"pursuit: expected look, acceleration, gain > 0, got {look}, {acceleration}, {gain}")
        self.look, self.acceleration, self.gain, self.backward = look, acceleration, gain, backward
        self.drive, self.steer = drive, steer

    def bind_to(self, task: Task) -> Self:
        bound = copy.copy(self)
        speed, yaw_rate, angle, distance = observation_indices("pursuit", SHOWN, task)
        drive, steer = control_indices("pursuit (name yours with drive= and steer=)", (self.drive, self.steer), task)
        rest = task.system.raw_output(task.system.neutral_control)
        bound.n_observations, bound.n_outputs = len(task.observations), len(rest)
        shared = HEAD.pack(
            rest,
            look=self.look,
            acceleration=self.acceleration,
            gain=self.gain,
            ahead=-1.0 if self.backward else 1.0,
            n_outputs=len(rest),
            drive=drive,
            steer=steer,
            speed=speed,
            yaw_rate=yaw_rate,
            angle=angle,
            distance=distance,
        )
        bound.law = ControllerLaw(pursuit, shared)
        return bound


HEAD = Layout(
    "look", "acceleration", "gain", "ahead", "n_outputs", "drive", "steer", "speed", "yaw_rate", "angle", "distance"
)
HALF = math.pi / 2.0


def pursuit(theta, memory, observation, raw, parameters, scratch):
    """Steer along the arc to the waypoint, as fast as it allows, see `Pursuit`."""
    p, ahead = parameters, parameters[HEAD.ahead]
    angle, distance = observation[int(p[HEAD.angle])], observation[int(p[HEAD.distance])]
    speed, yaw_rate = observation[int(p[HEAD.speed])], observation[int(p[HEAD.yaw_rate])]
    for i in range(int(p[HEAD.n_outputs])):
        raw[i] = splat(p[HEAD.size + i])
    look = p[HEAD.look] * math.exp(min(max(theta[0], -10.0), 10.0))
    acceleration = p[HEAD.acceleration] * math.exp(min(max(theta[1], -10.0), 10.0))
    gain = p[HEAD.gain] * math.exp(min(max(theta[2], -10.0), 10.0))
    damping = DAMPING * theta[3]
    around = angle - math.pi if angle > 0.0 else angle + math.pi
    bearing = angle if ahead > 0.0 else around
    side = 1.0 if bearing > 0.0 else -1.0
    sine = side if abs(bearing) > HALF else math.sin(bearing)
    curvature = 2.0 * sine / max(distance, CLOSEST)
    wanted = math.sqrt(acceleration / max(abs(curvature), STRAIGHTEST))
    raw[int(p[HEAD.drive])] = min(max(ahead * gain * (wanted - ahead * speed), -1.0), 1.0)
    raw[int(p[HEAD.steer])] = min(max(ahead * look * curvature - damping * yaw_rate, -1.0), 1.0)
