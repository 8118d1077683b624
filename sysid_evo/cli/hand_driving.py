"""A session of driving by hand: the page, the trials, and the row that they become."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sysid_evo.cli.console import err, out
from sysid_evo.cli.exits import code_of_loop

if TYPE_CHECKING:
    from hardware.driving.server import PageServer
    from hardware.driving.session import HandTrial
    from hardware.recording.recorder import Recorder
    from hardware.robot import Robot
    from hardware.trackers.gates import GateLimits

JOURNALS = "journal"
TRACES = 10
"""Trials whose trajectories are kept for the plots."""


@dataclass(frozen=True)
class Driven:
    """What is driven, in which column of the matrix of which run."""

    robot: Robot
    column: str
    run: Path | None
    on_robot: bool
    task: str = "point_to_point"


def _seed(seed: int | None, run: Path | None) -> int:
    """Return the seed of the trials: controllers and people meet the same."""
    from sysid_evo.cli.achieving import seed_of_run

    return seed if seed is not None else seed_of_run(run)


def drive_by_hand(
    driven: Driven,
    seed: int | None,
    trials: int | None,
    folder: Path | None,
    tracker_origin: bool,
    *,
    page: tuple[str, int, bool],
) -> tuple[list[HandTrial], int]:
    """Let somebody drive; return the trials and the exit code."""
    import webbrowser

    import numpy as np

    from evaluation.transfer import transfer_seeds
    from hardware.driving.instruments import Instruments
    from hardware.driving.keyboard import Keyboard, key_life
    from hardware.driving.session import HandDriving
    from hardware.loop.report import Reason
    from hardware.loop.stops import Stops
    from hardware.preflight import check_driving_by_hand
    from sysid_evo.errors import LinkLost
    from sysid_evo.registry import make_task

    robot, system, first = driven.robot, driven.robot.system, _seed(seed, driven.run)
    task = make_task(driven.task)
    check_driving_by_hand(robot, task)
    task = task.bind(system)
    keyboard = Keyboard(life=key_life(system))
    instruments = Instruments(robot, task, keyboard)
    host, port, open_page = page
    stops = Stops()
    recorders: list[Recorder] = []
    ended: list[HandTrial] = []

    def recorder(name: str, limits: GateLimits) -> Recorder:
        assert folder is not None
        recorders.append(recorder_of(folder, robot, name, limits))
        return recorders[-1]

    server = page_server()
    with (
        stops,
        server(
            instruments, keyboard, host=host, port=port, died=lambda why: stops.request(Reason.THREAD_DIED, why)
        ) as served,
    ):
        driving = HandDriving(
            robot,
            task,
            keyboard,
            instruments,
            seed_of=lambda index: int(transfer_seeds(first, index + 1)[index]),
            stops=stops,
            recorder=None if folder is None else recorder,
            origin=np.zeros(system.n_pose) if tracker_origin else None,
        )
        out.print(f"Drive {robot.name} at {served.url}", highlight=False, markup=False, soft_wrap=True)
        if open_page:
            webbrowser.open(served.url)
        try:
            for trial in driving.trials():
                ended.append(trial)
                _tell(trial, task.fitness_unit)
                if sum(each.fitness is not None for each in ended) == trials:
                    stops.request(Reason.SAMPLES)
        except LinkLost as error:
            err.print(f"{robot.name}: {error}", highlight=False, markup=False, soft_wrap=True)
            stops.request(Reason.LINK_LOST)
    for made in recorders:
        if made.problem is not None:
            err.print(f"{made.lost} records are lost: {made.problem}", highlight=False, markup=False, soft_wrap=True)
    reason = stops.reason or Reason.PILOT
    under_way = bool(ended) and ended[-1].report.reason.is_fault and ended[-1].trajectory is not None
    return ended, 0 if reason is Reason.SIGINT and not under_way else code_of_loop(reason)


def page_server() -> type[PageServer]:
    """Return the server of the page. Raises `MissingExtra`."""
    from sysid_evo.extras import missing_extra

    try:
        from hardware.driving.server import PageServer
    except ModuleNotFoundError as error:
        raise missing_extra("driving by hand", error.name) from error
    return PageServer


def _tell(trial: HandTrial, unit: str) -> None:
    if trial.fitness is not None:
        out.print(f"trial {trial.number}: {trial.fitness:g} {unit}", highlight=False)
    elif trial.report.reason.is_fault:
        err.print(f"trial {trial.number}: {trial.report.sentence}", highlight=False, markup=False, soft_wrap=True)
    elif trial.trajectory is not None:
        err.print(f"trial {trial.number}: given up after {trial.trajectory.duration:.1f} s", highlight=False)


def recorder_of(folder: Path, robot: Robot, name: str, limits: GateLimits | None = None) -> Recorder:
    """Return the recorder of the trial ``name``; ``limits`` are those of the gate that its frames pass."""
    from hardware.recording.journal import SUFFIX
    from hardware.recording.recorder import Recorder

    return Recorder(folder / JOURNALS / f"{name}{SUFFIX}", robot.system, robot=robot.name, limits=limits)


def append_row(driven: Driven, name: str, trials: Sequence[HandTrial]) -> None:
    """Add the trials that were driven to their end to the run's matrix, as the row ``name``."""
    import numpy as np

    from evaluation.transfer import Cell, Measured, Trace, person
    from sysid_evo.cli.achieving import append
    from sysid_evo.registry import make_task

    assert driven.run is not None
    task = make_task(driven.task)
    whole = [trial for trial in trials if trial.fitness is not None]
    if not whole:
        err.print(f"no trial was driven to its end, so {name} gets no row", highlight=False, markup=False)
        return
    traces = []
    for trial in whole[:TRACES]:
        if trial.trajectory is not None and trial.fitness is not None:
            scene = task.scene(trial.task_state, 0)
            traces.append(Trace(trial.trajectory, trial.fitness, scene.markers, scene.radius))
    cell = Cell(
        champion=name,
        column=driven.column,
        fitness=np.array([trial.fitness for trial in whole]),
        unit=task.fitness_unit,
        engine="by hand",
        traces=tuple(traces),
    )
    physical = driven.on_robot and driven.robot.physical
    row = person(name, task=driven.task, system=driven.robot.system)
    append(driven.run, Measured(row, cell, on_robot=driven.on_robot, physical=physical))
