"""Compare, fit, study, report: experiments and their reports."""

from __future__ import annotations

import errno
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.text import Text

import evaluation
from evaluation.experiment import FILE, MEANINGLESS, Experiment, meaningful
from sysid_evo.cli import options
from sysid_evo.cli.console import SOME_FAILED, as_option, err, note, out, print_error, say, session, table_of, tell
from sysid_evo.cli.options import load_plugins, resolved, settings_of
from sysid_evo.cli.progress import PlanProgress, duration, print_plan
from sysid_evo.errors import InvalidArgument, InvalidData, PluginError, refuse_meaningless
from sysid_evo.plan.executors import execute
from sysid_evo.plan.store import CellOutcome, Store
from sysid_evo.registry.plugins import load_named_plugins
from sysid_evo.registry.registry import models as families


def compare(
    data: Annotated[
        list[Path] | None, typer.Option(help="Recordings of a robot (default: record an emulated one); repeatable.")
    ] = None,
    test: options.Test = None,
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
    preset: options.Preset = None,
    stop_after: Annotated[
        str | None, typer.Option(help="'prediction' leaves the controllers out, 'fit' prediction errors, too.")
    ] = None,
    task: options.Task = None,
    controller: options.Controller = None,
    baselines: Annotated[
        str | None,
        typer.Option(help="Controllers that need no evolution, such as pursuit, separated by commas: further rows."),
    ] = None,
    strategy: options.Strategy = None,
    procedure: options.Procedure = None,
    aggregate: options.Aggregate = None,
    noise: options.Noise = None,
    penalty: options.Penalty = None,
    generations: options.Generations = None,
    trials: options.Trials = None,
    repeats: options.Repeats = None,
    schedule: options.Schedule = None,
    estimator_delay: options.EstimatorDelay = None,
    reference: Annotated[
        bool | None,
        typer.Option(
            "--reference/--no-reference",
            help="Also search on the emulated robot itself, once, as long as in a model.",
        ),
    ] = None,
    seed: options.Seed = None,
    folder: options.Out = None,
    columns: options.Columns = None,
    plugin: options.Plugins = None,
    config: Annotated[
        Path | None, typer.Option(help="experiment.toml, or a run folder with one; other options win over it.")
    ] = None,
    jobs: options.Jobs = None,
    scheduler: options.Scheduler = None,
    dry_run: options.DryRun = False,
    as_json: options.Json = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="Print every table of the report.")] = False,
) -> None:
    """Fit models, evolve controllers in them, and compare both: which predict, which transfer.

    With no options, all on an emulated toy car. Interrupted, it goes on with the same --out.
    """
    load_plugins(plugin)
    settings = Experiment.read(config) if config is not None else {}
    if settings.pop("data_digest", None) and not (data or robot or "data" in settings or "robot" in settings):
        raise InvalidArgument(f"{config} was run on a data set given in Python: name its recordings with --data")
    named = () if config is None else load_named_plugins(settings.get("plugins", ()), config)
    if preset is not None and settings:
        settings = evaluation.unsettled(settings)
    asked = settings_of(locals(), Experiment.model_fields)
    asked |= {"plugins": tuple(dict.fromkeys((*named, *asked.get("plugins", ()))))}
    refuse_meaningless(MEANINGLESS, asked, {**settings, **asked}, as_option)
    try:
        experiment = Experiment.of(meaningful(settings, asked))
    except InvalidArgument as error:
        raise InvalidArgument(f"{'' if config is None else f'{config}, or an option: '}{error}") from error
    run_experiment(
        experiment, folder, jobs=jobs, scheduler=scheduler, dry_run=dry_run, as_json=as_json, verbose=verbose
    )


DEFAULT = "auto"
"""What is fitted where no family is named: who knows none yet has a choice made by the data."""


def fit(
    data: Annotated[list[Path], typer.Argument(help="Logs, folders of logs, or a folder written by import.")],
    models: Annotated[
        str,
        typer.Option(
            help="Families, LABEL=NAME(parameter=value, ...), separated by commas. 'auto' tries the zoo on recordings "
            "held out and becomes the mean of what runs free best there."
        ),
    ] = DEFAULT,
    test: options.Test = None,
    preset: options.Preset = None,
    seed: options.Seed = None,
    folder: options.Out = None,
    columns: options.Columns = None,
    plugin: options.Plugins = None,
    jobs: options.Jobs = None,
    scheduler: options.Scheduler = None,
    dry_run: options.DryRun = False,
    as_json: options.Json = False,
) -> None:
    """Fit model families to recordings and store them in a run folder; without --models the best of the zoo (auto)."""
    load_plugins(plugin)
    for path in data:
        if str(path) in families.names() and not path.exists():
            raise InvalidArgument(f"{path} is a model and no recording; did you mean --models {models},{path}?")
    settings = settings_of(locals(), Experiment.model_fields)
    experiment = Experiment.of({**settings, "stop_after": "fit"})
    run_experiment(experiment, folder, jobs=jobs, scheduler=scheduler, dry_run=dry_run, as_json=as_json, verbose=False)


