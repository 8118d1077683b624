"""Pursuit of the waypoint over lanes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from sysid_evo.controllers.pursuit import CLOSEST, DAMPING, STRAIGHTEST
from sysid_evo.kernels import LANES, ControllerKernel, KernelSource, Layout, view

if TYPE_CHECKING:
    from sysid_evo.controllers.pursuit import Pursuit

HEAD = Layout(
    "look", "acceleration", "gain", "ahead", "n_outputs", "drive", "steer", "speed", "yaw_rate", "angle", "distance"
)
HALF = math.pi / 2.0


def pursuit_kernel(pursuit: Pursuit) -> ControllerKernel:
    """Return the compiled form of a bound `Pursuit`."""
    speed, yaw_rate, angle, distance = pursuit.places
    drive, steer = pursuit.outputs
    parameters = HEAD.pack(
        pursuit.rest,
        look=pursuit.look,
        acceleration=pursuit.acceleration,
        gain=pursuit.gain,
        ahead=-1.0 if pursuit.backward else 1.0,
        n_outputs=len(pursuit.rest),
        drive=drive,
        steer=steer,
        speed=speed,
        yaw_rate=yaw_rate,
        angle=angle,
        distance=distance,
    )
    return ControllerKernel(KernelSource(pursue), parameters)


def pursue(theta, memory, observation, raw, parameters, scratch):
    """Steer along the arc to the waypoint, as fast as it allows, see `Pursuit`."""
    p, ahead = parameters, parameters[HEAD.ahead]
    speed, yaw_rate = view(observation, int(p[HEAD.speed]) * LANES), view(observation, int(p[HEAD.yaw_rate]) * LANES)
    angle, distance = view(observation, int(p[HEAD.angle]) * LANES), view(observation, int(p[HEAD.distance]) * LANES)
    for row in range(int(p[HEAD.n_outputs])):
        for lane in range(LANES):
            raw[row * LANES + lane] = p[HEAD.size + row]
    drive, steer = view(raw, int(p[HEAD.drive]) * LANES), view(raw, int(p[HEAD.steer]) * LANES)
    for lane in range(LANES):
        look = p[HEAD.look] * math.exp(min(max(theta[lane], -10.0), 10.0))
        acceleration = p[HEAD.acceleration] * math.exp(min(max(theta[LANES + lane], -10.0), 10.0))
        gain = p[HEAD.gain] * math.exp(min(max(theta[2 * LANES + lane], -10.0), 10.0))
        damping = DAMPING * theta[3 * LANES + lane]
        around = angle[lane] - math.pi if angle[lane] > 0.0 else angle[lane] + math.pi
        bearing = angle[lane] if ahead > 0.0 else around
        side = 1.0 if bearing > 0.0 else -1.0
        sine = side if abs(bearing) > HALF else math.sin(bearing)
        curvature = 2.0 * sine / max(distance[lane], CLOSEST)
        wanted = math.sqrt(acceleration / max(abs(curvature), STRAIGHTEST))
        drive[lane] = min(max(ahead * gain * (wanted - ahead * speed[lane]), -1.0), 1.0)
        steer[lane] = min(max(ahead * look * curvature - damping * yaw_rate[lane], -1.0), 1.0)
