"""What can be refused before a robot moves: each check looks at descriptions and opens no connection."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hardware.driving.keyboard import control_of, key_life
from hardware.loop.demands import check_loop
from hardware.loop.estimator import PoseEstimator
from hardware.recording.journal import check_journals
from hardware.robot import Robot
from sysid_evo.arrays import Array, check_shape
from sysid_evo.controllers import Controller
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.extras import check_installed
from sysid_evo.system import System
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
        controller = controller.bind_to(task)
        if parameters is not None:
            check_shape("parameters", parameters, (None, controller.n_parameters))
    robot.check()


def check_driving_by_hand(robot: Robot, task: Task) -> None:
    """Raise if a person could not drive ``robot`` at ``task`` on the page.

    Raises what `check_driving` raises, `IncompatibleSystem` for a robot that nothing shows, `InvalidArgument` for
    controls that keys cannot move and `MissingExtra` if the page cannot be served.
    """
    if robot.system.motion is None:
        raise IncompatibleSystem(
            f"driving by hand: expected a robot that a tracker sees, but {robot.name} has no pose to show. With "
            "--controller and --watch the page shows how a controller drives it"
        )
    check_installed("driving by hand", PAGE)
    control_of(0, robot.system)
    key_life(robot.system)
    check_driving(robot, task)


def check_recording(robot: Robot, folder: Path | None, *, duration: float) -> None:
    """Raise if ``robot`` could not be recorded for ``duration`` s with journals in ``folder`` (None: a temporary one).

    Raises `IncompatibleSystem`, `InvalidArgument`, and what `Robot.check` raises.
    """
    manoeuvres = robot.manoeuvres(duration=duration, rng=np.random.default_rng(0))
    if folder is not None:
        check_journals(folder, [manoeuvre.name for manoeuvre in manoeuvres])
    robot.check()


def check_same_robot(data: System, robot: Robot) -> None:
    """Raise `IncompatibleSystem` with every difference if ``data`` were not recorded on such a robot."""
    found = data.differences(robot.system)
    if found:
        raise IncompatibleSystem(
            f"the data are not of robot {robot.name!r}: {'; '.join(found)}. Choose the robot that was recorded, "
            "or record this one"
        )
