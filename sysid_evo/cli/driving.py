"""`sysid-evo drive`: a robot, emulated or real, or a model, driven by a person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sysid_evo.cli.console import err, out
from sysid_evo.cli.options import Plugins, Seed, latest_run_folder, load_plugins

if TYPE_CHECKING:
    from hardware.driving.session import HandTrial
    from hardware.robot import Robot
    from sysid_evo.tasks import Task

DEFAULT_ROBOT = "emulated_car"
LOOPBACK = "127.0.0.1"
TASK = "point_to_point"
TRACES = 10  # trials kept in a cell, to be drawn
SERVER = ("starlette", "uvicorn", "websockets")


def drive(
    robot: Annotated[
        str | None, typer.Option(help="A registered robot, NAME:SEED, or a TOML file (default: emulated_car).")
    ] = None,
    model: Annotated[str | None, typer.Option(help="Instead: a fitted model, its family in --run or its file.")] = None,
    run: Annotated[Path | None, typer.Option(help="Run folder with the model, and for --name.")] = None,
    name: Annotated[str | None, typer.Option(help="Row of the run's transfer matrix for the scores.")] = None,
    trials: Annotated[int | None, typer.Option(min=1, help="End after so many whole trials (default: Ctrl-C).")] = None,
    folder: Annotated[Path | None, typer.Option("--out", help="New folder for the recording and its data set.")] = None,
    seed: Seed = 0,
    tracker_frame: Annotated[
        bool, typer.Option("--tracker-frame", help="The arena is around the tracker's origin, not the robot's start.")
    ] = False,
    host: Annotated[str, typer.Option(help="Serve the page at this address; not only this machine may drive.")] = (
        LOOPBACK
    ),
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page (0: a free one).")] = 0,
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in the browser, too.")] = False,
    plugin: Plugins = None,
) -> None:
    """Drive a robot or a model by hand on a local web page: to record, to score, to feel a model.

    Prints the address of the page; whoever knows it may drive. Keys that are released or lost mean
    neutral. The trials are those of the transfer matrix. --out makes a data set of all that is driven,
    --name a row of the run's matrix from the trials that are driven to their end.
    """
    from sysid_evo.registry import make_task

    load_plugins(plugin)
    driven = _choose(robot, model, run, name)
    _check_new(folder)
    task = make_task(TASK)
    ended, code = _session(
        driven.robot,
        task,
        seed=seed,
        trials=trials,
        journals=None if folder is None else folder / "journal",
        tracker_frame=tracker_frame,
        page=(host, port, open_page),
    )
    if folder is not None:
        _store(folder, driven.robot, ended)
    if name is not None and driven.run is not None:
        _append(driven, task, name, ended)
    raise typer.Exit(code)


@dataclass(frozen=True)
class Driven:
    """What is driven, in which column of the matrix of which run."""

    robot: Robot
    column: str
    run: Path | None
    on_robot: bool


def _choose(robot: str | None, model: str | None, run: Path | None, name: str | None) -> Driven:
    from hardware.emulation.modelled_robot import ModelledRobot
    from hardware.emulation.pacing import in_real_time
    from sysid_evo.cli.evolving import find_dynamics
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.registry import make_robot

    if model is not None and robot is not None:
        raise InvalidArgument("drive: expected one of --robot and --model, got both")
    file = model is not None and Path(model).suffix in (".json", ".safetensors")
    wanted = name is not None or run is not None or (model is not None and not file)
    where = latest_run_folder(run) if wanted else None
    if model is None:
        machine = make_robot(robot or DEFAULT_ROBOT)
        return Driven(in_real_time(machine), machine.name, where, on_robot=True)
    stem = Path(model).stem if file else model
    family, dash, number = stem.rpartition("-")
    column = family if dash and number.isdecimal() else stem
    dynamics = find_dynamics(where or Path(), model)
    return Driven(in_real_time(ModelledRobot(column, dynamics)), column, where, on_robot=False)


def _check_new(folder: Path | None) -> None:
    from sysid_evo.errors import InvalidArgument

    if folder is None:
        return
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InvalidArgument(f"--out: expected a new or empty folder, but {folder} holds something already")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidArgument(f"--out: {folder} cannot be made: {error}") from error


def _session(
    robot: Robot,
    task: Task,
    *,
    seed: int,
    trials: int | None,
    journals: Path | None,
    tracker_frame: bool,
    page: tuple[str, int, bool],
) -> tuple[list[HandTrial], int]:
    """Let somebody drive; return the trials and the exit code."""
    import webbrowser
    from functools import partial

    import numpy as np

    from evaluation.transfer import transfer_seeds
    from hardware.driving.instruments import Instruments
    from hardware.driving.keyboard import Keyboard, control_of, key_life
    from hardware.driving.session import HandDriving
    from hardware.loop.report import Reason
    from hardware.loop.stops import Stops
    from hardware.recording.journal import SUFFIX
    from hardware.recording.recorder import Recorder

    system, task = robot.system, task.bind(robot.system)
    control_of(0, system)
    keyboard = Keyboard(life=key_life(system))
    instruments = Instruments(robot, task, keyboard)
    host, port, open_page = page
    server = _page_server()
    ended: list[HandTrial] = []
    whole = 0
    with (
        Stops() as stops,
        server(instruments, keyboard, host=host, port=port, died=partial(stops.request, Reason.THREAD_DIED)) as served,
    ):
        driving = HandDriving(
            robot,
            task,
            keyboard,
            instruments,
            seed_of=lambda index: int(transfer_seeds(seed, index + 1)[index]),
            stops=stops,
            recorder=None
            if journals is None
            else lambda trial: Recorder(journals / f"{trial}{SUFFIX}", system, robot=robot.name),
            origin=np.zeros(system.n_pose) if tracker_frame else None,
        )
        out.print(f"Drive {robot.name} at {served.url}", highlight=False, markup=False, soft_wrap=True)
        if open_page:
            webbrowser.open(served.url)
        for trial in driving.trials():
            ended.append(trial)
            _tell(trial, task.fitness_unit)
            whole += trial.fitness is not None
            if whole == trials:
                return ended, 0
    idle = not ended or ended[-1].trajectory is None or not ended[-1].report.reason.is_fault
    leave = stops.reason is Reason.SIGINT and idle
    return ended, 0 if leave or stops.reason is None else stops.reason.exit_code
