"""Compare, fit, study, report: experiments and their reports."""

from __future__ import annotations

import errno
import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.text import Text

import evaluation
import sysid_evo.plan
from evaluation.experiment import FILE, MEANINGLESS, Experiment, meaningful
from sysid_evo.cli import console, options
from sysid_evo.cli.console import SOME_FAILED, as_option, note, out, print_line, print_status, session, table_of
from sysid_evo.cli.options import argument, load_plugins, option, resolved, run_folders, with_settings
from sysid_evo.cli.progress import PlanProgress, duration, print_plan
from sysid_evo.cli.runs import report_again
from sysid_evo.errors import InvalidArgument, InvalidData, refuse_meaningless
from sysid_evo.registry.plugins import load_named_plugins
from sysid_evo.registry.registry import models as families
from sysid_evo.settings import option_of

COMPARED = tuple(name for name in Experiment.model_fields if option_of(Experiment, name).panel)


@with_settings(Experiment, *COMPARED)
def compare(
    *, settings: dict[str, Any],
    config: Annotated[Path | None, option("experiment.toml or run folder with the settings; other options win over it",
        "PATH")] = None,
    folder: options.Out = None, jobs: options.Jobs = None, scheduler: options.Scheduler = None,
    dry_run: options.DryRun = False, as_json: options.Json = False, verbose: options.Verbose = False,
) -> None:  # fmt: skip
    """Fit models, evolve controllers, report prediction and transfer.

    Without options everything runs on an emulated toy car. SPEC is NAME or NAME(parameter=value, ...); `sysid-evo
    names` lists them. Defaults are in parentheses. To resume an interrupted run, repeat the command with the same
    --out.
    """
    load_plugins(settings.get("plugins"))
    stored = Experiment.read(config) if config is not None else {}
    if stored.pop("data_digest", None) and not {"data", "robot"} & {*stored, *settings}:
        raise InvalidArgument(f"{config} was run on a data set given in Python: name its recordings with --data")
    if "models" in settings:
        for name in ("tried_models", "searched"):  # those of the stored models
            stored.pop(name, None)
    named = () if config is None else load_named_plugins(stored.get("plugins", ()), config)
    if "preset" in settings and stored:
        stored = evaluation.unsettled(stored)
    given = settings | {"plugins": tuple(dict.fromkeys((*named, *settings.get("plugins", ()))))}
    refuse_meaningless(MEANINGLESS, given, {**stored, **given}, as_option)
    experiment = Experiment.of(
        meaningful(stored, given), lambda name: as_option(name) if name in given else f"{config}: {name}"
    )
    run_experiment(
        experiment, folder, jobs=jobs, scheduler=scheduler, dry_run=dry_run, as_json=as_json, verbose=verbose
    )


DEFAULT = "auto"
"""The family that is fitted if none is named: the data choose."""


@with_settings(Experiment, "columns", "test", "models", "preset", "seed", "plugins", models=(DEFAULT,))
def fit(
    *,
    data: Annotated[list[Path], argument("Logs, folders of logs, or a data set", "DATA")],
    settings: dict[str, Any], folder: options.Out = None, jobs: options.Jobs = None,
    scheduler: options.Scheduler = None, dry_run: options.DryRun = False, as_json: options.Json = False,
) -> None:  # fmt: skip
    """Fit model families to recordings.

    The models are stored in a run folder. The default family, auto, fits the families of the zoo and averages those
    with the lowest simulation error on held-out data. Defaults are in parentheses.
    """
    load_plugins(settings.get("plugins"))
    for path in data:
        if str(path) in families.names() and not path.exists():
            models = ",".join(settings["models"])
            raise InvalidArgument(f"{path} is a model and no recording; did you mean --models {models},{path}?")
    experiment = Experiment.of({**settings, "data": resolved(data), "stop_after": "fit"}, as_option)
    run_experiment(experiment, folder, jobs=jobs, scheduler=scheduler, dry_run=dry_run, as_json=as_json, verbose=False)


