"""`sysid-evo compare`: the whole chain from recordings to a verdict."""

from __future__ import annotations

import json as json_format
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sysid_evo.cli.console import complain, err, out, session, tell
from sysid_evo.cli.exits import SOME_FAILED
from sysid_evo.cli.options import (
    Aggregate,
    Caution,
    Columns,
    Controller,
    DryRun,
    EstimatorDelay,
    Generations,
    Jobs,
    Json,
    Noise,
    Out,
    Plugins,
    Preset,
    Recipe,
    Runs,
    Schedule,
    Scheduler,
    Seed,
    Strategy,
    Task,
    Test,
    Trials,
    given,
    listed,
    load_plugins,
    seconds,
)
from sysid_evo.cli.plans import print_plan

if TYPE_CHECKING:
    from collections.abc import Mapping

    from evaluation.comparison import Comparison
    from evaluation.report import Report
    from sysid_evo.plan import Outcome, Store


def compare(
    data: Annotated[
        list[Path] | None, typer.Option(help="Recordings of a robot (default: record an emulated one); repeatable.")
    ] = None,
    test: Test = None,
    leave_out: Annotated[
        str | None,
        typer.Option(help="'condition': fit every family also without each condition of the data, and test it there."),
    ] = None,
    models: Annotated[
        str | None, typer.Option(help="Families, LABEL=NAME(parameter=value, ...), separated by commas, or 'all'.")
    ] = None,
    ensembles: Annotated[str | None, typer.Option(help="Labels joined by +, ensembles separated by commas.")] = None,
    robot: Annotated[
        str | None, typer.Option(help="Robot for the last column (default without --data: emulated_car).")
    ] = None,
    minutes: Annotated[float | None, typer.Option(min=0.1, help="Length of the recording of a robot (6).")] = None,
    preset: Preset = None,
    only: Annotated[
        str | None, typer.Option(help="'prediction' leaves the controllers out, 'fit' prediction errors, too.")
    ] = None,
    task: Task = None,
    controller: Controller = None,
    by_hand: Annotated[
        str | None,
        typer.Option(help="Controllers that need no evolution, such as pursuit, separated by commas: further rows."),
    ] = None,
    strategy: Strategy = None,
    recipe: Recipe = None,
    aggregate: Aggregate = None,
    noise: Noise = None,
    caution: Caution = None,
    generations: Generations = None,
    trials: Trials = None,
    runs: Runs = None,
    schedule: Schedule = None,
    estimator_delay: EstimatorDelay = None,
    yardstick: Annotated[
        bool | None,
        typer.Option("--yardstick/--no-yardstick", help="Also evolve on the emulated robot itself."),
    ] = None,
    seed: Seed = None,
    folder: Out = None,
    columns: Columns = None,
    plugin: Plugins = None,
    config: Annotated[
        Path | None, typer.Option(help="experiment.toml, or a run folder with one; other options win over it.")
    ] = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    dry_run: DryRun = False,
    json: Json = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="Print every table of the report.")] = False,
) -> None:
    """Fit models, evolve controllers in them, and compare both: which predict, which transfer.

    With no options, all on an emulated toy car. Interrupted, it goes on with the same --out.
    """
    from evaluation.comparison import Experiment, unsettled
    from sysid_evo.errors import InvalidArgument

    settings = Experiment.read(config) if config is not None else {}
    if settings.pop("data_digest", None) and not (data or robot or "data" in settings or "robot" in settings):
        raise InvalidArgument(f"{config} was run on a data set given in Python: name its recordings with --data")
    if preset is not None and settings:
        load_plugins([Path(file) for file in settings.get("plugins", ())])
        settings = unsettled(settings)
    settings |= given(
        data=None if data is None else tuple(str(path.resolve()) for path in data),
        test=None if test is None else tuple(test),
        leave_out=leave_out,
        models=listed("--models", models),
        ensembles=listed("--ensembles", ensembles),
        robot=robot,
        minutes=minutes,
        preset=preset,
        only=only,
        task=task,
        controller=controller,
        by_hand=listed("--by-hand", by_hand),
        strategy=strategy,
        recipe=recipe,
        aggregate=aggregate,
        noise=noise,
        caution=caution,
        generations=generations,
        trials=trials,
        runs=runs,
        schedule=schedule,
        estimator_delay=seconds(estimator_delay),
        yardstick=yardstick,
        seed=seed,
        columns=None if columns is None else existing(columns),
        plugins=None if plugin is None else tuple(str(path.resolve()) for path in plugin),
    )
    try:
        experiment = Experiment.of(settings)
    except InvalidArgument as error:
        raise InvalidArgument(f"{'' if config is None else f'{config}, or an option: '}{error}") from error
    run_experiment(experiment, folder, jobs=jobs, scheduler=scheduler, dry_run=dry_run, json=json, verbose=verbose)


