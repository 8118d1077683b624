"""Robots list, robots check, record, drive: commands that drive a robot."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

import evaluation
import hardware
import sysid_evo
import sysid_evo.data
import sysid_evo.plan
from sysid_evo.cli import options
from sysid_evo.cli.console import ROBOT, err, out, print_line, print_status, table_of
from sysid_evo.cli.controllers import SUFFIXES
from sysid_evo.cli.options import argument, check_new_folder, load_plugins, names_of, number, option
from sysid_evo.cli.progress import PlanProgress
from sysid_evo.cli.recordings import episode_table, print_notes
from sysid_evo.cli.runs import add_measured
from sysid_evo.errors import InvalidArgument, InvalidData, LinkLost
from sysid_evo.registry.registry import robots

if TYPE_CHECKING:
    from sysid_evo.system import System
    from sysid_evo.types import Seeds


def list_robots(plugin: options.Plugins = None, as_json: options.Json = False) -> None:
    """List the robot drivers.

    A TOML file with `driver = "NAME"` and the parameters of the driver describes your own robot.
    """
    load_plugins(plugin)
    rows = [{"name": name, "summary": robots.summary(name)} for name, _ in robots.load_all()]
    if as_json:
        out.print_json(data=rows)
        return
    table = table_of("robot", "description", whole=("robot",))
    for row in rows:
        table.add_row(row["name"], row["summary"])
    out.print(table)


def check_robot(
    robot: Annotated[str, argument("SPEC or TOML file of the robot", "ROBOT", values=names_of("robot"))],
    seconds: Annotated[float, option("Seconds to observe", "N", panel="Robot", shown="3",
        parser=number(0.5, float))] = 3.0,
    plugin: options.Plugins = None, as_json: options.Json = False,
) -> None:  # fmt: skip
    """Check link, tracker and loop of a robot without moving it.

    A robot without a pose, such as your own equations or an environment, has its sensors and responses checked. The
    exit code is 4 if a check fails.
    """
    load_plugins(plugin)
    machine = hardware.find_robot(robot)
    with hardware.StopRequest(machine.answers_within) as stops, _ended_by(stops):
        findings = machine.self_test(seconds=seconds, stop=stops)
    if as_json:
        out.print_json(data=[asdict(finding) for finding in findings])
    else:
        for finding in findings:
            line = Table.grid(padding=(0, 1))  # a wrapped sentence continues in the second column
            line.add_column(width=len("wrong"))
            word = Text("ok", "green") if finding.ok else Text("wrong", "red")
            line.add_row(word, Text.assemble((f"{finding.check}: ", "bold"), finding.sentence))
            out.print(line)
    if stops.reason is not None:
        err.print(stops.reason.sentence)
        raise typer.Exit(stops.reason.exit_code)
    if not all(finding.ok for finding in findings):
        raise typer.Exit(ROBOT)


@contextmanager
def _ended_by(stops: hardware.StopRequest) -> Iterator[None]:
    """End the command with the exit code of the signal after which the robot stopped answering."""
    try:
        yield
    except LinkLost as error:
        if stops.reason is None:
            raise
        print_status(str(error))
        raise typer.Exit(stops.reason.exit_code) from error


def record(
    folder: Annotated[Path, option("Folder for the data set", "DIR", "--out")],
    robot: Annotated[str, option("Robot, or its TOML file", "SPEC", panel="Robot", shown="emulated_car",
        values=names_of("robot"))] = "emulated_car",
    minutes: Annotated[float, option("Minutes of excitation", "N", panel="Robot", shown="6",
        parser=number(0.1, float))] = 6.0,
    seed: options.Seed = None, plugin: options.Plugins = None,
) -> None:  # fmt: skip
    """Drive a robot through excitation manoeuvres and record it.

    Stores journals (`journal/`), tracker logs (`raw/`) and the data set. Ctrl-C, a lost tracker or a lost link end the
    recording in neutral; the part until then is kept.
    """
    load_plugins(plugin)
    check_new_folder(folder)
    machine = hardware.find_robot(robot)
    journal = folder / hardware.JOURNALS
    hardware.check_recording(machine, journal, duration=60.0 * minutes)
    title = f"record {robot}"
    with PlanProgress() as bars, hardware.StopRequest(machine.answers_within) as stops, _ended_by(stops):
        bars.begin(title)
        recorded = machine.record(
            seed=seed or 0, duration=60.0 * minutes, folder=journal, stop=stops, progress=bars.advance
        )
        ended = recorded.report.sentence if recorded.report.reason.is_fault else None
        bars.end(title, ended)
    dataset = recorded.dataset
    for log in recorded.logs:
        hardware.save_raw_log(log, dataset.system, folder / "raw" / f"{log.name}.csv")
    dataset.save(folder)
    print_notes(dataset.notes)
    out.print(episode_table(dataset))
    for sentence in reward_sentences(machine.default_task, dataset):
        print_line(sentence)
    print_line(f"data set stored in {folder}")
    if ended is not None:
        print_status(f"the recording was cut short: {ended}")
        raise typer.Exit(recorded.report.reason.exit_code)


def reward_sentences(task: str, dataset: sysid_evo.Dataset) -> tuple[str, ...]:
    """Return the returns of recorded episodes, and the held-out errors of the reward that ``task`` learns from them."""
    returns = [episode.total_reward for episode in dataset if episode.total_reward is not None]
    if not returns or not task:
        return ()
    mean = sum(returns) / len(returns)
    known = f"Return of the {len(returns):,} episodes: mean {mean:.4g}, best {max(returns):.4g}."
    goal = sysid_evo.make_task(task)
    if not goal.needs_recording:
        return (known,)
    learned = goal.learn(dataset)
    return (known, *learned.sentences, *filter(None, [learned.warning]))


DEFAULT_ROBOT = "emulated_car"
DEFAULT_TASK = "point_to_point"

CONTROLLER_TRIALS = 10

CONTROLLED = "trials"
"""Name of the journal of a controller's trials."""

