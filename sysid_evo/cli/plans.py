"""A plan that a command made: carried out in its run folder, or only shown."""

from __future__ import annotations

import json as json_format
import shlex
from collections.abc import Mapping
from typing import TYPE_CHECKING

from sysid_evo.cli.console import out, session

if TYPE_CHECKING:
    from sysid_evo.plan import Outcome, Plan, Store


def carry_out(
    plan: Plan, store: Store, *, dry_run: bool, json: bool, jobs: int | None = None, scheduler: str | None = None
) -> Mapping[str, Outcome] | None:
    """Compute what is missing of ``plan`` and return the outcome of every cell by its digest.

    With ``dry_run`` print what would be computed instead, and return None.
    """
    from sysid_evo.cli.progress import Bars
    from sysid_evo.plan import execute

    if dry_run:
        print_plan(plan, store, json=json)
        return None
    session.run = store.path
    with Bars(f"--run {shlex.quote(str(store.path))}", elsewhere=scheduler is not None) as bars:
        return execute(plan, store, observer=bars, jobs=jobs, scheduler=scheduler)


def print_plan(plan: Plan, store: Store, *, json: bool) -> None:
    """Print the cells, about how long they take, and which are done."""
    from rich.table import Table

    done = {cell.digest for cell in plan if store.done(cell)}
    rows = [(cell.title, 0.0 if cell.digest in done else cell.seconds(), cell.digest in done) for cell in plan]
    total = sum(seconds for _, seconds, _ in rows)
    if json:
        cells = [{"cell": title, "seconds": round(seconds, 1), "kept": kept} for title, seconds, kept in rows]
        document = {"cells": cells, "seconds": round(total, 1), "remarks": list(plan.remarks)}
        out.print_json(json_format.dumps(document))
        return
    table = Table(box=None, pad_edge=False)
    table.add_column("cell", overflow="fold")
    table.add_column("about", justify="right", no_wrap=True)
    for title, about, kept in rows:
        table.add_row(title, "kept" if kept else f"{about:.1f} s")
    out.print(table)
    out.print(f"{len(rows)} cells, {len(done)} kept, about {total:.0f} s", highlight=False)
