"""What is achieved on a robot: trials of a controller there, and the cell that they add to a run."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from sysid_evo.cli.console import out, tell
from sysid_evo.cli.exits import code_of_loop

if TYPE_CHECKING:
    from rich.table import Table

    from evaluation.transfer import Measured
    from hardware.listener import Listener
    from hardware.loop.report import LoopReport
    from hardware.loop.trials import TrialSeries
    from hardware.robot import Robot
    from sysid_evo.arrays import Seeds
    from sysid_evo.cli.watching import Watching
    from sysid_evo.engine import Rollouts
    from sysid_evo.evolution import Champion

TRACES = 10
"""Trials whose trajectories are kept for the plots."""


def drive_controller(
    controller: str,
    robot: str,
    *,
    task: str,
    trials: int,
    folder: Path | None = None,
    seed: int | None = None,
    tracker_origin: bool = False,
    listeners: Sequence[Listener] = (),
    watching: Watching | None = None,
    keep: Path | None = None,
) -> int:
    """Run ``controller``, the file of an evolved one or the spec of one written by hand, and return the exit code.

    An evolved one has its own task, one written by hand does ``task``.
    The trials are those of the transfer matrix, from the first on. The result becomes a cell of the run
    in ``folder``, or of the one that the file belongs to, whose report is then made again. ``watching`` shows it
    on a page. ``keep`` is a folder for the data set of the trials of a robot that steps when it is told to.
    """
    from evaluation.transfer import Measured, cell_of, transfer_seeds
    from hardware.driving.controller_panel import ControllerPanel, moment_of
    from hardware.emulation.pacing import in_real_time
    from hardware.loop.report import Reason
    from hardware.loop.robot_runner import RobotRunner
    from hardware.loop.stops import Stops
    from hardware.preflight import check_driving
    from hardware.robot import find_robot
    from sysid_evo.cli.hand_driving import page_server
    from sysid_evo.cli.progress import Bars
    from sysid_evo.errors import LinkLost
    from sysid_evo.evolution import Champion
    from sysid_evo.registry import make_controller, make_task
    from sysid_evo.store import load_champion

    if watching is not None:
        page_server()  # what it lacks is said before anything runs
    machine = find_robot(robot)
    if is_stored(controller):
        champion = load_champion(controller)
        folder = folder or owner_of(Path(controller))
    else:
        champion = Champion.hand_written(controller, task, machine.system)
    champion.check_system(machine.system)
    if machine.stepped:
        return run_stepped(champion, machine, trials=trials, folder=folder, seed=seed, watching=watching, keep=keep)
    if watching is not None:
        machine = in_real_time(machine)
    if seed is None:
        seed = seed_of_run(folder) if folder else champion.seed
    column, title = column_of(machine), f"drive {champion.name} on {machine.name}"
    goal, law = make_task(champion.task), make_controller(champion.controller)
    check_driving(machine, goal, law, champion.parameters[None])
    with ExitStack() as stack:
        bars, stops = stack.enter_context(Bars()), stack.enter_context(Stops())
        told = None
        if watching is not None:
            panel = ControllerPanel(machine.name, goal.bind(machine.system), champion.name)
            stack.enter_context(watching.shown(panel, stops))

            def told(series: TrialSeries) -> None:
                panel.show(moment_of(series))

        runner = RobotRunner(
            machine,
            tracker_frame=tracker_origin,
            seed=seed,
            listeners=listeners,
            stops=stops,
            progress=bars.advance,
            told=told,
        )
        bars.begin(title)
        try:
            rollouts, report = runner.drive(
                law,
                champion.parameters[None],
                goal,
                transfer_seeds(seed, trials),
            )
        except LinkLost as error:
            bars.end(title, str(error))
            return code_of_loop(Reason.LINK_LOST)
        measured = Measured(
            champion,
            cell_of(champion, column, rollouts, goal, traces=TRACES),
            on_robot=True,
            physical=machine.physical,
        )
        bars.end(title, report.sentence if report.reason.is_fault else None)
    out.print(f"{champion.name} on {column}", style="bold", highlight=False, markup=False)
    out.print(trials_table(measured, rollouts))
    out.print(punctuality(report), highlight=False)
    if folder is not None and not measured.cell.failed:
        append(folder, measured)
    return code_of_loop(report.reason)


def is_stored(controller: str) -> bool:
    """Whether ``controller`` is a file, not the spec of a controller."""
    from sysid_evo.store import is_stored as is_artefact

    return is_artefact(controller, "controller")


def run_stepped(
    champion: Champion,
    machine: Robot,
    *,
    trials: int,
    folder: Path | None,
    seed: int | None,
    watching: Watching | None = None,
    keep: Path | None = None,
) -> int:
    """Run a controller on a robot that steps when it is told to, as an environment, and return the exit code.

    With ``watching`` the trials are then played back on a page. ``keep`` is a folder for their data set.
    """
    from evaluation.transfer import Measured, cell_of, transfer_seeds
    from sysid_evo.data import Dataset
    from sysid_evo.registry import make_controller, make_task

    runner, task = machine.runner(), make_task(champion.task)
    assert runner is not None
    seeds = transfer_seeds(seed if seed is not None else seed_of_run(folder) if folder else champion.seed, trials)
    rollouts = runner.run(make_controller(champion.controller), champion.parameters[None], task, seeds, record=True)
    cell = cell_of(champion, f"{machine.name} driven", rollouts, task, traces=TRACES)
    measured = Measured(champion, cell, on_robot=True, physical=False)
    out.print(f"{champion.name} on {machine.name}", style="bold", highlight=False, markup=False)
    out.print(trials_table(measured, rollouts))
    if folder is not None:
        append(folder, measured)
    if keep is not None:
        named = [replace(one, name=f"trial-{number}") for number, one in enumerate(rollouts.trajectories, 1)]
        Dataset(machine.system, tuple(named)).save(keep)
        out.print(f"data set stored in {keep}", highlight=False, markup=False, soft_wrap=True)
    return 0 if watching is None else play_back(champion, machine, seeds, rollouts, watching)


def play_back(champion: Champion, machine: Robot, seeds: Seeds, rollouts: Rollouts, watching: Watching) -> int:
    """Show trials that were simulated on a page, as fast as they went or faster, and return the exit code."""
    from hardware.driving.controller_panel import ControllerPanel, pace, play
    from hardware.loop.stops import Stops
    from sysid_evo.registry import make_task

    task = make_task(champion.task).bind(machine.system)
    panel = ControllerPanel(machine.name, task, champion.name, faster=pace(task))
    with Stops() as stops, watching.shown(panel, stops):
        play(panel, task, seeds, rollouts.trajectories, rollouts.fitness[0], stops=stops)
    return 0 if stops.reason is None else code_of_loop(stops.reason)


def seed_of_run(run: Path | None) -> int:
    """Return the seed of the experiment in a run folder, 0 if there is none: everybody meets the same trials."""
    from evaluation.comparison import FILE, Experiment

    if run is None or not (run / FILE).is_file():
        return 0
    return Experiment.of(Experiment.read(run)).seed


def column_of(robot: Robot) -> str:
    """Return the name of a driven robot's column: an emulated one may have one of its own from `compare`."""
    return robot.name if robot.dynamics is None else f"{robot.name} driven"


