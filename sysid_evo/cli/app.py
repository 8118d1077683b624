"""The commands, and what happens when one fails."""

from __future__ import annotations

import sys
import warnings

import typer
from rich.text import Text

from sysid_evo.cli import comparing, driving, evolving, models, plugins, recordings, robots
from sysid_evo.cli.console import err
from sysid_evo.errors import SysidEvoError

app = typer.Typer(
    name="sysid-evo",
    help="Identify models of a robot, evolve controllers in them, and see which still work on the robot.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_show_locals=False,
)
app.command("compare")(comparing.compare)
app.command("import")(recordings.import_)
app.command("inspect")(recordings.inspect)
app.command("record")(recordings.record)
app.command("fit")(models.fit)
app.command("evolve")(evolving.evolve)
app.command("drive")(driving.drive)
app.add_typer(models.app, name="models")
app.add_typer(plugins.app, name="plugin")
app.add_typer(robots.app, name="robots")

EXIT_ERROR = 2


def main() -> None:
    """Run the command line; an error of this library is one message, not a traceback."""
    warnings.showwarning = _show_warning
    try:
        app(standalone_mode=True)
    except SysidEvoError as error:
        err.print(Text.assemble(("error: ", "bold red"), str(error)))
        sys.exit(EXIT_ERROR)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    err.print(Text.assemble(("warning: ", "yellow"), str(message)))
