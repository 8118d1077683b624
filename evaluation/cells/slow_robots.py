"""What a comparison leaves out, or does less of, because a step of its robot takes long; the robot is timed first."""

from __future__ import annotations

from evaluation.cells.controllers import Evolve, evolution_on
from evaluation.cells.plants import Plant, steps_in
from evaluation.experiment import Experiment
from sysid_evo.registry import Spec, make_robot

LONGEST_REFERENCE = 600.0
"""Approximate time (s) up to which evolution on the robot itself is part of a comparison by default."""
LONGEST_RUNS = 240.0
"""Approximate time (s) on one processor of all runs of controllers on the robot, by default."""
FEWEST_TRIALS = 10
"""Trials of a controller on the robot, however long they take."""


def has_reference(experiment: Experiment, robot: Plant | None, remarks: list[str], *, recorded: bool) -> bool:
    """Return whether a controller is evolved on the robot itself; add a remark if that would take too long."""
    if robot is None or robot.robot is None or experiment.reference is not None:
        return robot is not None and bool(experiment.reference)
    usual = recorded and experiment.budget.procedure == "recommended" and make_robot(robot.robot).dynamics is not None
    own = Evolve((robot,), evolution_on(experiment, (robot,)), experiment.seed)
    about = own.cell().expected_seconds if usual else 0.0
    if about > LONGEST_REFERENCE:
        remarks.append(
            f"no controller is evolved on {robot.label} itself: a step of it takes {1e3 * robot.timed:.2g} ms, "
            f"so this would take about {about / 3600.0:.1f} hours. Use --reference yes to do it anyway"
        )
    return usual and about <= LONGEST_REFERENCE


def robot_trials(experiment: Experiment, robot: Plant | None, task: Spec, controllers: int, remarks: list[str]) -> int:
    """Return the number of trials of each of ``controllers`` on the robot; add a remark if it is reduced.

    It is that of the experiment if that was given, else what all of them do in `LONGEST_RUNS`, in tens.
    """
    if experiment.robot_trials is not None:
        return experiment.robot_trials
    usual = experiment.transfer_trials
    if robot is None or not robot.timed or "transfer_trials" in experiment.model_fields_set:
        return usual
    step, steps = robot.timed, steps_in(task, (robot,))
    found = min(usual, max(FEWEST_TRIALS, 10 * int(0.1 * LONGEST_RUNS / (step * steps * controllers))))
    if found < usual:
        remarks.append(
            f"each controller is run in {found} trials on {robot.label} instead of {usual}: a step of it takes "
            f"{1e3 * step:.2g} ms, a trial of {steps} steps {step * steps:.2g} s"
        )
    return found
