"""Robots list, robots check, record, drive: anything that drives a robot."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sysid_evo.cli.console import ROBOT, code_of_loop, err, out
from sysid_evo.cli.options import Json, Plugins, Seed, Task, check_new_folder, load_plugins
from sysid_evo.cli.recordings import _tell as _recordings_tell
from sysid_evo.cli.recordings import episode_table

if TYPE_CHECKING:
    from rich.table import Table

    from evaluation.transfer import MeasuredResult
    from hardware.connection import GateLimits, Listener
    from hardware.driving.hand_driving import HandTrial
    from hardware.driving.server import PageAddress
    from hardware.robot import Robot
    from sysid_evo.engine.results import Rollouts
    from sysid_evo.evolution.champion import Champion
    from sysid_evo.system import System


app = typer.Typer(help="Robots, physical and emulated.", no_args_is_help=True)


@app.command("list")
def list_robots(plugin: Plugins = None, as_json: Json = False) -> None:
    """List every robot driver that can be loaded; a TOML file with `driver = "NAME"` describes a robot of your own."""
    from rich.table import Table

    from sysid_evo.registry.registry import robots

    load_plugins(plugin)
    rows = []
    for name, factory in robots.load_all():
        summary = (factory.__doc__ or "").strip().splitlines() or [""]
        rows.append({"name": name, "summary": summary[0]})
    if as_json:
        out.print_json(json.dumps(rows))
        return
    table = Table(box=None, pad_edge=False)
    table.add_column("robot", no_wrap=True)
    table.add_column("what it is")
    for row in rows:
        table.add_row(row["name"], row["summary"])
    out.print(table)


@app.command("check")
def check_robot(
    robot: Annotated[str, typer.Argument(help="Robot, NAME(parameter=value, ...), or a TOML file.")],
    seconds: Annotated[float, typer.Option(min=0.5, help="How long to look.")] = 3.0,
    plugin: Plugins = None,
    as_json: Json = False,
) -> None:
    """Connect to a robot and look at link, tracker and loop, without moving it.

    Of one that has no pose, such as equations of your own or an environment, sensors and answers are looked at.
    Exit code 4 if something is not as it should be.
    """
    from rich.text import Text

    from hardware.robot import find_robot
    from hardware.run_report import Stops

    load_plugins(plugin)
    machine = find_robot(robot)
    with Stops() as stops:
        findings = machine.look_at(seconds=seconds, stops=stops)
    if as_json:
        out.print_json(json.dumps([asdict(finding) for finding in findings]))
    else:
        for finding in findings:
            word = ("ok    ", "green") if finding.ok else ("wrong ", "red")
            out.print(Text.assemble(word, (f"{finding.what}: ", "bold"), finding.sentence))
    if stops.reason is not None:
        err.print(stops.reason.sentence)
        raise typer.Exit(code_of_loop(stops.reason))
    if not all(finding.ok for finding in findings):
        raise typer.Exit(ROBOT)


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
    page: PageAddress | None = None,
    keep: Path | None = None,
) -> int:
    """Run ``controller``, the file of an evolved one or the spec of one written by hand, and return the exit code.

    An evolved one has its own task, one written by hand does ``task``.
    The trials are those of the transfer matrix, from the first on. The result becomes a cell of the run
    in ``folder``, or of the one that the file belongs to, whose report is then made again. ``page`` is where it is
    shown. ``keep`` is a folder for the data set of the trials of a robot that steps when it is told to.
    """
    from evaluation.run_folder import owner_of, seed_of_run
    from evaluation.transfer import MeasuredResult, cell_of, transfer_seeds
    from hardware.driving.controller_driving import shown_live
    from hardware.driving.server import check_page
    from hardware.driving.trials import RobotRunner
    from hardware.emulation.simulated_robot import in_real_time
    from hardware.preflight import check_driving
    from hardware.robot import find_robot
    from hardware.run_report import Reason, Stops
    from sysid_evo.cli.experiments import append
    from sysid_evo.cli.progress import Bars
    from sysid_evo.controllers.controller import make_controller
    from sysid_evo.errors import LinkLost
    from sysid_evo.evolution.champion import Champion, load_champion
    from sysid_evo.tasks.task import make_task

    if page is not None:
        check_page()  # what it lacks is said before anything runs
    machine = find_robot(robot)
    if is_stored(controller):
        champion = load_champion(controller)
        folder = folder or owner_of(Path(controller))
    else:
        champion = Champion.hand_written(controller, task, machine.system)
    champion.check_system(machine.system)
    if machine.stepped:
        return run_stepped(champion, machine, trials=trials, folder=folder, seed=seed, page=page, keep=keep)
    if page is not None:
        machine = in_real_time(machine)
    if seed is None:
        seed = seed_of_run(folder) if folder else champion.seed
    column, title = column_of(machine), f"drive {champion.name} on {machine.name}"
    goal, law = make_task(champion.task), make_controller(champion.controller)
    check_driving(machine, goal, law, champion.parameters[None])
    with ExitStack() as stack:
        bars, stops = stack.enter_context(Bars()), stack.enter_context(Stops())
        told = None
        if page is not None:
            told = stack.enter_context(shown_live(machine, goal, champion.name, page, stops=stops, announce=_watch_at))
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
        measured = MeasuredResult(
            champion,
            cell_of(champion, column, rollouts, goal, traces=TRACES),
            on_robot=True,
            physical=machine.physical,
        )
        bars.end(title, report.sentence if report.reason.is_fault else None)
    out.print(f"{champion.name} on {column}", style="bold", highlight=False, markup=False)
    out.print(trials_table(measured, rollouts))
    out.print(report.punctuality, highlight=False)
    if folder is not None and not measured.cell.failed:
        append(folder, measured)
    return code_of_loop(report.reason)


def is_stored(controller: str) -> bool:
    """Whether ``controller`` is a file, not the spec of a controller."""
    from sysid_evo.artefacts import is_stored as is_artefact

    return is_artefact(controller, "controller")


def run_stepped(
    champion: Champion,
    machine: Robot,
    *,
    trials: int,
    folder: Path | None,
    seed: int | None,
    page: PageAddress | None = None,
    keep: Path | None = None,
) -> int:
    """Run a controller on a robot that steps when it is told to, as an environment, and return the exit code.

    With a ``page`` the trials are then played back there. ``keep`` is a folder for their data set.
    """
    from evaluation.run_folder import seed_of_run
    from evaluation.transfer import MeasuredResult, cell_of, transfer_seeds
    from hardware.driving.controller_driving import play_back
    from sysid_evo.cli.experiments import append
    from sysid_evo.controllers.controller import make_controller
    from sysid_evo.data.dataset import Dataset
    from sysid_evo.tasks.task import make_task

    runner, task = machine.runner(), make_task(champion.task)
    assert runner is not None
    seeds = transfer_seeds(seed if seed is not None else seed_of_run(folder) if folder else champion.seed, trials)
    rollouts = runner.run(make_controller(champion.controller), champion.parameters[None], task, seeds, record=True)
    cell = cell_of(champion, f"{machine.name} driven", rollouts, task, traces=TRACES)
    measured = MeasuredResult(champion, cell, on_robot=True, physical=False)
    out.print(f"{champion.name} on {machine.name}", style="bold", highlight=False, markup=False)
    out.print(trials_table(measured, rollouts))
    if folder is not None:
        append(folder, measured)
    if keep is not None:
        named = [replace(one, name=f"trial-{number}") for number, one in enumerate(rollouts.trajectories, 1)]
        Dataset(machine.system, tuple(named)).save(keep)
        out.print(f"data set stored in {keep}", highlight=False, markup=False, soft_wrap=True)
    stopped = None if page is None else play_back(champion, machine, seeds, rollouts, page, announce=_watch_at)
    return 0 if stopped is None else code_of_loop(stopped)


def _watch_at(url: str) -> None:
    out.print(f"Watch it at {url}", highlight=False, markup=False, soft_wrap=True)


def column_of(robot: Robot) -> str:
    """Return the name of a driven robot's column: an emulated one may have one of its own from `compare`."""
    return robot.name if robot.dynamics is None else f"{robot.name} driven"