def owner_of(controller: Path) -> Path | None:
    """Return the run folder that a controller's file lies in, if it does."""
    folder = controller.resolve().parent
    return folder.parent if folder.name == "controllers" else None


def append(folder: Path, *measured: Measured) -> None:
    """Store cells in a run, and make its report again if it has one: of robots, and of people on anything."""
    from evaluation.comparison import FILE
    from evaluation.transfer import save_measured
    from sysid_evo.cli.reporting import report_again

    for item in measured:
        save_measured(folder, item)
    if (folder / FILE).is_file() and report_again(folder) is not None:
        out.print(f"Report: {folder / 'report.html'}", highlight=False, markup=False, soft_wrap=True)
    else:
        tell(f"stored in {folder}, which has no report (compare makes one)")


def trials_table(measured: Measured, rollouts: Rollouts) -> Table:
    """Return the fitness of each trial, mean and standard deviation, and what is missing."""
    from rich.table import Table

    cell = measured.cell
    table = Table(box=None, pad_edge=False)
    table.add_column("trial", justify="right")
    table.add_column(cell.unit or "fitness", justify="right")
    table.add_column("steps", justify="right")
    for trial, (fitness, steps) in enumerate(zip(cell.fitness, rollouts.survived[0], strict=False)):
        table.add_row(str(trial + 1), f"{fitness:g}", str(steps))
    for trial, why in enumerate(cell.missing, cell.trials + 1):
        table.add_row(str(trial), "missing", why)
    if cell.trials:
        table.add_row("mean", f"{cell.mean:.2f}", "", style="bold")
    if cell.trials > 1:
        table.add_row("standard deviation", f"{cell.std:.2f}", "")
    return table


def punctuality(report: LoopReport) -> str:
    """Return a sentence on how punctual the loop was."""
    import numpy as np

    if not report.ticks:
        return f"No command was sent: {report.sentence}."
    median, high = np.percentile(report.lateness, (50, 99))
    gap = report.gaps.max() if len(report.gaps) else 0.0
    return (
        f"{report.ticks} commands; late by {1e3 * median:.1f} ms (median), {1e3 * high:.1f} ms (99 %); longest gap "
        f"{1e3 * gap:.0f} ms; {report.skipped} left out, {report.stale} neutral for want of a pose."
    )