TRACES = 10
"""Trials whose trajectories are stored for the plots."""


def drive(
    robot: Annotated[str | None, option("Robot, or its TOML file", "SPEC", panel="Robot", shown="emulated_car",
        values=names_of("robot"))] = None,
    model: Annotated[str | None, option("Fitted model to drive instead: its name in --run or its file", "NAME",
        panel="Robot", values=options.fitted_models)] = None,
    controller: Annotated[str | None, option("Controller that drives: its file, or SPEC of a baseline controller",
        "SPEC", panel="Robot", values=names_of("controller"))] = None,
    task: Annotated[str | None, option("Task of trials by hand and of baseline controllers", "SPEC", panel="Robot",
        shown="that of the robot", values=names_of("task"))] = None,
    trials: Annotated[int | None, option("Completed trials", "N", panel="Robot", shown="10; by hand until Ctrl-C",
        parser=number(1))] = None,
    tracker_origin: Annotated[bool, option("Centre the arena on the tracker origin, not on the start", "",
        "--tracker-origin", panel="Robot")] = False,
    host: Annotated[str, option("Address at which the page is served", "ADDR", panel="Page",
        shown="127.0.0.1")] = "127.0.0.1",
    port: Annotated[int, option("Port of the page", "N", panel="Page", shown="a free one",
        parser=number(0, high=65535))] = 0,
    open_page: Annotated[bool, option("Open the page in the browser", "", "--open", panel="Page")] = False,
    watch: Annotated[bool, option("Show on the page how --controller drives, in real time", "", "--watch",
        panel="Page")] = False,
    run: Annotated[Path | None, option("Run folder whose transfer matrix gets the fitness", "DIR",
        values=options.run_folders)] = None,
    name: Annotated[str | None, option("Row of the transfer matrix for driving by hand, such as human", "NAME")] = None,
    folder: Annotated[Path | None, option("New folder for the recording and its data set", "DIR", "--out")] = None,
    seed: Annotated[int | None, option("Seed of the trials", "N", shown="that of the run, or 0",
        parser=number(0))] = None,
    plugin: options.Plugins = None,
) -> None:  # fmt: skip
    """Drive a robot or model by hand, or run a controller on it.

    By hand: the command prints the address of a local web page; everyone who knows it can drive. Released keys mean
    neutral. --out stores a data set; --name adds completed trials to the transfer matrix of the run. --controller adds
    the measured fitness of a controller.

    Exit codes: 0 driving ended normally; 4 link, tracker or robot ended it (the reason is printed); 129, 130 and 143
    for SIGHUP, SIGINT and SIGTERM during a trial.
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
        raise InvalidArgument("drive: --name is for driving by hand; a controller has its own row. Leave --name out")
    if task is not None and sysid_evo.is_stored_artefact(controller, "controller"):
        raise InvalidArgument(f"drive: {controller} was evolved for a task, which is used; leave --task out")
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
    controller: str, robot: hardware.Robot, *, task: str | None, trials: int, run: Path | None, seed: int | None,
    tracker_origin: bool, folder: Path | None, page: hardware.PageAddress | None,
) -> int:  # fmt: skip
    """Run ``controller``, a file or the SPEC of a baseline controller, and return the exit code.

    An evolved controller has its own task; a baseline controller gets ``task``. The trials are the first ones of the
    transfer matrix. The result becomes a cell of ``run``, by default of the run that the file belongs to, and its
    report is rebuilt. The data set of the trials is stored in ``folder``; ``page`` shows them.
    """
    if page is not None:
        hardware.check_page()  # missing packages are reported before anything runs
    if Path(controller).suffix in SUFFIXES.values():
        raise InvalidArgument(
            f"--controller: {controller} is an exported file, which runs without sysid-evo; name the stored "
            "controller, RUN/controllers/NAME"
        )
    if sysid_evo.is_stored_artefact(controller, "controller") or ("/" in controller and "(" not in controller):
        champion = sysid_evo.load_champion(controller)
        run = run or evaluation.run_of_controller(Path(controller))
    else:
        champion = sysid_evo.Champion.baseline(controller, task or robot.default_task or DEFAULT_TASK, robot.system)
    champion.check_system(robot.system)
    if seed is None:
        seed = evaluation.seed_of_run(run) if run else champion.seed
    seeds = evaluation.transfer_seeds(seed, trials)
    if robot.stepped:
        return _step(champion, robot, seeds, run, folder, page)
    recorder = None if folder is None else hardware.recorder_of(folder, robot, CONTROLLED)
    with recorder or nullcontext():
        code = _loop(champion, robot, seeds, seed, run, tracker_origin, recorder, page)
    if folder is not None:
        _store(folder, [(CONTROLLED, None)], robot.system)
    return code


def _loop(
    champion: sysid_evo.Champion, robot: hardware.Robot, seeds: Seeds, seed: int, run: Path | None,
    tracker_origin: bool, recorder: hardware.Recorder | None, page: hardware.PageAddress | None,
) -> int:  # fmt: skip
    """Run a controller on a robot in the control loop, and return the exit code."""
    if page is not None:
        robot = hardware.in_real_time(robot)
    column, title = matrix_column(robot), f"drive {champion.name} on {robot.name}"
    task, law = sysid_evo.make_task(champion.task), sysid_evo.make_controller(champion.controller)
    hardware.check_driving(robot, task, law, champion.parameters[None])
    with ExitStack() as stack:
        bars, stops = stack.enter_context(PlanProgress()), stack.enter_context(hardware.StopRequest())
        on_decision = None
        if page is not None:
            shown = hardware.shown_live(robot, task, champion.name, page, stop=stops, announce=_watch_at)
            on_decision = stack.enter_context(shown)
        runner = hardware.RobotRunner(
            robot,
            tracker_frame=tracker_origin,
            seed=seed,
            listeners=() if recorder is None else (recorder,),
            stop=stops,
            progress=bars.advance,
            on_decision=on_decision,
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
    champion: sysid_evo.Champion, robot: hardware.Robot, seeds: Seeds, run: Path | None, folder: Path | None,
    page: hardware.PageAddress | None,
) -> int:  # fmt: skip
    """Run a controller on a robot that steps on demand, such as an environment, and return the exit code.

    With a ``page`` the trials are then played back on it.
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
        print_line(f"data set stored in {folder}")
    if page is None:
        return 0
    stopped = hardware.play_back(champion, robot, seeds, rollouts, page, announce=_watch_at)
    return 0 if stopped is None else stopped.exit_code


