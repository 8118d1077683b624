"""The table of commands, the group that imports a command when it is run, and options of the whole program."""

from __future__ import annotations

import os
import sys
import warnings
from dataclasses import dataclass
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command, get_group

from sysid_evo.cli.console import EXIT_CODES, code_of, complain, err, out, session, tell
from sysid_evo.errors import SysidEvoError, printable
from sysid_evo.processors import INNER_THREADS
from sysid_evo.version import __version__

MARKUP: Any = "markdown"


@dataclass(frozen=True)
class Entry:
    """A line of the table: where a command or a group of them is, ``module:name``, and its short help."""

    target: str
    summary: str


COMMANDS = {
    "compare": Entry(
        "experiments:compare",
        "Fit models, evolve controllers in them, and compare both: which predict, which transfer.",
    ),
    "study": Entry(
        "experiments:study",
        "Compare over a grid of robots, seeds and settings: tables with intervals, Parquet, a page.",
    ),
    "import": Entry("recordings:import_", "Turn log files into a data set: check, prepare, store."),
    "inspect": Entry(
        "recordings:inspect",
        "Say what a recording is good for: excitation, coverage, sampling, delays, what to record next.",
    ),
    "record": Entry(
        "robots:record",
        "Drive a robot through manoeuvres; store the journals of the runs (`journal/`), what the tracker saw (`raw/`) "
        "and the data set made of it.",
    ),
    "fit": Entry(
        "experiments:fit",
        "Fit model families to recordings and store them in a run folder; without --models the best of the zoo (auto).",
    ),
    "tune": Entry(
        "models:tune", "Search for the parameters with which a family runs free best on recordings held out."
    ),
    "adapt": Entry(
        "models:adapt",
        "Correct a model for another day, floor or battery, if a gate finds that the correction helps.",
    ),
    "evolve": Entry(
        "controllers:evolve", "Evolve a controller against one model or against an ensemble of them at once."
    ),
    "exploit": Entry(
        "controllers:exploit",
        "Search the controller that gains most in one model and in no other, and say how it cheats.",
    ),
    "transfer": Entry(
        "controllers:transfer",
        "Run stored controllers on models and robots, and tell what each claims, achieves, has at worst and costs.",
    ),
    "drive": Entry(
        "robots:drive",
        "Drive a robot or a model, by hand on a local web page or with --controller, at the task of the matrix.",
    ),
    "export": Entry(
        "export:export",
        "Write an evolved controller as one file: from its observations, in order, to legal controls.",
    ),
    "report": Entry(
        "experiments:report",
        "Make the report of a run again, of what is there: nothing is fitted, evolved or driven.",
    ),
    "names": Entry(
        "plugins:list_names",
        "List what can be named, NAME(parameter=value, ...), with its parameters and their defaults.",
    ),
    "runs": Entry("runs:app", "Run folders and what they hold."),
    "models": Entry("models:app", "The model families."),
    "plugin": Entry("plugins:app", "Models, tasks, controllers, strategies, robots and readers of your own."),
    "robots": Entry("robots:app", "Robots, physical and emulated."),
}

ANYWHERE = ("--debug", "--quiet")
"""Options of the whole program, which may stand behind a command, too."""


def load(name: str) -> Any:
    """Import the command ``name``."""
    module, _, found = COMMANDS[name].target.partition(":")
    target = getattr(import_module(f"sysid_evo.cli.{module}"), found)
    holder = typer.Typer(rich_markup_mode=MARKUP)
    if isinstance(target, typer.Typer):
        holder.add_typer(target, name=name)
    else:
        holder.command(name)(target)
    return get_group(holder).commands[name]


class LazyGroup(TyperGroup):
    """Lists the commands of the table, and imports one when it is run, completed or asked for help."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        for name, entry in COMMANDS.items():
            self.add_command(TyperCommand(name, help=entry.summary, rich_markup_mode=MARKUP))

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except Exception as error:
            if isinstance(getattr(error, "message", None), str):  # wrong usage: Typer prints it itself
                error.message = printable(error.message)  # type: ignore[attr-defined]
            raise

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, _, rest = super().resolve_command(ctx, args)
        return name, None if name is None else load(name), rest


app = typer.Typer(
    name="sysid-evo",
    cls=LazyGroup,
    help="Identify models of a robot, evolve controllers in them, and see which still work on the robot.\n\n"
    + EXIT_CODES,
    no_args_is_help=True,
    rich_markup_mode=MARKUP,
    pretty_exceptions_enable=False,
)


def loaded() -> Any:
    """Return the command line with all of its commands imported, for the documentation."""
    group: Any = get_command(app)
    for name in COMMANDS:
        group.add_command(load(name))
    return group


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
    warnings.showwarning = lambda message, *_, **__: tell(str(message), label="warning: ", style="yellow")
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
