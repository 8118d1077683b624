"""Robots list, robots check, record, drive: anything that drives a robot."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.table import Table
from rich.text import Text

import evaluation
import hardware
import sysid_evo
from evaluation.formatting import by_error
from sysid_evo.artefacts import is_stored_dataset
from sysid_evo.cli.console import ROBOT, err, out, say, table_of, tell
from sysid_evo.cli.experiments import add_measured
from sysid_evo.cli.options import Json, Plugins, Seed, Task, check_new_folder, load_plugins
from sysid_evo.cli.progress import PlanProgress
from sysid_evo.cli.recordings import episode_table, tell_notes
from sysid_evo.data.response import manoeuvre_results
from sysid_evo.errors import InvalidArgument, InvalidData, LinkLost
from sysid_evo.plan.store import Store
from sysid_evo.registry.registry import robots
from sysid_evo.system import System
from sysid_evo.types import Seeds

app = typer.Typer(help="Robots, physical and emulated.", no_args_is_help=True)


@app.command("list")
def list_robots(plugin: Plugins = None, as_json: Json = False) -> None:
    """List every robot driver that can be loaded; a TOML file with `driver = "NAME"` describes a robot of your own."""
    load_plugins(plugin)
    rows = [{"name": name, "summary": robots.summary(name)} for name, _ in robots.load_all()]
    if as_json:
        out.print_json(data=rows)
        return
    table = table_of("robot", "what it is", whole=("robot",))
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
    load_plugins(plugin)
    machine = hardware.find_robot(robot)
    with hardware.StopRequest(machine.answers_within) as stops, _ended_by(stops):
        findings = machine.self_test(seconds=seconds, stop=stops)
    if as_json:
        out.print_json(data=[asdict(finding) for finding in findings])
    else:
        for finding in findings:
            word = ("ok    ", "green") if finding.ok else ("wrong ", "red")
            out.print(Text.assemble(word, (f"{finding.check}: ", "bold"), finding.sentence))
    if stops.reason is not None:
        err.print(stops.reason.sentence)
        raise typer.Exit(stops.reason.exit_code)
    if not all(finding.ok for finding in findings):
        raise typer.Exit(ROBOT)


@contextmanager
def _ended_by(stops: hardware.StopRequest) -> Iterator[None]:
    """End the command with the exit code of the signal after which the robot did not answer any more."""
    try:
        yield
    except LinkLost as error:
        if stops.reason is None:
            raise
        tell(str(error))
        raise typer.Exit(stops.reason.exit_code) from error


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
    load_plugins(plugin)
    check_new_folder(folder)
    machine = hardware.find_robot(robot)
    journal = folder / hardware.JOURNALS
    hardware.check_recording(machine, journal, duration=60.0 * minutes)
    manoeuvres = None if manoeuvre is None else hardware.measuring_manoeuvres(machine.system, manoeuvre)
    title = f"record {robot}"
    with PlanProgress() as bars, hardware.StopRequest(machine.answers_within) as stops, _ended_by(stops):
        bars.begin(title)
        drive = (
            partial(machine.record, duration=60.0 * minutes)
            if manoeuvres is None
            else partial(machine.record_manoeuvres, manoeuvres)
        )
        recorded = drive(seed=seed or 0, folder=journal, stop=stops, progress=bars.advance)
        ended = recorded.report.sentence if recorded.report.reason.is_fault else None
        bars.end(title, ended)
    dataset = recorded.dataset
    for log in recorded.logs:
        hardware.save_raw_log(log, dataset.system, folder / "raw" / f"{log.name}.csv")
    dataset.save(folder)
    tell_notes(dataset.notes)
    out.print(episode_table(dataset))
    for one in manoeuvre_results(dataset):
        say(str(one))
    say(f"data set stored in {folder}")
    if ended is not None:
        tell(f"the recording was cut short: {ended}")
        raise typer.Exit(recorded.report.reason.exit_code)


DEFAULT_ROBOT = "emulated_car"
DEFAULT_TASK = "point_to_point"

CONTROLLER_TRIALS = 10

CONTROLLED = "trials"
"""Name of the journal of a controller's trials."""