def run_experiment(
    experiment: Any,
    folder: Path | None,
    *,
    jobs: int | None,
    scheduler: str | None,
    dry_run: bool,
    json: bool,
    verbose: bool,
) -> None:
    """Plan an experiment, run what is not done yet, and print what it found."""
    from evaluation.comparison import check_experiment, check_run_folder, finished, plan_comparison
    from evaluation.report import tells_nothing
    from evaluation.transfer import load_measured
    from sysid_evo.cli.progress import Bars
    from sysid_evo.errors import InvalidData
    from sysid_evo.plan import Store, execute

    load_plugins([Path(plugin) for plugin in experiment.plugins])
    path = check_run_folder(folder)
    check_experiment(experiment)
    dataset = read_data(experiment)
    measured, damaged = load_measured(path)
    comparison = plan_comparison(experiment, dataset=dataset, measured=measured)
    store = Store(path)
    for remark in (*comparison.plan.remarks, *damaged):
        tell(remark, label="note: ", style="dim")
    if dry_run:
        print_plan(comparison.plan, store, json=json)
        return
    session.run = path
    store_experiment(comparison, path)
    with Bars(f"--out {shlex.quote(str(path))}", elsewhere=scheduler is not None) as bars:
        outcomes = execute(comparison.plan, store, observer=bars, jobs=jobs, scheduler=scheduler)
    failed = [cell.title for cell in comparison.plan if outcomes[cell.digest].failed]
    stopped = outcomes[comparison.data.digest].error
    if isinstance(stopped, ConnectionError):  # no robot, no data, no report
        raise stopped
    empty = False
    try:
        if experiment.only == "fit":
            print_fits(comparison, store, outcomes, json=json)
        else:
            report = finished(comparison, store)
            print_report(report, path, json=json, verbose=verbose)
            empty = tells_nothing(report)
    except InvalidData as error:
        if not failed:
            raise
        complain(error)
    if failed:
        tell(f"{len(failed)} of {len(comparison.plan)} cells failed, see {path / 'log.jsonl'}", label="failed: ")
    if failed or empty:
        raise typer.Exit(SOME_FAILED)


def read_data(experiment: Any) -> Any:
    """Read the recordings of an experiment, if it has some, and tell what their preparation noted."""
    if experiment.data is None:
        return None
    from sysid_evo.data import Dataset

    dataset = Dataset.read(experiment.data, columns=experiment.columns)
    for note in dataset.notes:
        tell(note, label="note: ", style="dim")
    return dataset


def store_experiment(comparison: Comparison, path: Path) -> None:
    """Write ``experiment.toml``; if another one stood there, say in what it differs."""
    from evaluation.comparison import FILE, Experiment

    file = path / FILE
    wanted = comparison.experiment.model_dump(mode="json", exclude_none=True)
    if file.is_file():
        found = Experiment.of(Experiment.read(file)).model_dump(mode="json", exclude_none=True)
        differing = sorted(key for key in {*found, *wanted} if found.get(key) != wanted.get(key))
        if differing:
            tell(f"{file} had other {', '.join(differing)}; what both need is kept", label="note: ", style="dim")
    comparison.experiment.write(file)


def print_report(report: Report, path: Path, *, json: bool, verbose: bool) -> None:
    """Print the verdict, the short table, and where the report is."""
    from evaluation.report import brief, tables, to_json

    if json:
        out.print_json(json_format.dumps(to_json(report)))
        return
    for part in tables(report) if verbose else brief(report, folder=path):
        out.print(part, crop=False)
    err.print(where_time_went(report.timings), highlight=False)
    out.print(f"Report: {path / 'report.html'}", highlight=False, soft_wrap=True)


def print_fits(comparison: Comparison, store: Store, outcomes: Mapping[str, Outcome], *, json: bool) -> None:
    """Print where each fitted model stands, why one does not, how it learned; then what limits the best of them."""
    from rich.table import Table
    from rich.text import Text

    from evaluation.advice import advice_to_json
    from evaluation.report import advice_lines

    advice = store.outcome(comparison.advice).value
    rows = []
    for label, cell in comparison.fits.items():
        outcome = outcomes[cell.digest]
        rows.append(
            {
                "model": label,
                "seconds": round(outcome.seconds, 1),
                "file": None if outcome.failed else f"{store.where(cell)}.json",
                "reason": outcome.reason,
                "advice": advice_to_json(advice) if advice is not None and advice.model == label else None,
                "note": "" if outcome.failed else cell.load(store.where(cell)).fit_note,
            }
        )
    if json:
        out.print_json(json_format.dumps(rows))
        return
    table = Table(box=None, pad_edge=False)
    for heading in ("model", "seconds", "stored as"):
        table.add_column(heading, justify="right" if heading == "seconds" else "left", overflow="fold")
    for row in rows:
        table.add_row(str(row["model"]), str(row["seconds"]), str(row["file"] or f"failed: {row['reason']}"))
    out.print(table)
    for row in rows:
        if row["note"]:
            out.print(Text(f"{row['model']} {row['note']}"))
    for part in [] if advice is None else advice_lines(advice):
        out.print(part)
    labels = ",".join(str(row["model"]) for row in rows if row["file"])
    if labels:
        command = shlex.join(["sysid-evo", "evolve", "--run", str(store.path), "--against", labels])
        tell(f"evolve against them with: {command}")


def where_time_went(timings: Mapping[str, float]) -> str:
    """Return the seconds that each kind of cell took, whenever that was, the longest first."""
    kinds: dict[str, float] = {}
    for cell, taken in timings.items():
        kind = cell.split(" ", 1)[0]
        kinds[kind] = kinds.get(kind, 0.0) + taken
    parts = [f"{kind} {taken:.1f} s" for kind, taken in sorted(kinds.items(), key=lambda item: -item[1])]
    return f"Computing took {sum(kinds.values()):.1f} s in all: {', '.join(parts)}"


def existing(columns: Path) -> str:
    """Return the path of a column map, or the name of a shipped one."""
    return str(columns.resolve()) if columns.exists() else str(columns)
