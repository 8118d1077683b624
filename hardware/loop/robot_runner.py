"""Runs controllers on a robot by the control loop: a column of the transfer matrix."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hardware.listener import Listener
from hardware.loop.control_loop import ControlLoop
from hardware.loop.demands import check_loop
from hardware.loop.report import LoopReport, Reason
from hardware.loop.stops import Stops
from hardware.loop.trials import REST_LIMIT, TrialSeries
from hardware.robot import Robot
from sysid_evo.arrays import Array, Seeds, check_shape
from sysid_evo.controllers import Controller
from sysid_evo.engine import Rollouts
from sysid_evo.errors import InvalidArgument
from sysid_evo.progress import Progress
from sysid_evo.tasks.task import Task


@dataclass(frozen=True)
class RobotRunner:
    """Runs trials on ``robot`` one at a time, in one session of the control loop.

    The task's origin is where the robot stands at the first trial, or that of the tracker
    (``tracker_frame``). ``seed`` fixes what an emulated robot draws. A fault ends the session: the
    trial under way and those after it are missing, never scored. ``told`` is called after every decision.
    """

    robot: Robot
    tracker_frame: bool = False
    seed: int | None = None
    listeners: Sequence[Listener] = ()
    stops: Stops = field(default_factory=Stops)
    progress: Progress | None = None
    told: Callable[[TrialSeries], None] | None = None

    def run(
        self, controller: Controller, parameters: Array, task: Task, seeds: Seeds, *, record: bool = False
    ) -> Rollouts:
        """Run every candidate (P, n_parameters) in a trial of every seed (E,). Raises `LinkLost` if none connects."""
        return self.drive(controller, parameters, task, seeds)[0]

    def drive(self, controller: Controller, parameters: Array, task: Task, seeds: Seeds) -> tuple[Rollouts, LoopReport]:
        """Do as `run`, and also return how the loop went."""
        check_loop(self.robot.system)
        task = task.bind(self.robot.system)
        controller = controller.bind_to(task)
        parameters = check_shape("parameters", parameters, (None, controller.n_parameters))
        if len(seeds) < 1 or len(parameters) < 1:
            raise InvalidArgument("robot: expected at least one candidate and one trial seed, got none")
        origin = np.zeros(self.robot.system.n_pose) if self.tracker_frame else None
        series = TrialSeries(controller, parameters, task, seeds, origin=origin, progress=self.progress, told=self.told)
        with self.robot.connect(seed=self.seed) as connection:
            loop = ControlLoop(connection, self.robot.system, listeners=self.listeners, stops=self.stops)
            report = loop.run(series)
        if series.restless:
            report = replace(report, reason=Reason.RESTLESS, detail=f"it still moves after {REST_LIMIT:.0f} s")
        return series.rollouts(report.sentence), report