TRACES = 10
"""Trials whose trajectories are kept for the plots."""


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
    load_plugins(plugin)
    page = hardware.PageAddress(host, port, open_page)
    if folder is not None:
        check_new_folder(folder)
    if controller is None:
        driven = _choose(robot, model, run, name, task)
        ended, code = drive_by_hand(driven, page, trials, folder, seed, tracker_origin)
        if folder is not None:
            _store(folder, [(trial.name, trial.limits) for trial in ended], driven.robot.system)
        if name is not None and driven.run is not None:
            add_row(driven, driven.run, name, ended)
        raise typer.Exit(code)
    if model is not None:
        words = ["sysid-evo", "transfer", controller, "--on", model, *(["--run", str(run)] if run else [])]
        raise InvalidArgument(f"drive: --controller drives a robot. To run it on a model: {shlex.join(words)}")
    if name is not None:
        raise InvalidArgument("drive: --name is for driving by hand; a controller has a row of its own. Leave it out")
    if task is not None and is_stored_dataset(controller, "controller"):
        raise InvalidArgument(f"drive: {controller} was evolved for a task and drives that one; leave --task out")
    code = drive_controller(
        controller,
        hardware.find_robot(robot or DEFAULT_ROBOT),
        task=task,
        trials=trials or CONTROLLER_TRIALS,
        run=run,
        seed=seed,
        tracker_origin=tracker_origin,
        folder=folder,
        page=page if watch or open_page else None,
    )
    raise typer.Exit(code)


def drive_controller(
    controller: str,
    robot: hardware.Robot,
    *,
    task: str | None,
    trials: int,
    run: Path | None,
    seed: int | None,
    tracker_origin: bool,
    folder: Path | None,
    page: hardware.PageAddress | None,
) -> int:
    """Run ``controller``, the file of an evolved one or the spec of one written by hand, and return the exit code.

    An evolved one has its own task, one written by hand does ``task``. The trials are those of the transfer matrix,
    from the first on. The result becomes a cell of ``run``, or of the run that the file belongs to, whose report is
    then made again. ``folder`` is for the data set of the trials, ``page`` where they are shown.
    """
    if page is not None:
        hardware.check_page()  # what it lacks is said before anything runs
    if is_stored_dataset(controller, "controller"):
        champion = sysid_evo.load_champion(controller)
        run = run or evaluation.run_of_controller(Path(controller))
    else:
        champion = sysid_evo.Champion.baseline(controller, task or robot.usual_task or DEFAULT_TASK, robot.system)
    champion.check_system(robot.system)
    if seed is None:
        seed = evaluation.seed_of_run(run) if run else champion.seed
    seeds = evaluation.transfer_seeds(seed, trials)
    if robot.stepped:
        return _step(champion, robot, seeds, run, folder, page)
    with ExitStack() as stack:
        recorder = None if folder is None else hardware.recorder_of(folder, robot, CONTROLLED)
        if recorder is not None:
            stack.enter_context(recorder)
        code = _loop(champion, robot, seeds, seed, run, tracker_origin, recorder, page)
    if folder is not None:
        _store(folder, [(CONTROLLED, None)], robot.system)
    return code


def _loop(
    champion: sysid_evo.Champion,
    robot: hardware.Robot,
    seeds: Seeds,
    seed: int,
    run: Path | None,
    tracker_origin: bool,
    recorder: hardware.Recorder | None,
    page: hardware.PageAddress | None,
) -> int:
    """Run a controller on a robot in the control loop, and return the exit code."""
    if page is not None:
        robot = hardware.in_real_time(robot)
    column, title = matrix_column(robot), f"drive {champion.name} on {robot.name}"
    task, law = sysid_evo.make_task(champion.task), sysid_evo.make_controller(champion.controller)
    hardware.check_driving(robot, task, law, champion.parameters[None])
    with ExitStack() as stack:
        bars, stops = stack.enter_context(PlanProgress()), stack.enter_context(hardware.StopRequest())
        told = None
        if page is not None:
            shown = hardware.shown_live(robot, task, champion.name, page, stop=stops, announce=_watch_at)
            told = stack.enter_context(shown)
        runner = hardware.RobotRunner(
            robot,
            tracker_frame=tracker_origin,
            seed=seed,
            listeners=() if recorder is None else (recorder,),
            stop=stops,
            progress=bars.advance,
            on_decision=told,
        )
        bars.begin(title)
        try:
            rollouts, report = runner.drive(law, champion.parameters[None], task, seeds)
        except LinkLost as error:
            bars.end(title, str(error))
            return hardware.StopReason.LINK_LOST.exit_code
        cell = evaluation.result_of(champion, column, rollouts, task, traces=TRACES)
        bars.end(title, report.sentence if report.reason.is_fault else None)
    out.print(f"{champion.name} on {column}", style="bold", highlight=False, markup=False)
    out.print(trials_table(cell, rollouts))
    out.print(report.punctuality, highlight=False)
    if run is not None and not cell.failed:
        add_measured(run, evaluation.MeasuredResult(champion, cell, on_robot=True, physical=robot.physical))
    return report.reason.exit_code


