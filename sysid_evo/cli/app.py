"""The commands, and what happens when one fails."""

from __future__ import annotations

import os
import sys
import warnings
from typing import Annotated

import typer

from sysid_evo.cli import (
    adapting,
    comparing,
    driving,
    evolving,
    exploiting,
    exporting,
    models,
    names,
    plugins,
    recordings,
    reporting,
    robots,
    runs,
    studying,
    transferring,
    tuning,
)
from sysid_evo.cli.console import complain, err, out, session, tell
from sysid_evo.cli.exits import EXIT_CODES, code_of
from sysid_evo.errors import SysidEvoError
from sysid_evo.processors import INNER_THREADS
from sysid_evo.version import __version__

ANYWHERE = ("--debug", "--quiet")
"""Options of the whole program, which may stand behind a command, too."""

app = typer.Typer(
    name="sysid-evo",
    help="Identify models of a robot, evolve controllers in them, and see which still work on the robot.\n\n"
    + EXIT_CODES,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)
app.command("compare")(comparing.compare)
app.command("study")(studying.study)
app.command("import")(recordings.import_)
app.command("inspect")(recordings.inspect)
app.command("record")(recordings.record)
app.command("fit")(models.fit)
app.command("tune")(tuning.tune)
app.command("adapt")(adapting.adapt)
app.command("evolve")(evolving.evolve)
app.command("exploit")(exploiting.exploit)
app.command("transfer")(transferring.transfer)
app.command("drive")(driving.drive)
app.command("export")(exporting.export)
app.command("report")(reporting.report)
app.command("names")(names.list_names)
app.add_typer(runs.app, name="runs")
app.add_typer(models.app, name="models")
app.add_typer(plugins.app, name="plugin")
app.add_typer(robots.app, name="robots")


def _print_version(wanted: bool) -> None:
    if wanted:
        out.print(f"sysid-evo {__version__}", highlight=False)
        raise typer.Exit


@app.callback()
def _options(
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print results and errors only.")] = False,
    _version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    session.debug = debug
    err.quiet = quiet


def main() -> None:
    """Run the command line; an error of this library is one message, not a traceback."""
    warnings.showwarning = _show_warning
    for name in INNER_THREADS:
        os.environ.setdefault(name, "1")
    arguments = sys.argv[1:]
    end = arguments.index("--") if "--" in arguments else len(arguments)
    first = [argument for argument in arguments[:end] if argument in ANYWHERE]
    rest = [argument for argument in arguments[:end] if argument not in ANYWHERE]
    try:
        app(args=[*first, *rest, *arguments[end:]], standalone_mode=True)
    except (SysidEvoError, OSError) as error:
        complain(error)
        sys.exit(code_of(error))


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    tell(str(message), label="warning: ", style="yellow")