def run_experiment(
    experiment: Experiment, folder: Path | None, *, jobs: int | None, scheduler: str | None, dry_run: bool,
    as_json: bool, verbose: bool,
) -> None:  # fmt: skip
    """Plan an experiment, compute its missing cells, and print the results."""
    path = evaluation.check_run_folder(folder)
    comparison, remarks = evaluation.plan_run(experiment, path)
    store = sysid_evo.plan.Store(path)
    for remark in remarks:
        note(remark)
    if dry_run:
        print_plan(comparison.plan, store, as_json=as_json)
        return
    session.run = store
    store_experiment(comparison, path)
    go_on = f"--out {shlex.quote(str(path))}"

    def compute(plan: sysid_evo.plan.Plan) -> dict[str, Any]:
        with PlanProgress(go_on, cells=plan, elsewhere=scheduler is not None) as bars:
            return sysid_evo.plan.execute(plan, store, observer=bars, jobs=jobs, scheduler=scheduler)

    if experiment.chooses_families:
        comparison = evaluation.with_further_families(comparison, store, compute)
        comparison.experiment.write(path / FILE)
    outcomes = compute(comparison.plan)
    failed = [cell for cell in comparison.plan if outcomes[cell.digest].failed]
    count = sum(store.find(cell.digest) is not None for cell in failed)  # the others depend on these
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
        console.print_error(error)
    if failed:
        print_status(f"{count} {'step' if count == 1 else 'steps'}; see {path / 'log.jsonl'}", label="failed: ")
    if failed or empty:
        raise typer.Exit(SOME_FAILED)


def store_experiment(comparison: evaluation.Comparison, path: Path) -> None:
    """Write ``experiment.toml``; report the settings that differ from an earlier one."""
    file = path / FILE
    wanted = comparison.experiment.model_dump(mode="json", exclude_none=True)
    if file.is_file():
        found = Experiment.of(Experiment.read(file)).model_dump(mode="json", exclude_none=True)
        print_differences(file, found, wanted)
    comparison.experiment.write(file)