def _step(
    champion: sysid_evo.Champion,
    robot: hardware.Robot,
    seeds: Seeds,
    run: Path | None,
    folder: Path | None,
    page: hardware.PageAddress | None,
) -> int:
    """Run a controller on a robot that steps when it is told to, as an environment, and return the exit code.

    With a ``page`` the trials are then played back there.
    """
    runner, task = robot.runner(), sysid_evo.make_task(champion.task)
    assert runner is not None
    law = sysid_evo.make_controller(champion.controller)
    rollouts = runner.bind(law, task)(champion.parameters[None], seeds, record=True)
    cell = evaluation.result_of(champion, f"{robot.name} driven", rollouts, task, traces=TRACES)
    out.print(f"{champion.name} on {robot.name}", style="bold", highlight=False, markup=False)
    out.print(trials_table(cell, rollouts))
    if run is not None:
        add_measured(run, evaluation.MeasuredResult(champion, cell, on_robot=True, physical=False))
    if folder is not None:
        named = [replace(one, name=f"trial-{number}") for number, one in enumerate(rollouts.trajectories, 1)]
        sysid_evo.Dataset(robot.system, tuple(named)).save(folder)
        say(f"data set stored in {folder}")
    if page is None:
        return 0
    stopped = hardware.play_back(champion, robot, seeds, rollouts, page, announce=_watch_at)
    return 0 if stopped is None else stopped.exit_code


def _watch_at(url: str) -> None:
    say(f"Watch it at {url}")


def trials_table(cell: evaluation.Cell, rollouts: sysid_evo.Rollouts) -> Table:
    """Return the fitness of each trial, mean and standard deviation, and what is missing."""
    headings = "trial", cell.unit or "fitness", "steps"
    table = table_of(*headings, numbers=headings)
    for trial, (fitness, steps) in enumerate(zip(cell.fitness, rollouts.survived[0], strict=False)):
        table.add_row(str(trial + 1), f"{fitness:g}", str(steps))
    for trial, why in enumerate(cell.missing, cell.trials + 1):
        table.add_row(str(trial), "missing", why)
    if cell.trials:
        table.add_row("mean", by_error(cell.mean, cell.standard_error), "", style="bold")
    if cell.trials > 1:
        table.add_row("standard deviation", by_error(cell.std, cell.standard_error), "")
    return table


@dataclass(frozen=True)
class DriveTarget:
    """What somebody drives, in which column of the matrix of which run."""

    robot: hardware.Robot
    column: str
    run: Path | None
    on_robot: bool
    task: str = DEFAULT_TASK


def _choose(robot: str | None, model: str | None, run: Path | None, name: str | None, task: str | None) -> DriveTarget:
    file = model is not None and Path(model).suffix in (".json", ".safetensors")
    wanted = run is not None or name is not None or (model is not None and not file)
    where = evaluation.latest_run_folder(run) if wanted else None
    if model is None:
        machine = hardware.find_robot(robot or DEFAULT_ROBOT)
        task = task or machine.usual_task or DEFAULT_TASK
        return DriveTarget(hardware.in_real_time(machine), matrix_column(machine), where, on_robot=True, task=task)
    store = Store(where or Path())
    column = evaluation.find_column(store, model)
    modelled = hardware.ModelRobot(column.label, evaluation.dynamics_of(store, column))
    return DriveTarget(hardware.in_real_time(modelled), column.label, where, on_robot=False, task=task or DEFAULT_TASK)


