"""What can be refused before a robot moves: each check looks at descriptions and opens no connection."""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path

import numpy as np

from hardware.driving.keyboard import control_of, key_life
from hardware.loop.demands import check_loop
from hardware.loop.estimator import PoseEstimator
from hardware.recording.excitation import excitation
from hardware.recording.journal import check_journals
from hardware.robot import Robot
from sysid_evo.arrays import Array, check_shape
from sysid_evo.controllers import Controller
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.extras import check_installed
from sysid_evo.system import Channel, System
from sysid_evo.tasks import Task

PAGE = ("starlette", "uvicorn", "websockets")
"""Modules that the page for driving by hand is served with."""


def check_driving(
    robot: Robot, task: Task, controller: Controller | None = None, parameters: Array | None = None
) -> None:
    """Raise if ``controller`` could not drive ``robot`` at ``task``; its ``parameters`` are (P, n_parameters).

    Raises `IncompatibleSystem`, `IncompatibleTask`, `InvalidSystem`, `ShapeError`, and what
    `Robot.check` raises.
    """
    system = robot.system
    check_loop(system)
    PoseEstimator(system)
    system.actuate(np.zeros(system.nu))
    task = task.bind(system)
    if controller is not None:
        controller = controller.bind(len(task.observations), system.nu)
        if parameters is not None:
            check_shape("parameters", parameters, (None, controller.n_parameters))
    robot.check()


def check_driving_by_hand(robot: Robot, task: Task) -> None:
    """Raise if a person could not drive ``robot`` at ``task`` on the page.

    Raises what `check_driving` raises, `InvalidArgument` for controls that keys cannot move and
    `MissingExtra` if the page cannot be served.
    """
    check_installed("driving by hand", PAGE)
    control_of(0, robot.system)
    key_life(robot.system)
    check_driving(robot, task)


def check_recording(robot: Robot, folder: Path | None, *, duration: float) -> None:
    """Raise if ``robot`` could not be recorded for ``duration`` s with journals in ``folder`` (None: a temporary one).

    Raises `IncompatibleSystem`, `InvalidArgument`, and what `Robot.check` raises.
    """
    check_loop(robot.system)
    manoeuvres = excitation(robot.system, duration=duration, rng=np.random.default_rng(0))
    if folder is not None:
        check_journals(folder, [manoeuvre.name for manoeuvre in manoeuvres])
    robot.check()


def check_same_robot(data: System, robot: Robot) -> None:
    """Raise `IncompatibleSystem` with every difference if ``data`` were not recorded on such a robot."""
    found = differences(data, robot.system)
    if found:
        raise IncompatibleSystem(
            f"the data are not of robot {robot.name!r}: {'; '.join(found)}. Choose the robot that was recorded, "
            "or record this one"
        )


def differences(data: System, robot: System) -> tuple[str, ...]:
    """Return in what the system of the data and that of a robot differ; nothing if they are the same.

    Names of systems do not count, those of channels and their order do.
    """
    found = []
    for kind, ours, theirs in (("state", data.states, robot.states), ("control", data.controls, robot.controls)):
        names = [", ".join(channel.name for channel in channels) or "none" for channels in (ours, theirs)]
        if names[0] != names[1]:
            found.append(f"{kind}s are {names[0]} in the data, {names[1]} on the robot")
        else:
            found += [line for pair in zip(ours, theirs, strict=True) for line in _channel(kind, *pair)]
    if not math.isclose(data.dt, robot.dt, rel_tol=1e-9):
        found.append(f"dt is {data.dt:g} s in the data, {robot.dt:g} s on the robot")
    if data.motion != robot.motion:
        found.append(f"the motion is {data.motion} in the data, {robot.motion} on the robot")
    return tuple(found)


def _channel(kind: str, data: Channel, robot: Channel) -> list[str]:
    """Return in what two channels of one name differ."""
    return [
        f"{kind} {data.name!r} has {item.name} {getattr(data, item.name)!r} in the data, "
        f"{getattr(robot, item.name)!r} on the robot"
        for item in fields(Channel)
        if item.compare and getattr(data, item.name) != getattr(robot, item.name)
    ]
