"""Pursuit, written by hand: drive a planar body along the arc that leads to the waypoint."""

from __future__ import annotations

import copy
import math
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from sysid_evo.arrays import Array, check_shape
from sysid_evo.controllers.controller import Controller, View
from sysid_evo.controllers.named import controlled, observed
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import register_controller
from sysid_evo.tasks.task import Task

if TYPE_CHECKING:
    from sysid_evo.export.program import Program
    from sysid_evo.kernels import ControllerKernel

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
        from sysid_evo.engine.kernels.pursuit import pursuit_kernel

        return pursuit_kernel(self)

    def program(self, parameters: Array) -> Program:
        from sysid_evo.controllers.pursuit_program import pursuit_program

        return pursuit_program(self, parameters)