def _watch_at(url: str) -> None:
    print_line(f"Watch it at {url} (driving begins when the page is open)")


def trials_table(cell: evaluation.TransferResult, rollouts: sysid_evo.Rollouts) -> Table:
    """Return a table of trials: fitness and steps of each, mean and standard deviation, missing trials."""
    headings = "trial", cell.unit or "fitness", "steps"
    table = table_of(*headings, numbers=headings)
    for trial, (fitness, steps) in enumerate(zip(cell.fitness, rollouts.survived[0], strict=False)):
        table.add_row(str(trial + 1), f"{fitness:g}", str(steps))
    for why, group in groupby(enumerate(cell.missing, cell.trials + 1), key=lambda pair: pair[1]):
        missing = [trial for trial, _ in group]
        table.add_row(str(missing[0]) if len(missing) == 1 else f"{missing[0]} to {missing[-1]}", "missing", why)
    if cell.trials:
        table.add_row("mean", evaluation.by_error(cell.mean, cell.standard_error), "", style="bold")
    if cell.trials > 1:
        table.add_row("standard deviation", evaluation.by_error(cell.std, cell.standard_error), "")
    return table


@dataclass(frozen=True)
class DriveTarget:
    """A robot or model that is driven by hand, and its column in the transfer matrix of a run."""

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
        task = task or machine.default_task or DEFAULT_TASK
        return DriveTarget(hardware.in_real_time(machine), matrix_column(machine), where, on_robot=True, task=task)
    store = sysid_evo.plan.Store(where or Path())
    column = evaluation.find_column(store, model)
    modelled = hardware.ModelRobot(column.label, evaluation.dynamics_of(store, column))
    return DriveTarget(hardware.in_real_time(modelled), column.label, where, on_robot=False, task=task or DEFAULT_TASK)


