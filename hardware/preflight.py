"""Checks before a robot moves: each uses descriptions only and opens no connection."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hardware.control_loop import check_loop
from hardware.estimator import PoseEstimator
from hardware.recording.journal import check_journals
from hardware.robot import Robot
from sysid_evo.controllers import Controller
from sysid_evo.tasks import Task
from sysid_evo.types import Array, check_shape


def check_driving(
    robot: Robot, task: Task, controller: Controller | None = None, parameters: Array | None = None
) -> None:
    """Raise if ``controller`` cannot drive ``robot`` at ``task``; its ``parameters`` are (P, n_parameters).

    Raises `IncompatibleSystem`, `IncompatibleTask`, `InvalidSystem`, `ShapeError`, and the errors of `Robot.check`.
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


def check_recording(robot: Robot, folder: Path | None, *, duration: float) -> None:
    """Raise if ``robot`` cannot be recorded for ``duration`` s with journals in ``folder`` (None: a temporary one).

    Raises `IncompatibleSystem`, `InvalidArgument`, and the errors of `Robot.check`.
    """
    manoeuvres = robot.manoeuvres(duration=duration, rng=np.random.default_rng(0))
    if folder is not None:
        check_journals(folder, [manoeuvre.name for manoeuvre in manoeuvres])
    robot.check()
