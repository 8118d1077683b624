"""The commands, and what happens when one fails."""

from __future__ import annotations

import os
import sys
import warnings
from typing import Annotated

import typer

from sysid_evo.cli import controllers, experiments, models, plugins, recordings, robots, runs
from sysid_evo.cli.console import EXIT_CODES, code_of, complain, err, out, session, tell
from sysid_evo.cli.experiments import fit
from sysid_evo.cli.robots import record
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

app.command("compare")(experiments.compare)

app.command("study")(experiments.study)

app.command("import")(recordings.import_)

app.command("inspect")(recordings.inspect)

app.command("record")(record)

app.command("fit")(fit)

app.command("tune")(models.tune)

app.command("adapt")(models.adapt)

app.command("evolve")(controllers.evolve)

app.command("exploit")(controllers.exploit)

app.command("transfer")(controllers.transfer)

app.command("drive")(robots.drive)

app.command("export")(controllers.export)

app.command("report")(experiments.report)

app.command("names")(plugins.list_names)

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
