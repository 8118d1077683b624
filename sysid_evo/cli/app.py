"""The commands, and what happens when one fails."""

from __future__ import annotations

import sys
import warnings

import typer

from sysid_evo.cli import recordings
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
app.command("import")(recordings.import_)
app.command("inspect")(recordings.inspect)
app.command("record")(recordings.record)

EXIT_ERROR = 2
EXIT_INTERRUPTED = 130


def main() -> None:
    """Run the command line; an error of this library is one message, not a traceback."""
    warnings.showwarning = _show_warning
    try:
        app(standalone_mode=True)
    except SysidEvoError as error:
        err.print("[bold red]error:[/] ", end="")
        err.print(str(error), markup=False, highlight=False)
        sys.exit(EXIT_ERROR)
    except KeyboardInterrupt:
        err.print("interrupted")
        sys.exit(EXIT_INTERRUPTED)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    err.print("[yellow]warning:[/] ", end="")
    err.print(str(message), markup=False, highlight=False)
