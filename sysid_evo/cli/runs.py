"""Runs list, runs show, runs diff, runs clean: run folders, and the reports in them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from rich.text import Text

import evaluation
import sysid_evo.plan
from sysid_evo.cli.console import note, out, print_line, print_status, session, table_of
from sysid_evo.cli.options import RUNS, Json, argument, option, run_folders
from sysid_evo.errors import PluginError

Folder = Annotated[Path, argument("Run folder", "RUN", values=run_folders)]


def list_runs(
    folder: Annotated[Path, argument("Folder of run folders", "FOLDER", shown=str(RUNS))] = RUNS,
    as_json: Json = False,
) -> None:  # fmt: skip
    """List the runs in a folder, the oldest first."""
    rows = [evaluation.summary_of_run(run) for run in evaluation.runs_in(folder)]
    if as_json:
        out.print_json(data=rows)
        return
    if not rows:
        print_status(f"no runs in {folder}")
        return
    table = table_of("run", "done", "failed", "s", "models", numbers=("done", "failed", "s"))
    for row in rows:
        seconds = f"{row['seconds']:.0f}"
        table.add_row(row["run"], str(row["done"]), str(row["failed"]), seconds, ", ".join(row["models"]))
    out.print(table)


def show(run: Folder, as_json: Json = False) -> None:
    """Show the steps of a run: result, time and file of each."""
    store = evaluation.store_of_run(run)
    records = store.records()
    if as_json:
        out.print_json(data=[record.model_dump(mode="json") for record in records])
        return
    table = table_of("step", "s", "result", numbers=("s",))
    for record in records:
        where = Text(record.artefact) if record.status == "done" else Text(f"failed: {record.reason}", style="red")
        table.add_row(record.title, f"{record.seconds:.1f}", where)
    out.print(table)
    for remark in store.remarks:
        note(remark)


def diff(
    first: Annotated[Path, argument("Run folder", "FIRST", values=run_folders)],
    second: Annotated[Path, argument("Run folder", "SECOND", values=run_folders)],
    as_json: Json = False,
) -> None:  # fmt: skip
    """Show the settings and main results that differ between two runs.

    With --json also the steps that only one of them has.
    """
    settings, figures = zip(*((evaluation.settings_of_run(run), _figures(run)) for run in (first, second)), strict=True)
    stores = [evaluation.store_of_run(run) for run in (first, second)]
    cells = [{record.digest: record.title for record in store.records()} for store in stores]
    changed = _paired(settings, only_changed=True)
    alone = [[title for digest, title in here.items() if digest not in there] for here, there in (cells, cells[::-1])]
    known = _paired(figures)
    if as_json:
        document = {"settings": changed, "only_first": alone[0], "only_second": alone[1], "figures": known}
        out.print_json(data=document)
        return
    for run, found in zip((first, second), figures, strict=True):
        if not found:
            note(f"{run} has no report yet, so it has no results to compare")
    if not changed and not any(alone) and figures[0] == figures[1]:
        out.print("no difference")
        return
    table = table_of("", str(first), str(second), whole=("",))
    for key, values in changed.items():
        table.add_row(key, *("-" if value is None else str(value) for value in values))
    for key, values in known.items():
        table.add_row(key, *("-" if value is None else f"{value:.4g}" for value in values))
    table.add_row("steps of this run only", *(str(len(titles)) for titles in alone))
    out.print(table)


def clean(
    run: Folder,
    dry_run: Annotated[bool, option("List the files without removing them", "", "--dry-run")] = False,
) -> None:  # fmt: skip
    """Remove failed steps, damaged records and unused files."""
    unneeded = evaluation.unneeded_files(run)
    size = sum(file.stat().st_size for file in unneeded)
    for file in unneeded:
        if dry_run:
            print_line(str(file.relative_to(run)))
        else:
            file.unlink(missing_ok=True)
    verb = "would be removed" if dry_run else "removed"
    out.print(f"{len(unneeded)} files {verb}, {size / 2**20:.1f} MiB", highlight=False)


def add_measured(folder: Path, measured: evaluation.MeasuredResult) -> None:
    """Store the fitness of a driven robot or model in a run, and rebuild the report if the run has one."""
    evaluation.save_measured(folder, measured)
    try:
        made = report_again(folder) if (folder / "experiment.toml").is_file() else None
    except PluginError as error:  # the measurement is stored nevertheless
        print_status(f"stored in {folder}; its report is not updated: {error}")
        return
    if made is not None:
        shown = folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder
        print_line(f"Report: {shown / 'report.html'}")
    else:
        print_status(f"stored in {folder}, which has no report (compare makes one)")


def report_again(run: Path, *, written: bool = True) -> evaluation.ComparisonResults | None:
    """Rebuild the report of a run with the fitness measured since; None if the run has no model yet.

    Raises `InvalidArgument` if ``run`` is not the run of a comparison.
    """
    comparison, remarks = evaluation.comparison_of(run)
    store = session.run = sysid_evo.plan.Store(run)
    for remark in remarks if written else ():  # otherwise the first attempt printed them
        note(remark)
    return evaluation.report_again(comparison, store, written=written)


def _figures(run: Path) -> dict[str, float | None]:
    """Return the error N of each model and the fitness of each controller, claimed and achieved, from a report."""
    if not (run / "report.json").is_file():
        return {}
    report = evaluation.load_report(run)
    found: dict[str, float | None] = {}
    for model in () if report.prediction is None else report.prediction.models:
        scores = {score.steps: score for score in model.scores}
        steps = [steps for steps in scores if steps is not None]
        near = scores.get(evaluation.main_horizon(steps, report.data.system.dt))
        if near and model.name != evaluation.PERSISTENCE:
            found[f"N at {near.seconds:g} s, {model.name}"] = near.n
    for one in () if report.controllers is None else report.controllers.controllers:
        for figure, estimate in (("claimed", one.claimed), ("achieved", one.achieved)):
            if estimate is not None:
                found[f"{one.name}: {figure}"] = estimate.value
    return found


def _paired(sides: Sequence[dict[str, Any]], *, only_changed: bool = False) -> dict[str, list[Any]]:
    """Return the values of two runs by name, None where one has none."""
    both = {key: [side.get(key) for side in sides] for key in sorted({*sides[0], *sides[1]})}
    return {key: values for key, values in both.items() if not only_changed or values[0] != values[1]}
