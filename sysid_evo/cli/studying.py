"""`sysid-evo study`: a grid of comparisons as one plan, and what it says over robots and seeds."""

from __future__ import annotations

import json as json_format
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sysid_evo.cli.console import out, session, tell
from sysid_evo.cli.exits import SOME_FAILED
from sysid_evo.cli.options import DryRun, Jobs, Json, Scheduler

if TYPE_CHECKING:
    from evaluation.study import PlannedStudy, StudyResults
    from sysid_evo.plan import Record, Store


def study(
    file: Annotated[Path, typer.Argument(help="The study, STUDY.toml, or the folder of one.")],
    folder: Annotated[
        Path | None, typer.Option("--out", help="Folder of the study (default runs/NAME of the file).")
    ] = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    dry_run: DryRun = False,
    render: Annotated[
        bool, typer.Option("--render", help="Compute nothing: show what is there, and say what is missing.")
    ] = False,
    json: Json = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="Print every table.")] = False,
) -> None:
    """Compare over a grid of robots, seeds and settings: tables with intervals, Parquet, a page.

    What two points share is computed once. Interrupted, it goes on with the same command; a point that is added later
    computes only what is new.
    """
    from evaluation.comparison import check_run_folder
    from evaluation.study import FILE, Study, finish, plan_study, study_folder
    from sysid_evo.cli.progress import Bars
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.plan import Store, execute

    found = Study.read(file)
    path = check_run_folder(file) if file.is_dir() and folder is None else study_folder(folder, file)
    if render and not path.is_dir():
        raise InvalidArgument(f"--render: expected the folder of a study, found none at {path}")
    planned = plan_study(found)
    store = Store(path)
    for remark in planned.plan.remarks:
        tell(remark, label="note: ", style="dim")
    if dry_run:
        print_points(planned, store, json=json)
        return
    session.run = path
    if not render:
        found.write(path / FILE)
        with Bars(f"--out {shlex.quote(str(path))}", where=planned.where, elsewhere=scheduler is not None) as bars:
            execute(planned.plan, store, observer=bars, jobs=jobs, scheduler=scheduler)
    results = finish(planned, path)
    print_study(results, path, json=json, verbose=verbose)
    if results.failures:
        tell(f"{len(results.failures)} of {len(planned.plan)} cells failed, see {path / 'log.jsonl'}", label="failed: ")
        raise typer.Exit(SOME_FAILED)


def print_study(results: StudyResults, path: Path, *, json: bool, verbose: bool) -> None:
    """Print the answers, the short table, and where the rest is."""
    from evaluation.report.study import study_brief, study_document

    if json:
        out.print_json(json_format.dumps(study_document(results)))
        return
    for part in study_brief(results, verbose=verbose):
        out.print(part)
    out.print(f"Tables: {path / 'study.md'}", highlight=False, soft_wrap=True)
    out.print(f"Page: {path / 'study.html'}", highlight=False, soft_wrap=True)


def print_points(planned: PlannedStudy, store: Store, *, json: bool) -> None:
    """Print the points, how many cells of each are done, and about how long the others take on one processor."""
    from rich.table import Table

    records = {cell.digest: store.find(cell.digest) for cell in planned.plan}
    about = seconds_about(planned, records)
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
    if json:
        document = {"points": rows, "cells": len(records), "kept": len(done), "seconds": round(total, 1)}
        out.print_json(json_format.dumps({**document, "remarks": list(planned.plan.remarks)}))
        return
    table = Table(box=None, pad_edge=False)
    for heading in ("point", "cells", "kept", "about"):
        table.add_column(heading, justify="left" if heading == "point" else "right", overflow="fold")
    for row in rows:
        table.add_row(row["point"], str(row["cells"]), str(row["kept"]), duration(row["seconds"]))
    out.print(table)
    sentence = f"{len(rows)} points, {len(records)} cells, {len(done)} kept, about {duration(total)} of one processor"
    out.print(sentence, highlight=False)


def seconds_about(planned: PlannedStudy, records: Mapping[str, Record | None]) -> dict[str, float]:
    """Return about how long each cell takes, by digest: what it foresees, corrected by what its kind took here."""
    took: dict[str, float] = {}
    foreseen: dict[str, float] = {}
    for cell in planned.plan:
        record = records[cell.digest]
        if record is not None and record.status == "done":
            took[cell.kind] = took.get(cell.kind, 0.0) + record.seconds
            foreseen[cell.kind] = foreseen.get(cell.kind, 0.0) + cell.seconds()
    ratio = {kind: took[kind] / expected for kind, expected in foreseen.items() if expected > 0.0}
    return {cell.digest: cell.seconds() * ratio.get(cell.kind, 1.0) for cell in planned.plan}


def duration(seconds: float) -> str:
    """Return a time in the unit that fits."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