def run_experiment(
    experiment: Experiment,
    folder: Path | None,
    *,
    jobs: int | None,
    scheduler: str | None,
    dry_run: bool,
    as_json: bool,
    verbose: bool,
) -> None:
    """Plan an experiment, run what is not done yet, and print what it found."""
    path = evaluation.check_run_folder(folder)
    comparison, remarks = evaluation.plan_run(experiment, path)
    store = Store(path)
    for remark in remarks:
        note(remark)
    if dry_run:
        print_plan(comparison.plan, store, as_json=as_json)
        return
    session.run = store
    store_experiment(comparison, path)
    go_on = f"--out {shlex.quote(str(path))}"
    with PlanProgress(go_on, cells=comparison.plan, elsewhere=scheduler is not None) as bars:
        outcomes = execute(comparison.plan, store, observer=bars, jobs=jobs, scheduler=scheduler)
    failed = [cell for cell in comparison.plan if outcomes[cell.digest].failed]
    count = sum(store.find(cell.digest) is not None for cell in failed)  # the others only need one of these
    stopped = outcomes[comparison.data.digest].error
    if isinstance(stopped, ConnectionError):  # no robot, no data, no report
        raise stopped
    empty = False
    try:
        if experiment.stop_after == "fit":
            print_fits(comparison, store, outcomes, as_json=as_json)
        else:
            report = evaluation.report_of(comparison, store)
            print_report(report, path, as_json=as_json, verbose=verbose)
            empty, count = evaluation.is_empty(report), len(report.all_failures)
    except InvalidData as error:
        if not failed:
            raise
        print_error(error)
    if failed:
        tell(f"{count} {'part' if count == 1 else 'parts'}; see {path / 'log.jsonl'}", label="failed: ")
    if failed or empty:
        raise typer.Exit(SOME_FAILED)


def store_experiment(comparison: evaluation.Comparison, path: Path) -> None:
    """Write ``experiment.toml``; if another one stood there, say in what it differs."""
    file = path / FILE
    wanted = comparison.experiment.model_dump(mode="json", exclude_none=True)
    if file.is_file():
        found = Experiment.of(Experiment.read(file)).model_dump(mode="json", exclude_none=True)
        tell_differences(file, found, wanted)
    comparison.experiment.write(file)