def matrix_column(robot: hardware.Robot) -> str:
    """Return the column of a driven robot; that of an emulated robot differs from the column that `compare` fills."""
    return robot.name if robot.dynamics is None else f"{robot.name} driven"


def drive_by_hand(
    driven: DriveTarget, page: hardware.PageAddress, trials: int | None, folder: Path | None, seed: int | None,
    tracker_origin: bool,
) -> tuple[list[hardware.HandTrial], int]:  # fmt: skip
    """Serve the page for driving by hand on the trials of controllers; return the trials and the exit code."""
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
            announce=lambda url: print_line(f"Drive {robot.name} at {url}"),
            recorder=None if folder is None else recorder,
            tracker_origin=tracker_origin,
        ) as offered,
    ):
        try:
            for trial in offered:
                ended.append(trial)
                _print_trial(trial, task.fitness_unit)
                if sum(each.fitness is not None for each in ended) == trials:
                    stops.request(hardware.StopReason.SAMPLES)
        except LinkLost as error:
            print_status(f"{robot.name}: {error}")
            stops.request(hardware.StopReason.LINK_LOST)
    for made in recorders:
        if made.problem is not None:
            print_status(f"{made.lost} records were lost: {made.problem}")
    reason = stops.reason or hardware.StopReason.PILOT
    under_way = bool(ended) and ended[-1].report.reason.is_fault and ended[-1].trajectory is not None
    return ended, 0 if reason is hardware.StopReason.SIGINT and not under_way else reason.exit_code


def _print_trial(trial: hardware.HandTrial, unit: str) -> None:
    if trial.fitness is not None:
        out.print(f"trial {trial.number}: {trial.fitness:g} {unit}", highlight=False)
    elif trial.report.reason.is_fault:
        print_status(f"trial {trial.number}: {trial.report.sentence}")
    elif trial.trajectory is not None:
        err.print(f"trial {trial.number}: stopped after {trial.trajectory.duration:.1f} s", highlight=False)


def add_row(driven: DriveTarget, run: Path, name: str, trials: Sequence[hardware.HandTrial]) -> None:
    """Add the completed trials to the transfer matrix of the run, as the row ``name``."""
    whole = [(one.fitness, one.trajectory, one.task_state) for one in trials if one.fitness is not None]
    if not whole:
        err.print(f"no trial was completed, so {name} gets no row", highlight=False, markup=False)
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
    """Convert the journals in ``folder`` to a data set, as `sysid-evo record` does."""
    try:
        dataset = hardware.store_journals(folder, runs, system)
    except InvalidData as error:
        print_status(str(error))
        return
    if dataset is None:
        err.print(f"nothing was driven, so there is no data set in {folder}", highlight=False, markup=False)
        return
    for note in dataset.notes:
        print_status(f"note: {note}")
    out.print(episode_table(dataset))
    print_line(f"data set stored in {folder}")
