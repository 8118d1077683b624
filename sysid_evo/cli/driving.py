"""`sysid-evo drive`: a robot, emulated or real, or a model, driven by a person."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sysid_evo.cli.console import err, out
from sysid_evo.cli.options import Plugins, Task, check_new_folder, latest_run_folder, load_plugins

if TYPE_CHECKING:
    from hardware.trackers.gates import GateLimits
    from sysid_evo.cli.hand_driving import Driven
    from sysid_evo.cli.watching import Watching
    from sysid_evo.system import System

DEFAULT_ROBOT = "emulated_car"
DEFAULT_TASK = "point_to_point"
CONTROLLED = "trials"
CONTROLLER_TRIALS = 10


def drive(
    robot: Annotated[
        str | None, typer.Option(help="Robot, NAME(parameter=value, ...), or a TOML file (default: emulated_car).")
    ] = None,
    model: Annotated[str | None, typer.Option(help="Instead: a fitted model, its family in --run or its file.")] = None,
    controller: Annotated[
        str | None,
        typer.Option(help="To drive instead: the file of an evolved controller, or one written by hand, NAME(...)."),
    ] = None,
    task: Task = None,
    run: Annotated[Path | None, typer.Option(help="Run folder whose transfer matrix gets the scores.")] = None,
    name: Annotated[str | None, typer.Option(help="Row of the matrix for who drives by hand, such as human.")] = None,
    trials: Annotated[
        int | None, typer.Option(min=1, help="Trials driven to their end (by hand: until Ctrl-C; controllers: 10).")
    ] = None,
    folder: Annotated[Path | None, typer.Option("--out", help="New folder for the recording and its data set.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the trials (default: the run's, else 0).")] = None,
    tracker_origin: Annotated[
        bool, typer.Option("--tracker-origin", help="The arena lies around the tracker's origin, not around the start.")
    ] = False,
    host: Annotated[str, typer.Option(help="Serve the page at this address.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page (0: a free one).")] = 0,
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in the browser, too.")] = False,
    watch: Annotated[
        bool, typer.Option("--watch", help="With --controller: show on the page how it drives, in real time.")
    ] = False,
    plugin: Plugins = None,
) -> None:
    """Drive a robot or a model, by hand on a local web page or with --controller, at the task of the matrix.

    By hand: prints the address of the page; whoever knows it may drive. Keys that are released or lost
    mean neutral. --out makes a data set of what is driven; --name adds the trials that are driven to
    their end to the run's transfer matrix. --controller adds what it achieves on the robot; with --watch
    the page shows it.

    The exit code is 0 when driving ended as it should, 4 when link, tracker or robot ended it (a sentence
    says which and why), and 129, 130, 143 for SIGHUP, SIGINT, SIGTERM while a trial was driven.
    """
    from sysid_evo.cli.achieving import is_stored
    from sysid_evo.cli.hand_driving import append_row, drive_by_hand
    from sysid_evo.cli.watching import Watching
    from sysid_evo.errors import InvalidArgument

    load_plugins(plugin)
    if folder is not None:
        check_new_folder(folder)
    if controller is not None:
        if model is not None or name is not None or (task is not None and is_stored(controller)):
            raise InvalidArgument(
                "drive: --controller drives a robot and has a row, and one that was evolved a task; leave out "
                "--model, --name and --task"
            )
        shown = Watching(host, port, open_page) if watch or open_page else None
        code = _controlled(
            controller, robot or DEFAULT_ROBOT, task or DEFAULT_TASK, trials, run, seed, tracker_origin, folder, shown
        )
        raise typer.Exit(code)
    driven = _choose(robot, model, run, name, task or DEFAULT_TASK)
    ended, code = drive_by_hand(driven, seed, trials, folder, tracker_origin, page=(host, port, open_page))
    if folder is not None:
        _store(folder, driven.robot.system, [(trial.name, trial.limits) for trial in ended])
    if name is not None and driven.run is not None:
        append_row(driven, name, ended)
    raise typer.Exit(code)


def _choose(robot: str | None, model: str | None, run: Path | None, name: str | None, task: str) -> Driven:
    from hardware.emulation.modelled_robot import ModelledRobot
    from hardware.emulation.pacing import in_real_time
    from hardware.robot import find_robot
    from sysid_evo.cli.achieving import column_of
    from sysid_evo.cli.columns import dynamics_of, find_column
    from sysid_evo.cli.hand_driving import Driven
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.plan import Store

    if model is not None and robot is not None:
        raise InvalidArgument("drive: expected one of --robot and --model, got both")
    file = model is not None and Path(model).suffix in (".json", ".safetensors")
    wanted = run is not None or name is not None or (model is not None and not file)
    where = latest_run_folder(run) if wanted else None
    if model is None:
        machine = find_robot(robot or DEFAULT_ROBOT)
        return Driven(in_real_time(machine), column_of(machine), where, on_robot=True, task=task)
    store = Store(where or Path())
    column = find_column(store, model)
    modelled = ModelledRobot(column.label, dynamics_of(store, column))
    return Driven(in_real_time(modelled), column.label, where, on_robot=False, task=task)


def _store(folder: Path, system: System, runs: Sequence[tuple[str, GateLimits | None]]) -> None:
    """Make a data set of the journals in ``folder``, as `sysid-evo record` does."""
    from hardware.recording.scripted import logs_of, prepared, save_raw
    from sysid_evo.cli.advice_tables import episode_table
    from sysid_evo.cli.hand_driving import JOURNALS
    from sysid_evo.errors import InvalidData

    logs = [log for name, limits in runs for log in logs_of(folder / JOURNALS, [name], limits)]
    if not logs:
        err.print(f"nothing was driven, so there is no data set in {folder}", highlight=False, markup=False)
        return
    for log in logs:
        save_raw(log, system, folder / "raw" / f"{log.name}.csv")
    try:
        dataset = prepared(logs, system)
    except InvalidData as error:
        err.print(f"{error}", highlight=False, markup=False, soft_wrap=True)
        return
    dataset.save(folder)
    for note in dataset.notes:
        err.print(f"note: {note}", highlight=False, markup=False, soft_wrap=True)
    out.print(episode_table(dataset))
    out.print(f"data set stored in {folder}", highlight=False, markup=False, soft_wrap=True)


def _controlled(
    controller: str,
    robot: str,
    task: str,
    trials: int | None,
    run: Path | None,
    seed: int | None,
    tracker_origin: bool,
    folder: Path | None,
    watching: Watching | None,
) -> int:
    from hardware.robot import find_robot
    from sysid_evo.cli.achieving import drive_controller
    from sysid_evo.cli.hand_driving import recorder_of

    machine = find_robot(robot)
    recorder = None if folder is None or machine.stepped else recorder_of(folder, machine, CONTROLLED)
    try:
        code = drive_controller(
            controller,
            robot,
            task=task,
            trials=trials or CONTROLLER_TRIALS,
            folder=run,
            seed=seed,
            tracker_origin=tracker_origin,
            listeners=() if recorder is None else (recorder,),
            watching=watching,
            keep=folder if machine.stepped else None,
        )
    finally:
        if recorder is not None:
            recorder.close()
    if folder is not None and not machine.stepped:
        _store(folder, machine.system, [(CONTROLLED, None)])
    return code