def tell_differences(file: Path, found: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Say in which settings the ``file`` that is replaced differs."""
    differing = sorted(key for key in {*found, *wanted} if found.get(key) != wanted.get(key))
    if differing:
        note(f"{file} had other {', '.join(differing)}; what both need is kept")


def print_report(
    report: evaluation.ComparisonResults, path: Path, *, as_json: bool, verbose: bool, written: bool = True
) -> None:
    """Print the verdict, the short table, and where the report is."""
    if as_json:
        out.print_json(data=evaluation.to_json(report))
        return
    for part in evaluation.tables(report) if verbose else evaluation.brief(report, folder=path):
        out.print(part, crop=False)
    err.print(where_time_went(report.timings), highlight=False)
    if written:
        say(f"Report: {path / 'report.html'}")


def print_fits(
    comparison: evaluation.Comparison, store: Store, outcomes: Mapping[str, CellOutcome], *, as_json: bool
) -> None:
    """Print how good each fitted model is, where it is, why one is not; then what limits the best of them."""
    advice = store.outcome(comparison.advice).value
    rows: list[dict[str, Any]] = []
    for label, cell in comparison.fits.items():
        outcome, score = outcomes[cell.digest], store.outcome(comparison.judged[label]).value
        rows.append(
            {
                "model": label,
                "error": None if score is None else score.n,
                "steps": None if score is None else score.steps,
                "evaluated_on": None if score is None else score.evaluated_on,
                "seconds": round(outcome.seconds, 1),
                "file": None if outcome.failed else f"{store.result_path(cell)}.json",
                "reason": outcome.reason,
                "advice": evaluation.plain(advice) if advice is not None and advice.model == label else None,
                "note": "" if outcome.failed else store.load(cell).fit_note,
            }
        )
    if as_json:
        out.print_json(data=rows)
        return
    table = table_of("model", "error N", "seconds", "stored as", numbers=("error N", "seconds"))
    for row in rows:
        where = str(row["file"] or f"failed: {row['reason']}")
        table.add_row(str(row["model"]), evaluation.three_digits(row["error"]), str(row["seconds"]), where)
    out.print(table)
    print_judged(comparison, store)
    for row in rows:
        if row["note"]:
            out.print(Text(f"{row['model']} {row['note']}"))
    for part in [] if advice is None else evaluation.advice_lines(advice):
        out.print(part)
    labels = ",".join(str(row["model"]) for row in rows if row["file"])
    if labels:
        command = shlex.join(["sysid-evo", "evolve", "--run", str(store.path), "--against", labels])
        tell(f"evolve against them with: {command}")


def print_judged(comparison: evaluation.Comparison, store: Store) -> None:
    """Print the errors of fitted models, the data they were measured on, and whether these suffice for a comparison."""
    found = {label: score for label, cell in comparison.judged.items() if (score := store.outcome(cell).value)}
    grouped: dict[tuple[int | None, str], list[str]] = {}
    for label, score in found.items():
        grouped.setdefault((score.steps, score.evaluated_on), []).append(label)
    dt = store.outcome(comparison.data).value.training.system.dt
    for (steps, evaluated_on), labels in grouped.items():
        which = f" ({', '.join(labels)})" if len(grouped) > 1 else ""
        if steps is None:
            out.print(Text(f"no error of {', '.join(labels)} can be measured: {evaluated_on}"))
            continue
        over = "after" if found[labels[0]].blocks is not None else "over the first"
        said = f"mean error {over} {evaluation.horizon_name(steps, dt)} on {evaluated_on}, in standard deviations"
        out.print(Text(f"error N{which}: {said}; from 1 on a model is of no use"))
    blocks = [score.blocks for score in found.values() if score.blocks is not None]
    if blocks and not evaluation.enough_blocks(min(blocks)):
        note(f"blocks of test data: {min(blocks)}, too few to compare models; record more")


def where_time_went(timings: Mapping[str, float]) -> str:
    """Return the seconds that each kind of cell took, whenever that was, the longest first."""
    kinds: dict[str, float] = {}
    for cell, taken in timings.items():
        kind = cell.split(" ", 1)[0]
        kinds[kind] = kinds.get(kind, 0.0) + taken
    parts = [f"{kind} {taken:.1f} s" for kind, taken in sorted(kinds.items(), key=lambda item: -item[1])]
    return f"Computing took {sum(kinds.values()):.1f} s in all: {', '.join(parts)}"


def report(
    run: Annotated[Path, typer.Argument(help="Run folder.")],
    as_json: options.Json = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="Print every table of the report.")] = False,
    formats: Annotated[
        list[str] | None,
        typer.Option("--format", help="Write it as markdown or svg (figures), too; repeatable."),
    ] = None,
    plugin: options.Plugins = None,
) -> None:
    """Make the report of a run again, of what is there: nothing is fitted, evolved or driven."""
    for name in formats or ():
        if name not in evaluation.FORMATS:
            raise InvalidArgument(f"--format: expected one of {', '.join(evaluation.FORMATS)}, got {name!r}")
    load_plugins(plugin)
    written = True
    try:
        made = report_again(run)
    except OSError as error:
        if error.errno not in (errno.EROFS, errno.EACCES, errno.EPERM):
            raise
        written, made = False, report_again(run, written=False)
        note(f"{run} cannot be written, so the report is printed only: {error.strerror}")
    if made is None:
        raise InvalidData(f"{run} holds no fitted model yet, so there is nothing to report: go on with it first")
    print_report(made, run, as_json=as_json, verbose=verbose, written=written)
    for name in formats or ():
        if files := evaluation.write_format(
            evaluation.story_of(made), name, run
        ):  # one without figures has none as svg
            tell(str(files[0].parent if name == "svg" else files[0]), label=f"{name}: ", style="dim")


def add_measured(folder: Path, measured: evaluation.MeasuredResult) -> None:
    """Store a cell of a robot, or of a person on anything, in a run, and make its report again if it has one."""
    evaluation.save_measured(folder, measured)
    try:
        made = report_again(folder) if (folder / FILE).is_file() else None
    except PluginError as error:  # what was driven is kept all the same
        tell(f"stored in {folder}; its report is not updated: {error}")
        return
    if made is not None:
        say(f"Report: {folder / 'report.html'}")
    else:
        tell(f"stored in {folder}, which has no report (compare makes one)")


def report_again(run: Path, *, written: bool = True) -> evaluation.ComparisonResults | None:
    """Write the report of a run again, with the cells measured since; None if the run has no model yet.

    Raises `InvalidArgument` if ``run`` is no comparison's run.
    """
    comparison, remarks = evaluation.comparison_of(run)
    store = session.run = Store(run)
    for remark in remarks if written else ():  # else they were printed at the first attempt
        note(remark)
    return evaluation.report_again(comparison, store, written=written)


def study(
    file: Annotated[Path, typer.Argument(help="The study, STUDY.toml, or the folder of one.")],
    folder: Annotated[
        Path | None, typer.Option("--out", help="Folder of the study (default runs/NAME of the file).")
    ] = None,
    jobs: options.Jobs = None,
    scheduler: options.Scheduler = None,
    dry_run: options.DryRun = False,
    render: Annotated[
        bool, typer.Option("--render", help="Compute nothing: show what is there, and say what is missing.")
    ] = False,
    plugin: options.Plugins = None,
    as_json: options.Json = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="Print every table.")] = False,
) -> None:
    """Compare over a grid of robots, seeds and settings: tables with intervals, Parquet, a page.

    What two points share is computed once. Interrupted, it goes on with the same command; a point that is added later
    computes only what is new.
    """
    load_plugins(plugin)
    found = evaluation.Study.read(file)
    if plugin:
        named = found.experiment.get("plugins", ())
        found = found.with_plugins(tuple(dict.fromkeys((*named, *(resolved(plugin) or ())))))
    path = (
        evaluation.check_run_folder(file) if file.is_dir() and folder is None else evaluation.study_folder(folder, file)
    )
    if render and not path.is_dir():
        raise InvalidArgument(f"--render: expected the folder of a study, found none at {path}")
    planned = evaluation.plan_study(found)
    store = Store(path)
    for remark in planned.plan.remarks:
        note(remark)
    if dry_run:
        print_points(planned, store, as_json=as_json)
        return
    session.run = store
    if not render:
        there = path / evaluation.STUDY_FILE
        if there.is_file():
            tell_differences(there, evaluation.Study.read(there).settings, planned.study.settings)
        planned.study.write(there)
        go_on, elsewhere = f"--out {shlex.quote(str(path))}", scheduler is not None
        with PlanProgress(go_on, cells=planned.plan, where=planned.where, elsewhere=elsewhere) as bars:
            execute(planned.plan, store, observer=bars, jobs=jobs, scheduler=scheduler)
    results = evaluation.write_study(planned, path)
    print_study(results, path, as_json=as_json, verbose=verbose)
    if results.failures:
        tell(f"{len(results.failures)} of {len(planned.plan)} cells failed, see {path / 'log.jsonl'}", label="failed: ")
        raise typer.Exit(SOME_FAILED)


def print_study(results: evaluation.StudyResults, path: Path, *, as_json: bool, verbose: bool) -> None:
    """Print the answers, the short table, and where the rest is."""
    if as_json:
        out.print_json(data=evaluation.study_document(results))
        return
    for part in evaluation.study_brief(results, verbose=verbose):
        out.print(part)
    say(f"Tables: {path / 'study.md'}")
    say(f"Page: {path / 'study.html'}")


def print_points(planned: evaluation.PlannedStudy, store: Store, *, as_json: bool) -> None:
    """Print the points, how many cells of each are done, and about how long the others take on one processor."""
    records = {cell.digest: store.find(cell.digest) for cell in planned.plan}
    about = evaluation.seconds_about(planned, records)
    done = {digest for digest, record in records.items() if record is not None and record.status == "done"}
    rows: list[dict[str, Any]] = []
    seen: set[str] = set()
    for point, comparison in planned.points:
        own = [cell.digest for cell in comparison.plan]
        new = [digest for digest in own if digest not in seen and digest not in done]
        seen |= set(own)
        rows.append(
            {
                "point": point.name,
                "cells": len(own),
                "kept": sum(digest in done for digest in own),
                "seconds": round(sum(about[digest] for digest in new), 1),
            }
        )
    total = sum(about[digest] for digest in about if digest not in done)
    if as_json:
        document = {"points": rows, "cells": len(records), "kept": len(done), "seconds": round(total, 1)}
        out.print_json(data={**document, "remarks": list(planned.plan.remarks)})
        return
    table = table_of("point", "cells", "kept", "about", numbers=("cells", "kept", "about"))
    for row in rows:
        table.add_row(row["point"], str(row["cells"]), str(row["kept"]), duration(row["seconds"]))
    out.print(table)
    sentence = f"{len(rows)} points, {len(records)} cells, {len(done)} kept, about {duration(total)} of one processor"
    out.print(sentence, highlight=False)