def trials_table(measured: MeasuredResult, rollouts: Rollouts) -> Table:
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
    from hardware.driving.server import PageAddress
    from sysid_evo.errors import InvalidArgument

    load_plugins(plugin)
    page = PageAddress(host, port, open_page)
    if folder is not None:
        check_new_folder(folder)
    if controller is not None:
        if model is not None or name is not None or (task is not None and is_stored(controller)):
            raise InvalidArgument(
                "drive: --controller drives a robot and has a row, and one that was evolved a task; leave out "
                "--model, --name and --task"
            )
        shown = page if watch or open_page else None
        code = _controlled(
            controller, robot or DEFAULT_ROBOT, task or DEFAULT_TASK, trials, run, seed, tracker_origin, folder, shown
        )
        raise typer.Exit(code)
    driven = _choose(robot, model, run, name, task or DEFAULT_TASK)
    ended, code = _by_hand(driven, page, trials, folder, seed, tracker_origin)
    if folder is not None:
        _store(folder, driven.robot.system, [(trial.name, trial.limits) for trial in ended])
    if name is not None and driven.run is not None:
        append_row(driven, name, ended)
    raise typer.Exit(code)


def _choose(robot: str | None, model: str | None, run: Path | None, name: str | None, task: str) -> Driven:
    from evaluation.members import dynamics_of, find_column
    from evaluation.run_folder import latest_run_folder
    from hardware.emulation.simulated_robot import in_real_time
    from hardware.emulation.tracked_robots import ModelledRobot
    from hardware.robot import find_robot
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.plan.store import Store

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
    from hardware.recording.journal import JOURNALS
    from hardware.recording.record import logs_of, prepared, save_raw
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
    page: PageAddress | None,
) -> int:
    from hardware.recording.journal import recorder_of
    from hardware.robot import find_robot

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
            page=page,
            keep=folder if machine.stepped else None,
        )
    finally:
        if recorder is not None:
            recorder.close()
    if folder is not None and not machine.stepped:
        _store(folder, machine.system, [(CONTROLLED, None)])
    return code