def print_differences(file: Path, found: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """Report the settings in which the replaced ``file`` differs."""
    differing = sorted(key for key in {*found, *wanted} if found.get(key) != wanted.get(key))
    if differing:
        changes = [_change(key, found.get(key), wanted.get(key)) for key in differing if key != "data_digest"]
        note(f"{file} had other settings: {'; '.join(changes) or 'other recordings'}. Results that both need are kept")


LONGEST_VALUE = 60
"""Characters of a setting in a note."""


def _change(key: str, before: object, after: object) -> str:
    """Return both values of a setting, without the parameters of names if the names differ."""
    texts = ["default" if value is None else ",".join(map(str, value)) if isinstance(value, list) else str(value)
             for value in (before, after)]  # fmt: skip
    names = [re.sub(r"\([^()]*\)", "", text) for text in texts]
    first, second = ((text or "none")[:LONGEST_VALUE] for text in (texts if names[0] == names[1] else names))
    return f"{key.replace('_', ' ')} {first}, now {second}"


def print_report(
    report: evaluation.ComparisonResults, path: Path, *, as_json: bool, verbose: bool, written: bool = True
) -> None:
    """Print the answers, the short table, and the path of the report."""
    if as_json:
        out.print_json(data=evaluation.to_json(report))
        return
    for part in evaluation.tables(report) if verbose else evaluation.brief(report, folder=path):
        out.print(part, crop=False)
    console.err.print(where_time_went(report.timings), highlight=False)
    if written:
        print_line(f"Report: {path / 'report.html'}")


def print_fits(
    comparison: evaluation.Comparison, store: sysid_evo.plan.Store, outcomes: Mapping[str, sysid_evo.plan.CellOutcome],
    *, as_json: bool,
) -> None:  # fmt: skip
    """Print error, file or reason of failure of each model, and the advice on the best one."""
    advice = store.outcome(comparison.advice).value
    rows: list[dict[str, Any]] = []
    for label, cell in comparison.fits.items():
        outcome, score = outcomes[cell.digest], store.outcome(comparison.held_out_scores[label]).value
        rows.append({
            "model": label, "error": None if score is None else score.n,
            "steps": None if score is None else score.steps,
            "evaluated_on": None if score is None else score.evaluated_on, "seconds": round(outcome.seconds, 1),
            "file": None if outcome.failed else f"{store.result_path(cell)}.json", "reason": outcome.reason,
            "advice": evaluation.plain(advice) if advice is not None and advice.model == label else None,
            "note": "" if outcome.failed else store.load(cell).fit_note,
        })  # fmt: skip
    if as_json:
        out.print_json(data=rows)
        return
    table = table_of("model", "error N", "seconds", "stored as", numbers=("error N", "seconds"))
    for row in rows:
        where = str(row["file"] or f"failed: {row['reason']}")
        table.add_row(str(row["model"]), evaluation.three_digits(row["error"]), str(row["seconds"]), where)
    out.print(table)
    print_held_out_scores(comparison, store)
    for row in rows:
        if row["note"]:
            out.print(Text(f"{row['model']} {row['note']}"))
    for part in [] if advice is None else evaluation.advice_lines(advice):
        out.print(part)
    labels = ",".join(str(row["model"]) for row in rows if row["file"])
    if labels and not store.load(comparison.data).training.system.advance:
        command = shlex.join(["sysid-evo", "evolve", "--run", str(store.path), "--against", labels])
        print_status(f"evolve controllers on them with: {command}")


def print_held_out_scores(comparison: evaluation.Comparison, store: sysid_evo.plan.Store) -> None:
    """Print the data on which the errors were measured, and whether they suffice to compare models."""
    found = {label: score for label, cell in comparison.held_out_scores.items() if (score := store.outcome(cell).value)}
    grouped: dict[tuple[int | None, str], list[str]] = {}
    for label, score in found.items():
        grouped.setdefault((score.steps, score.evaluated_on), []).append(label)
    dt = store.outcome(comparison.data).value.training.system.dt
    for (steps, evaluated_on), labels in grouped.items():
        which = f" ({', '.join(labels)})" if len(grouped) > 1 else ""
        if steps is None:
            out.print(Text(f"the error of {', '.join(labels)} cannot be measured: {evaluated_on}"))
            continue
        over = "after" if found[labels[0]].blocks is not None else "over the first"
        sentence = f"mean error {over} {evaluation.horizon_name(steps, dt)} on {evaluated_on}, in standard deviations"
        out.print(Text(f"error N{which}: {sentence}; a model with N of 1 or more is useless"))
    for score in found.values():
        if score.warning:
            note(score.warning)
    blocks = [score.blocks for score in found.values() if score.blocks is not None]
    if blocks and not evaluation.enough_blocks(min(blocks)):
        note(f"only {min(blocks)} blocks of test data, too few to compare models; record more")


def where_time_went(timings: Mapping[str, float]) -> str:
    """Return the computing time of each kind of cell, the longest first."""
    kinds: dict[str, float] = {}
    for cell, taken in timings.items():
        kind = cell.split(" ", 1)[0]
        kinds[kind] = kinds.get(kind, 0.0) + taken
    parts = [f"{kind} {taken:.1f} s" for kind, taken in sorted(kinds.items(), key=lambda item: -item[1])]
    return f"Computing time {sum(kinds.values()):.1f} s: {', '.join(parts)}"


def report(
    run: Annotated[Path, argument("Run folder", "RUN", values=run_folders)],
    as_json: options.Json = False, verbose: options.Verbose = False,
    formats: Annotated[list[str] | None, option("Also write markdown or svg (figures); repeatable", "NAME", "--format",
        values=lambda: evaluation.FORMATS)] = None,
    plugin: options.Plugins = None,
) -> None:  # fmt: skip
    """Rebuild the report of a run; nothing is computed again."""
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
        note(f"{run} cannot be written, so the report is only printed: {error.strerror}")
    if made is None:
        raise InvalidData(f"{run} has no fitted model yet, so there is nothing to report; resume it first")
    print_report(made, run, as_json=as_json, verbose=verbose, written=written)
    for name in formats or ():
        files = evaluation.write_format(evaluation.story_of(made), name, run)
        if files:  # one without figures has none as svg
            print_status(str(files[0].parent if name == "svg" else files[0]), label=f"{name}: ", style="dim")


def study(
    file: Annotated[Path, argument("File of the study, or the folder of one", "STUDY")],
    folder: Annotated[Path | None, option("Folder of the study", "DIR", "--out", shown="runs/NAME of the file",
        values=run_folders)] = None,
    jobs: options.Jobs = None, scheduler: options.Scheduler = None, dry_run: options.DryRun = False,
    render: Annotated[bool, option("Compute nothing: show the results so far and list the missing ones", "",
        "--render")] = False,
    plugin: options.Plugins = None, as_json: options.Json = False, verbose: options.Verbose = False,
) -> None:  # fmt: skip
    """Run a grid of comparisons over robots, seeds and settings.

    Prints tables with intervals; writes Markdown, Parquet and a page. Results that several points share are computed
    once. To resume an interrupted study or to add points, repeat the command.
    """
    load_plugins(plugin)
    found = evaluation.Study.read(file)
    if plugin:
        named = found.experiment.get("plugins", ())
        found = found.with_plugins(tuple(dict.fromkeys((*named, *resolved(plugin)))))
    path = (
        evaluation.check_run_folder(file) if file.is_dir() and folder is None else evaluation.study_folder(folder, file)
    )
    if render and not path.is_dir():
        raise InvalidArgument(f"--render: expected the folder of a study, found none at {path}")
    planned = evaluation.plan_study(found)
    store = sysid_evo.plan.Store(path)
    for remark in planned.plan.remarks:
        note(remark)
    if dry_run:
        print_points(planned, store, as_json=as_json)
        return
    session.run = store
    if not render:
        there = path / evaluation.STUDY_FILE
        if there.is_file():
            print_differences(there, evaluation.Study.read(there).settings, planned.study.settings)
        planned.study.write(there)
        go_on, elsewhere = f"--out {shlex.quote(str(path))}", scheduler is not None
        with PlanProgress(go_on, cells=planned.plan, where=planned.where, elsewhere=elsewhere) as bars:
            sysid_evo.plan.execute(planned.plan, store, observer=bars, jobs=jobs, scheduler=scheduler)
    results = evaluation.write_study(planned, path)
    print_study(results, path, as_json=as_json, verbose=verbose)
    if results.failures:
        print_status(
            f"{len(results.failures)} of {len(planned.plan)} steps failed, see {path / 'log.jsonl'}", label="failed: "
        )
        raise typer.Exit(SOME_FAILED)


def print_study(results: evaluation.StudyResults, path: Path, *, as_json: bool, verbose: bool) -> None:
    """Print the answers, the short table, and the paths of the others."""
    if as_json:
        out.print_json(data=evaluation.study_document(results))
        return
    for part in evaluation.study_brief(results, verbose=verbose):
        out.print(part)
    print_line(f"Tables: {path / 'study.md'}")
    print_line(f"Page: {path / 'study.html'}")


def print_points(planned: evaluation.PlannedStudy, store: sysid_evo.plan.Store, *, as_json: bool) -> None:
    """Print the points, how many of their cells are done, and the expected time of the others on one processor."""
    records = {cell.digest: store.find(cell.digest) for cell in planned.plan}
    about = evaluation.seconds_about(planned, records)
    done = {digest for digest, record in records.items() if record is not None and record.status == "done"}
    rows: list[dict[str, Any]] = []
    seen: set[str] = set()
    for point, comparison in planned.points:
        own = [cell.digest for cell in comparison.plan]
        new = [digest for digest in own if digest not in seen and digest not in done]
        seen |= set(own)
        kept, seconds = sum(digest in done for digest in own), round(sum(about[digest] for digest in new), 1)
        rows.append({"point": point.name, "cells": len(own), "kept": kept, "seconds": seconds})
    total = sum(about[digest] for digest in about if digest not in done)
    if as_json:
        document = {"points": rows, "cells": len(records), "kept": len(done), "seconds": round(total, 1)}
        out.print_json(data={**document, "remarks": list(planned.plan.remarks)})
        return
    table = table_of("point", "cells", "kept", "about", numbers=("cells", "kept", "about"))
    for row in rows:
        table.add_row(row["point"], str(row["cells"]), str(row["kept"]), duration(row["seconds"]))
    out.print(table)
    sentence = f"{len(rows)} points, {len(records)} cells, {len(done)} kept, about {duration(total)} on one processor"
    out.print(sentence, highlight=False)
