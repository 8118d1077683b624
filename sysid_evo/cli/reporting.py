"""`sysid-evo report`: the report of a run, made again of what the run holds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sysid_evo.cli.console import session, tell
from sysid_evo.cli.options import Json

if TYPE_CHECKING:
    from evaluation.comparison import Comparison
    from evaluation.report import Report


def report(
    run: Annotated[Path, typer.Argument(help="Run folder.")],
    json: Json = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="Print every table of the report.")] = False,
    formats: Annotated[
        list[str] | None,
        typer.Option("--format", help="Write it as markdown or svg (figures), too; repeatable."),
    ] = None,
) -> None:
    """Make the report of a run again, of what is there: nothing is fitted, evolved or driven."""
    from evaluation.report.formats import FORMATS, write_format
    from sysid_evo.cli.comparing import print_report
    from sysid_evo.errors import InvalidArgument, InvalidData

    for name in formats or ():
        if name not in FORMATS:
            raise InvalidArgument(f"--format: expected one of {', '.join(FORMATS)}, got {name!r}")

    made = report_again(run)
    if made is None:
        raise InvalidData(f"{run} holds no fitted model yet, so there is nothing to report: go on with it first")
    print_report(made, run, json=json, verbose=verbose)
    for name in formats or ():
        if files := write_format(made, name, run):  # one without figures has none as svg
            tell(str(files[0].parent if name == "svg" else files[0]), label=f"{name}: ", style="dim")


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