@dataclass(frozen=True)
class Driven:
    """What is driven, in which column of the matrix of which run."""

    robot: Robot
    column: str
    run: Path | None
    on_robot: bool
    task: str = "point_to_point"


def _by_hand(
    driven: Driven, page: PageAddress, trials: int | None, folder: Path | None, seed: int | None, tracker_origin: bool
) -> tuple[list[HandTrial], int]:
    """Let somebody drive the seeds that controllers get, too; return the trials and the exit code."""
    import numpy as np

    from evaluation.run_folder import seed_of_run
    from evaluation.transfer import transfer_seeds
    from hardware.driving.hand_driving import check_driving_by_hand, driven_by_hand
    from hardware.recording.journal import Recorder, recorder_of
    from hardware.run_report import Reason, Stops
    from sysid_evo.errors import LinkLost
    from sysid_evo.tasks.task import make_task

    robot, first = driven.robot, seed if seed is not None else seed_of_run(driven.run)
    task = make_task(driven.task)
    check_driving_by_hand(robot, task)
    task = task.bind(robot.system)
    recorders: list[Recorder] = []
    ended: list[HandTrial] = []

    def recorder(name: str, limits: GateLimits) -> Recorder:
        assert folder is not None
        recorders.append(recorder_of(folder, robot, name, limits))
        return recorders[-1]

    def announce(url: str) -> None:
        out.print(f"Drive {robot.name} at {url}", highlight=False, markup=False, soft_wrap=True)

    with (
        Stops() as stops,
        driven_by_hand(
            robot,
            task,
            page,
            seed_of=lambda index: int(transfer_seeds(first, index + 1)[index]),
            stops=stops,
            announce=announce,
            recorder=None if folder is None else recorder,
            origin=np.zeros(robot.system.n_pose) if tracker_origin else None,
        ) as offered,
    ):
        try:
            for trial in offered:
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