def matrix_column(robot: hardware.Robot) -> str:
    """Return the name of a driven robot's column: an emulated one may have one of its own from `compare`."""
    return robot.name if robot.dynamics is None else f"{robot.name} driven"


def drive_by_hand(
    driven: DriveTarget,
    page: hardware.PageAddress,
    trials: int | None,
    folder: Path | None,
    seed: int | None,
    tracker_origin: bool,
) -> tuple[list[hardware.HandTrial], int]:
    """Let somebody drive the trials that controllers get, too; return what was driven and the exit code."""
    robot, first = driven.robot, seed if seed is not None else evaluation.seed_of_run(driven.run)
    task = sysid_evo.make_task(driven.task)
    hardware.check_driving_by_hand(robot, task)
    task = task.bind(robot.system)
    recorders: list[hardware.Recorder] = []
    ended: list[hardware.HandTrial] = []

    def recorder(name: str, limits: hardware.GateLimits) -> hardware.Recorder:
        assert folder is not None
        recorders.append(hardware.recorder_of(folder, robot, name, limits))
        return recorders[-1]

    with (
        hardware.StopRequest() as stops,
        hardware.driven_by_hand(
            robot,
            task,
            page,
            seed_of=lambda index: int(evaluation.transfer_seeds(first, index + 1)[index]),
            stop=stops,
            announce=lambda url: say(f"Drive {robot.name} at {url}"),
            recorder=None if folder is None else recorder,
            origin=np.zeros(robot.system.n_pose) if tracker_origin else None,
        ) as offered,
    ):
        try:
            for trial in offered:
                ended.append(trial)
                _tell(trial, task.fitness_unit)
                if sum(each.fitness is not None for each in ended) == trials:
                    stops.request(hardware.StopReason.SAMPLES)
        except LinkLost as error:
            tell(f"{robot.name}: {error}")
            stops.request(hardware.StopReason.LINK_LOST)
    for made in recorders:
        if made.problem is not None:
            tell(f"{made.lost} records are lost: {made.problem}")
    reason = stops.reason or hardware.StopReason.PILOT
    under_way = bool(ended) and ended[-1].report.reason.is_fault and ended[-1].trajectory is not None
    return ended, 0 if reason is hardware.StopReason.SIGINT and not under_way else reason.exit_code


def _tell(trial: hardware.HandTrial, unit: str) -> None:
    if trial.fitness is not None:
        out.print(f"trial {trial.number}: {trial.fitness:g} {unit}", highlight=False)
    elif trial.report.reason.is_fault:
        tell(f"trial {trial.number}: {trial.report.sentence}")
    elif trial.trajectory is not None:
        err.print(f"trial {trial.number}: given up after {trial.trajectory.duration:.1f} s", highlight=False)


def add_row(driven: DriveTarget, run: Path, name: str, trials: Sequence[hardware.HandTrial]) -> None:
    """Add the trials that were driven to their end to the run's matrix, as the row ``name``."""
    whole = [(one.fitness, one.trajectory, one.task_state) for one in trials if one.fitness is not None]
    if not whole:
        err.print(f"no trial was driven to its end, so {name} gets no row", highlight=False, markup=False)
        return
    measured = evaluation.measured_by_person(
        name,
        driven.column,
        whole,
        task=driven.task,
        system=driven.robot.system,
        on_robot=driven.on_robot,
        physical=driven.on_robot and driven.robot.physical,
        traces=TRACES,
    )
    add_measured(run, measured)


def _store(folder: Path, runs: Sequence[tuple[str, hardware.GateLimits | None]], system: System) -> None:
    """Make a data set of the journals in ``folder``, as `sysid-evo record` does."""
    try:
        dataset = hardware.store_journals(folder, runs, system)
    except InvalidData as error:
        tell(str(error))
        return
    if dataset is None:
        err.print(f"nothing was driven, so there is no data set in {folder}", highlight=False, markup=False)
        return
    for note in dataset.notes:
        tell(f"note: {note}")
    out.print(episode_table(dataset))
    say(f"data set stored in {folder}")
