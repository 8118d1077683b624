"""Pursuit as a program that can be written in other languages."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.controllers.pursuit import CLOSEST, SHOWN, STRAIGHTEST
from sysid_evo.export.program import (
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

if TYPE_CHECKING:
    from sysid_evo.controllers.pursuit import Pursuit


def pursuit_program(pursuit: Pursuit, parameters: Array) -> Program:
    """Return a bound `Pursuit` with these parameters (n_parameters,) as a program."""
    look, acceleration, gain, damping = map(float, pursuit.settings(parameters[None])[:, 0])
    shown = observation(pursuit.n_observations)
    seen = [
        Statement(name, take(name.upper(), shown, place)) for name, place in zip(SHOWN, pursuit.places, strict=True)
    ]
    speed, yaw_rate, angle, distance = (statement.value for statement in seen)
    ahead = -1.0 if pursuit.backward else 1.0
    tail = choose(angle, ">", 0.0, angle - math.pi, angle + math.pi)
    bearing = Statement("bearing", tail if pursuit.backward else angle + 0.0, "rad, from where it drives to")
    side = choose(bearing.value, ">", 0.0, 1.0, -1.0)
    sine = choose(apply("abs", bearing.value), ">", math.pi / 2.0, side, apply("sin", bearing.value))
    curvature = Statement("curvature", number(2.0) * sine / _max(distance, CLOSEST), "1/m, of the arc to the waypoint")
    bend = _max(apply("abs", curvature.value), STRAIGHTEST)
    wanted = Statement("wanted", apply("sqrt", number(acceleration) / bend), "m/s, how fast the arc can be driven")
    drive = Statement("push", limited((wanted.value - speed * ahead) * (ahead * gain)), "forward")
    steer = Statement("turn", limited(curvature.value * (ahead * look) - yaw_rate * damping), "to the left")
    unit = np.eye(len(pursuit.rest))
    rest = np.where(unit[list(pursuit.outputs)].any(axis=0), 0.0, pursuit.rest)
    pushed, turned = (unit[:, [place]] for place in pursuit.outputs)
    both = dot("PUSHES", pushed, drive.value) + dot("TURNS", turned, steer.value)
    raw = Statement("raw", constant("REST", rest) + both, "outputs in [-1, 1]")
    return Program((*seen, bearing, curvature, wanted, drive, steer, raw), raw.value)


def _max(of: Expression, least: float) -> Binary:
    return Binary(of.size, "max", of, number(least))
