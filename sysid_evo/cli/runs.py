"""Runs list, runs show, runs diff, runs clean: run folders."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.text import Text

import evaluation
from sysid_evo.cli.console import note, out, say, table_of, tell
from sysid_evo.cli.options import Json
from sysid_evo.errors import ArtefactError

app = typer.Typer(help="Run folders and what they hold.", no_args_is_help=True)

RUNS = Path("runs")


@app.command("list")
def list_runs(
    folder: Annotated[Path, typer.Argument(help="Folder of run folders.")] = RUNS, as_json: Json = False
) -> None:
    """List the runs in a folder, the oldest first."""
    rows = [evaluation.summary_of_run(run) for run in evaluation.runs_in(folder)]
    if as_json:
        out.print_json(data=rows)
        return
    if not rows:
        tell(f"no runs in {folder}")
        return
    table = table_of("run", "done", "failed", "s", "models", numbers=("done", "failed", "s"))
    for row in rows:
        seconds = f"{row['seconds']:.0f}"
        table.add_row(row["run"], str(row["done"]), str(row["failed"]), seconds, ", ".join(row["models"]))
    out.print(table)


@app.command("show")
def show(run: Annotated[Path, typer.Argument(help="Run folder.")], as_json: Json = False) -> None:
    """Show the cells of a run: how each ended, how long it took, where its result is."""
    store = evaluation.store_of_run(run)
    records = store.records()
    if as_json:
        out.print_json(data=[record.model_dump(mode="json") for record in records])
        return
    table = table_of("cell", "s", "result", numbers=("s",))
    for record in records:
        where = Text(record.artefact) if record.status == "done" else Text(f"failed: {record.reason}", style="red")
        table.add_row(record.title, f"{record.seconds:.1f}", where)
    out.print(table)
    for remark in store.remarks:
        note(remark)


@app.command("diff")
def diff(
    first: Annotated[Path, typer.Argument(help="Run folder.")],
    second: Annotated[Path, typer.Argument(help="Run folder.")],
    as_json: Json = False,
) -> None:
    """Show the settings that differ between two runs and the main figures of both; --json also names the cells."""
    settings, figures = zip(*((evaluation.settings_of_run(run), _figures(run)) for run in (first, second)), strict=True)
    stores = [evaluation.store_of_run(run) for run in (first, second)]
    cells = [{record.digest: record.title for record in store.records()} for store in stores]
    changed = _beside(settings, only_changed=True)
    alone = [[title for digest, title in here.items() if digest not in there] for here, there in (cells, cells[::-1])]
    known = _beside(figures)
    if as_json:
        document = {"settings": changed, "only_first": alone[0], "only_second": alone[1], "figures": known}
        out.print_json(data=document)
        return
    for run, found in zip((first, second), figures, strict=True):
        if not found:
            note(f"{run} has no report yet, so it has no figures")
    if not changed and not any(alone) and figures[0] == figures[1]:
        out.print("no difference")
        return
    table = table_of("", str(first), str(second), whole=("",))
    for key, values in changed.items():
        table.add_row(key, *("-" if value is None else str(value) for value in values))
    for key, values in known.items():
        table.add_row(key, *("-" if value is None else f"{value:.4g}" for value in values))
    table.add_row("cells only this run has", *(str(len(titles)) for titles in alone))
    out.print(table)


@app.command("clean")
def clean(
    run: Annotated[Path, typer.Argument(help="Run folder.")],
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what would go.")] = False,
) -> None:
    """Remove what no finished cell needs: failed cells, damaged records, files that nobody names any more."""
    unneeded = evaluation.unneeded_files(run)
    size = sum(file.stat().st_size for file in unneeded)
    for file in unneeded:
        if dry_run:
            say(str(file.relative_to(run)))
        else:
            file.unlink(missing_ok=True)
    verb = "would go" if dry_run else "removed"
    out.print(f"{len(unneeded)} files {verb}, {size / 2**20:.1f} MiB", highlight=False)


def _figures(run: Path) -> dict[str, float | None]:
    """Return the error N of every model, and what every controller claims and achieves, from a run's report."""
    file = run / "report.json"
    if not file.is_file():
        return {}
    try:
        return _figures_in(json.loads(file.read_text(encoding="utf-8")))
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ArtefactError(f"{file}: not a readable report: make it again with sysid-evo report {run}") from error


def _figures_in(report: dict[str, Any]) -> dict[str, float | None]:
    found: dict[str, float | None] = {}
    for model in (report["prediction"] or {"models": []})["models"]:
        scores = {score["steps"]: score for score in model["horizons"]}
        near = scores.get(evaluation.main_horizon(list(scores), report["data"]["system"]["dt"]))
        if near and model["name"] != evaluation.PERSISTENCE:
            found[f"N at {near['seconds']:g} s, {model['name']}"] = near["n"]
    controllers = (report["controllers"] or {"controllers": []})["controllers"]
    for one in controllers:
        for figure in ("claimed", "achieved"):
            if one[figure] is not None:
                found[f"{one['name']}: {figure}"] = one[figure]["value"]
    return found


def _beside(sides: Sequence[dict[str, Any]], *, only_changed: bool = False) -> dict[str, list[Any]]:
    """Return what two runs have under each name, None where one of them has nothing."""
    both = {key: [side.get(key) for side in sides] for key in sorted({*sides[0], *sides[1]})}
    return {key: values for key, values in both.items() if not only_changed or values[0] != values[1]}
