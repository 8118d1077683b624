"""`sysid-evo report`: the report of a run, made again of what the run holds."""

from __future__ import annotations

import json as json_format
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sysid_evo.cli.console import out, session, tell
from sysid_evo.cli.options import Json

if TYPE_CHECKING:
    from evaluation.comparison import Comparison
    from evaluation.report import Report
    from sysid_evo.errors import InvalidData


def report(
    runs: Annotated[list[Path], typer.Argument(help="Run folder, or two to be shown side by side.")],
    json: Json = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="Print every table of the report.")] = False,
    formats: Annotated[
        list[str] | None,
        typer.Option("--format", help="Write it as markdown, latex (tables) or svg (figures), too; repeatable."),
    ] = None,
) -> None:
    """Make the report of a run again, of what is there, or compare two: nothing is fitted, evolved or driven."""
    from evaluation.report.formats import FORMATS, write_format
    from sysid_evo.cli.comparing import print_report
    from sysid_evo.errors import InvalidArgument

    if len(runs) > 2:
        raise InvalidArgument(f"report: expected one run folder, or two, got {len(runs)}")
    for name in formats or ():
        if name not in FORMATS:
            raise InvalidArgument(f"--format: expected one of {', '.join(FORMATS)}, got {name!r}")

    if len(runs) == 2:
        _side_by_side(runs[0], runs[1], json=json, formats=formats or ())
        return
    run = runs[0]
    made = report_again(run)
    if made is None:
        raise _nothing_yet(run)
    print_report(made, run, json=json, verbose=verbose)
    for name in formats or ():
        _written(name, write_format(made, name, run))


def _written(name: str, files: Sequence[Path]) -> None:
    """Say where a form of a report stands; one without figures has none as svg."""
    if files:
        tell(str(files[0].parent if name == "svg" else files[0]), label=f"{name}: ", style="dim")


def _side_by_side(first: Path, second: Path, *, json: bool, formats: Sequence[str]) -> None:
    """Print in what two runs differ, and write the page and other forms into the second one."""
    from evaluation.report.formats import write_format
    from evaluation.report.two_runs import differences, save_comparison, stem, terminal, to_json, two_stories

    found = differences(report_of(first), report_of(second), names_of(first, second))
    page = save_comparison(found, second)
    for name in formats:
        _written(name, write_format(two_stories(found), name, second, stem=stem(found)))
    if json:
        out.print_json(json_format.dumps(to_json(found)))
        return
    for part in terminal(found):
        out.print(part)
    out.print(f"Page: {page}", highlight=False, soft_wrap=True)


def names_of(first: Path, second: Path) -> tuple[str, str]:
    """Return the names of two run folders, as long as it takes to tell them apart."""
    here, there = first.resolve().parts, second.resolve().parts
    for count in range(1, max(len(here), len(there)) + 1):
        names = "/".join(here[-count:]), "/".join(there[-count:])
        if names[0] != names[1]:
            return names
    return f"{first} (first)", f"{second} (second)"


def report_of(run: Path) -> Report:
    """Return the report of what a run holds; nothing is written. Raises `InvalidData` without a model."""
    from evaluation.report import Report
    from sysid_evo.plan import Store

    comparison, remarks = comparison_of(run)
    for remark in remarks:
        tell(remark, label="note: ", style="dim")
    store = Store(run)
    if not any(store.done(fit) for fit in comparison.fits.values()):
        raise _nothing_yet(run)
    return Report.of(comparison, store)


def _nothing_yet(run: Path) -> InvalidData:
    from sysid_evo.errors import InvalidData

    return InvalidData(f"{run} holds no fitted model yet, so there is nothing to report: go on with it first")


def report_again(run: Path) -> Report | None:
    """Write the report of a run anew, with the cells measured since; None if the run has no model yet.

    Raises `InvalidArgument` if ``run`` is no comparison's run.
    """
    from evaluation.comparison import finished
    from sysid_evo.plan import Plan, Store, execute
    from sysid_evo.plan.store import WAITING

    comparison, remarks = comparison_of(run)
    session.run = run
    store = Store(run)
    for remark in remarks:
        tell(remark, label="note: ", style="dim")
    if not any(store.done(fit) for fit in comparison.fits.values()):
        return None
    for assess in (*comparison.predictions.values(), comparison.exploitability, comparison.advice):
        if assess is not None:
            tried = {cell.digest for cell in comparison.plan if store.outcome(cell).reason != WAITING}
            if all(needed.digest in tried for needed in assess.needs):
                execute(Plan.of([assess]), store, only=[assess])
    return finished(comparison, store, afresh=True)


def comparison_of(run: Path) -> tuple[Comparison, tuple[str, ...]]:
    """Return the comparison that a run folder holds, and remarks; its data are those in the folder.

    Raises `InvalidArgument` if it is no run, `ArtefactError` if its data are missing or damaged.
    """
    from evaluation.comparison import Experiment, comparison_again

    comparison, damaged = comparison_again(Experiment.of(Experiment.read(run)), run)
    return comparison, (*comparison.plan.remarks, *damaged)
