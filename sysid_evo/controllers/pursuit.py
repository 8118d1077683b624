"""Pure pursuit: drive a planar body along the arc that leads to the waypoint."""

from __future__ import annotations

import copy
import math
from typing import ClassVar, Self

import numpy as np

from sysid_evo.controllers.controller import Controller, View, controlled, observed
from sysid_evo.controllers.program import (
    Binary,
    Expression,
    Program,
    Statement,
    apply,
    choose,
    constant,
    dot,
    limited,
    number,
    observation,
    take,
)
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import LANES, ControllerKernel, KernelSource, Layout, view
from sysid_evo.registry.registry import register_controller
from sysid_evo.tasks.task import Task
from sysid_evo.types import Array, check_shape

SHOWN = ("forward_speed", "yaw_rate", "waypoint_angle", "waypoint_distance")
DAMPING = 0.1
"""What a damping parameter of 1 means, in s."""
CLOSEST = 0.05
"""A waypoint nearer than this (m) is steered for as if it were this far."""
STRAIGHTEST = 1e-3
"""Arcs straighter than this (1/m) count as this."""


@register_controller("pursuit")
class Pursuit(Controller):
    """Pure pursuit of the next waypoint, as fast as the arc to it allows.

    With the waypoint at angle a and distance d, the arc there has the curvature c; a waypoint abreast or behind is
    turned to as sharply as one abreast::

        c = 2 sin(a) / d,   or  2 sign(a) / d  for |a| > pi / 2
        steer = look c - damping yaw_rate
        drive = gain (sqrt(acceleration / |c|) - forward_speed)

    limited to [-1, 1]; left and forward are positive. With ``backward`` the tail leads: a is the angle from there,
    the speed is counted backward, drive and look c change their signs. ``look`` (m) is how hard it steers,
    ``acceleration`` (m/s2) the sideways one that it counts on, ``gain`` is in s/m. The four parameters are the
    logarithms of look, acceleration and gain, relative to those, and the damping in units of 0.1 s: all zero, it
    drives as it was made. ``drive`` and ``steer`` name the controls; any others stay neutral.
    """

    hand_written: ClassVar[bool] = True
    n_parameters = 4
    n_memory = 0

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
        bound.places = observed("pursuit", SHOWN, task)
        bound.outputs = controlled("pursuit (name yours with drive= and steer=)", (self.drive, self.steer), task)
        bound.n_observations = len(task.observations)
        bound.rest = task.system.raw_of(task.system.neutral_control)
        return bound

    n_observations: int
    places: tuple[int, ...]
    outputs: tuple[int, ...]
    rest: Array

    def settings(self, parameters: Array) -> Array:
        """Return look, acceleration, gain and damping (s) of every candidate, (4, P)."""
        check_shape("parameters", parameters, (None, self.n_parameters))
        made = np.array([self.look, self.acceleration, self.gain])
        scaled = made * np.exp(np.clip(parameters[:, :3], -10.0, 10.0))
        return np.concatenate([scaled, DAMPING * parameters[:, 3:]], axis=1).T

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        look, acceleration, gain, damping = self.settings(parameters)[:, :, None]
        speed, yaw_rate, angle, distance = (view.observation[..., place] for place in self.places)
        ahead = -1.0 if self.backward else 1.0
        if self.backward:
            angle = np.where(angle > 0.0, angle - math.pi, angle + math.pi)
        sine = np.where(np.abs(angle) > math.pi / 2.0, np.where(angle > 0.0, 1.0, -1.0), np.sin(angle))
        curvature = 2.0 * sine / np.maximum(distance, CLOSEST)
        wanted = np.sqrt(acceleration / np.maximum(np.abs(curvature), STRAIGHTEST))
        raw = np.tile(self.rest, (*speed.shape, 1))
        raw[..., self.outputs[0]] = np.clip(ahead * gain * (wanted - ahead * speed), -1.0, 1.0)
        raw[..., self.outputs[1]] = np.clip(ahead * look * curvature - damping * yaw_rate, -1.0, 1.0)
        return raw, memory.copy()

    def kernel(self) -> ControllerKernel:
        speed, yaw_rate, angle, distance = self.places
        drive, steer = self.outputs
        parameters = HEAD.pack(
            self.rest,
            look=self.look,
            acceleration=self.acceleration,
            gain=self.gain,
            ahead=-1.0 if self.backward else 1.0,
            n_outputs=len(self.rest),
            drive=drive,
            steer=steer,
            speed=speed,
            yaw_rate=yaw_rate,
            angle=angle,
            distance=distance,
        )
        return ControllerKernel(KernelSource(act_lanes), parameters)

    def program(self, parameters: Array) -> Program:
        look, acceleration, gain, damping = map(float, self.settings(parameters[None])[:, 0])
        shown = observation(self.n_observations)
        seen = [
            Statement(name, take(name.upper(), shown, place)) for name, place in zip(SHOWN, self.places, strict=True)
        ]
        speed, yaw_rate, angle, distance = (statement.value for statement in seen)
        ahead = -1.0 if self.backward else 1.0
        tail = choose(angle, ">", 0.0, angle - math.pi, angle + math.pi)
        bearing = Statement("bearing", tail if self.backward else angle + 0.0, "rad, from where it drives to")
        side = choose(bearing.value, ">", 0.0, 1.0, -1.0)
        sine = choose(apply("abs", bearing.value), ">", math.pi / 2.0, side, apply("sin", bearing.value))
        curvature = Statement(
            "curvature", number(2.0) * sine / _max(distance, CLOSEST), "1/m, of the arc to the waypoint"
        )
        bend = _max(apply("abs", curvature.value), STRAIGHTEST)
        wanted = Statement("wanted", apply("sqrt", number(acceleration) / bend), "m/s, how fast the arc can be driven")
        drive = Statement("push", limited((wanted.value - speed * ahead) * (ahead * gain)), "forward")
        steer = Statement("turn", limited(curvature.value * (ahead * look) - yaw_rate * damping), "to the left")
        unit = np.eye(len(self.rest))
        rest = np.where(unit[list(self.outputs)].any(axis=0), 0.0, self.rest)
        pushed, turned = (unit[:, [place]] for place in self.outputs)
        both = dot("PUSHES", pushed, drive.value) + dot("TURNS", turned, steer.value)
        raw = Statement("raw", constant("REST", rest) + both, "outputs in [-1, 1]")
        return Program((*seen, bearing, curvature, wanted, drive, steer, raw), raw.value)


def _max(of: Expression, least: float) -> Binary:
    return Binary(of.size, "max", of, number(least))


HEAD = Layout(
    "look", "acceleration", "gain", "ahead", "n_outputs", "drive", "steer", "speed", "yaw_rate", "angle", "distance"
)
HALF = math.pi / 2.0


def act_lanes(theta, memory, observation, raw, parameters, scratch):
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