def _tell(trial: HandTrial, unit: str) -> None:
    if trial.fitness is not None:
        out.print(f"trial {trial.number}: {trial.fitness:g} {unit}", highlight=False)
    elif trial.report.reason.is_fault:
        err.print(f"trial {trial.number}: {trial.report.sentence}", highlight=False, markup=False, soft_wrap=True)
    elif trial.trajectory is not None:
        err.print(f"trial {trial.number}: given up after {trial.trajectory.duration:.1f} s", highlight=False)


def append_row(driven: Driven, name: str, trials: Sequence[HandTrial]) -> None:
    """Add the trials that were driven to their end to the run's matrix, as the row ``name``."""
    import numpy as np

    from evaluation.transfer import Cell, MeasuredResult, Trace, person
    from sysid_evo.cli.experiments import append
    from sysid_evo.tasks.task import make_task

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
    append(driven.run, MeasuredResult(row, cell, on_robot=driven.on_robot, physical=physical))


def record(
    folder: Annotated[Path, typer.Option("--out", help="Folder for the data set.", show_default=False)],
    robot: Annotated[
        str, typer.Option(help="Registered robot, NAME(parameter=value, ...), or a TOML file.")
    ] = "emulated_car",
    seed: Seed = None,
    minutes: Annotated[float, typer.Option(min=0.1, help="Length of the excitation.")] = 6.0,
    manoeuvre: Annotated[
        str | None, typer.Option(help="Instead, one that measures: step, coast_down or circle.")
    ] = None,
    plugin: Plugins = None,
) -> None:
    """Drive a robot through manoeuvres; store the journals of the runs (`journal/`), what the tracker saw
    (`raw/`) and the data set made of it.

    Every frame and command is in the journal as soon as it happens; Ctrl-C, a lost tracker or a lost
    link end the recording in neutral, and what was recorded until then is kept and prepared.
    """
    from hardware.preflight import check_recording
    from hardware.recording.manoeuvres import measuring
    from hardware.recording.record import save_raw
    from hardware.robot import find_robot
    from hardware.run_report import Stops
    from sysid_evo.cli.progress import Bars
    from sysid_evo.data.response import measured

    load_plugins(plugin)
    check_new_folder(folder)
    machine = find_robot(robot)
    journal = folder / "journal"
    check_recording(machine, journal, duration=60.0 * minutes)
    manoeuvres = None if manoeuvre is None else measuring(machine.system, manoeuvre)
    title = f"record {robot}"
    with Bars() as bars, Stops() as stops:
        bars.begin(title)
        drive = (
            partial(machine.record, duration=60.0 * minutes)
            if manoeuvres is None
            else partial(machine.record_manoeuvres, manoeuvres)
        )
        recorded = drive(seed=seed or 0, folder=journal, stops=stops, progress=bars.advance)
        ended = recorded.report.sentence if recorded.report.reason.is_fault else None
        bars.end(title, ended)
    dataset = recorded.dataset
    for log in recorded.logs:
        save_raw(log, dataset.system, folder / "raw" / f"{log.name}.csv")
    dataset.save(folder)
    _recordings_tell(dataset.notes, ())
    out.print(episode_table(dataset))
    for one in measured(dataset):
        out.print(str(one), highlight=False, markup=False, soft_wrap=True)
    out.print(f"data set stored in {folder}", highlight=False, markup=False, soft_wrap=True)
    if ended is not None:
        err.print(f"the recording was cut short: {ended}", highlight=False, markup=False, soft_wrap=True)
        raise typer.Exit(code_of_loop(recorded.report.reason))
