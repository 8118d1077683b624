"""The table of commands, the group that imports a command when it runs, and options of the whole program."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command, get_group

from sysid_evo import errors
from sysid_evo.cli.console import EXIT_CODES, as_option, code_of, err, out, print_error, print_status, session
from sysid_evo.errors import InvalidArgument, Meaningless, SysidEvoError, did_you_mean, printable
from sysid_evo.processors import INNER_THREADS
from sysid_evo.version import __version__

MARKUP: Any = "markdown"


class Entry(NamedTuple):
    """A command of a list: the first line of its help, and its place ``module:name`` or the commands of a group."""

    line: str
    target: str | Mapping[str, Entry]


PANELS = {
    "Experiments": {
        "compare": Entry("Fit models, evolve controllers, report prediction and transfer.", "experiments:compare"),
        "fit": Entry("Fit model families to recordings.", "experiments:fit"),
        "study": Entry("Run a grid of comparisons over robots, seeds and settings.", "experiments:study"),
        "report": Entry("Rebuild the report of a run; nothing is computed again.", "experiments:report"),
    },
    "Recordings": {
        "import": Entry("Convert log files to a data set: check, prepare, store.", "recordings:import_"),
        "inspect": Entry("Report excitation, coverage, sampling and delays of a recording.", "recordings:inspect"),
    },
    "Models": {
        "models": Entry("List model families; show a family or a fitted model.", {
            "list": Entry("List the model families and the physics they assume.", "plugins:list_models"),
            "show": Entry("Show a model family, or a fitted model.", "models:show_model"),
        }),
        "adapt": Entry("Adapt a fitted model to a new operating condition.", "models:adapt"),
    },
    "Controllers": {
        "evolve": Entry("Evolve a controller on one model or on an ensemble of models.", "controllers:evolve"),
        "exploit": Entry("Search the controller that exploits one model most.", "controllers:exploit"),
        "transfer": Entry("Run stored controllers on models and robots; report their fitness.", "controllers:transfer"),
        "export": Entry("Write a controller as a Python or C file.", "controllers:export"),
    },
    "Robots": {
        "robots": Entry("List robot drivers; check whether a robot is ready.", {
            "list": Entry("List the robot drivers.", "robots:list_robots"),
            "check": Entry("Check link, tracker and loop of a robot without moving it.", "robots:check_robot"),
        }),
        "record": Entry("Drive a robot through excitation manoeuvres and record it.", "robots:record"),
        "drive": Entry("Drive a robot or model by hand, or run a controller on it.", "robots:drive"),
    },
    "Runs and plugins": {
        "runs": Entry("List, show, compare and clean run folders.", {
            "list": Entry("List the runs in a folder, the oldest first.", "runs:list_runs"),
            "show": Entry("Show the steps of a run: result, time and file of each.", "runs:show"),
            "diff": Entry("Show the settings and main results that differ between two runs.", "runs:diff"),
            "clean": Entry("Remove failed steps, damaged records and unused files.", "runs:clean"),
        }),
        "names": Entry("List the names that a SPEC may use, with their parameters.", "plugins:list_names"),
        "plugin": Entry("Create a plugin; check one against its contract.", {
            "new": Entry("Write a plugin package: one file, one entry point, one test.", "plugins:new"),
            "check": Entry("Check a plugin against the contract of its kind.", "plugins:check"),
        }),
    },
}  # fmt: skip
"""The commands by panel of ``sysid-evo --help`` and by name."""
COMMANDS = {name: entry for entries in PANELS.values() for name, entry in entries.items()}

JOBS = Meaningless(("jobs",), "the workers of the cluster compute the steps", {"scheduler": ()})

REFUSED = {
    "compare": (JOBS,),
    "fit": (JOBS,),
    "evolve": (JOBS,),
    "study": (JOBS, Meaningless(("jobs", "scheduler", "dry_run"), "nothing is computed", {"render": ()})),
    "export": (Meaningless(("real",), "NumPy computes in double precision", {"to": ("python",)}),),
    "drive": (
        Meaningless(("robot",), "the model is driven instead", {"model": ()}),
        Meaningless(("watch",), "driving by hand shows the page anyway", unless=("controller",)),
        Meaningless(("host", "port"), "no page is served", {"controller": ()}, unless=("watch", "open")),
    ),
}
"""Options of a command that others make meaningless: giving both is refused. `compare` also refuses those of
`evaluation.experiment.MEANINGLESS`. --dry-run refuses nothing: it reports the plan of the same command without it.
"""

ANYWHERE = ("--debug", "--quiet")
"""Options of the whole program that may also follow a command."""


def load(name: str, table: Mapping[str, Entry] = COMMANDS) -> Any:
    """Import the command ``name`` of a table."""
    line, target = table[name]
    if not isinstance(target, str):
        return LazyGroup(target, name=name, help=line, no_args_is_help=True, rich_markup_mode=MARKUP)
    module, _, function = target.partition(":")
    holder = typer.Typer(rich_markup_mode=MARKUP)
    holder.command(name, cls=CheckedCommand)(getattr(import_module(f"sysid_evo.cli.{module}"), function))
    return get_group(holder).commands[name]


def _without_types(params: Sequence[Any]) -> None:
    """Leave out the types of arguments and flags on help pages: names and descriptions suffice."""
    for param in params:
        if param.param_type_name == "argument":
            param.display_type_rich = lambda **_: ""
        elif param.is_flag and param.metavar is None:
            param.metavar = ""


class CheckedCommand(TyperCommand):
    """Refuses options that have no effect next to others: `REFUSED`."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters; the panel Run is the last one of a help page, and --help the last of its options."""
        params: list[Any] = super().get_params(ctx)
        params[-1].rich_help_panel, params[-1].help = "Run", "Show this message."
        _without_types(params)
        return sorted(params, key=lambda param: param.rich_help_panel == "Run")

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the command line; the error for a misplaced word names the option before it."""
        words = list(args)
        ctx.allow_extra_args = True
        rest: list[str] = super().parse_args(ctx, args)
        if ctx.args and not ctx.resilient_parsing:
            raise InvalidArgument(misplaced(ctx.args[0], words, self.params))
        return rest

    def invoke(self, ctx: Any) -> Any:
        given = typed(ctx)
        errors.refuse_meaningless(REFUSED.get(self.name or "", ()), given, given, as_option)
        return super().invoke(ctx)


def misplaced(word: str, words: Sequence[str], options: Sequence[Any]) -> str:
    """Return a remedy for a ``word`` that belongs to no option and no argument."""
    before = [one for text in words[: words.index(word)] for one in options if text in one.opts]
    if not before or getattr(before[-1], "is_flag", True):
        return f"{word!r} belongs to no option; see --help"
    name = before[-1].opts[0]
    if before[-1].multiple:
        return f"{name} must be repeated before each of its values: {name} {word}"
    commas = "; did you mean values with commas, without spaces?" if before[-1].metavar == "LIST" else ""
    return f"{name} takes one value, not {word!r} too{commas}"


def typed(ctx: Any) -> dict[str, Any]:
    """Return the values of the options given on the command line by name: baselines for --baselines."""
    return {
        option.opts[0].removeprefix("--").replace("-", "_"): ctx.params[option.name]
        for option in ctx.command.params
        if option.param_type_name == "option" and ctx.get_parameter_source(option.name).name == "COMMANDLINE"
    }


class LazyGroup(TyperGroup):
    """Lists the commands of a table, and imports one when it runs, is completed or shows its help."""

    def __init__(self, table: Mapping[str, Entry] = COMMANDS, **settings: Any) -> None:
        super().__init__(**settings)
        self.table = table

    def get_params(self, ctx: Any) -> list[Any]:
        params: list[Any] = super().get_params(ctx)
        _without_types(params)
        return params

    def list_commands(self, ctx: Any) -> list[str]:
        return list(self.table)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name in self.commands or cmd_name not in self.table:
            return self.commands.get(cmd_name)
        panel = next((panel for panel, entries in PANELS.items() if cmd_name in entries), None)
        return TyperCommand(cmd_name, help=self.table[cmd_name].line, rich_help_panel=panel, rich_markup_mode=MARKUP)

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except Exception as error:
            if isinstance(getattr(error, "message", None), str):  # wrong usage: Typer prints it itself
                error.message = printable(error.message)  # type: ignore[attr-defined]  # Typer has its own copy of Click's errors
            raise

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if args[0] not in self.table and not ctx.resilient_parsing:
            hint = did_you_mean(args[0], self.table) or f" The commands are {', '.join(self.table)}."
            raise InvalidArgument(f"there is no command {args[0]!r}.{hint}")
        name, _, rest = super().resolve_command(ctx, args)
        return name, None if name is None else load(name, self.table), rest


app = typer.Typer(
    name="sysid-evo",
    cls=LazyGroup,
    help="Identify models of a robot, evolve controllers on them, and measure which still work on the robot.\n\n"
    "A SPEC on the help pages is NAME or NAME(parameter=value, ...); `sysid-evo names` lists them.",
    epilog=EXIT_CODES,
    no_args_is_help=True,
    rich_markup_mode=MARKUP,
    pretty_exceptions_enable=False,
)


def loaded() -> Any:
    """Return the command line with all of its commands imported, for the documentation."""
    return _loaded(get_command(app))


def _loaded(group: Any) -> Any:
    for name in group.table if isinstance(group, LazyGroup) else ():
        group.add_command(_loaded(load(name, group.table)))
    return group


def _print_version(wanted: bool) -> None:
    if wanted:
        out.print(f"sysid-evo {__version__}", highlight=False)
        raise typer.Exit


@app.callback()
def _options(
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print results and errors only.")] = False,
    _version: Annotated[bool, typer.Option("--version", help="Print the version.", callback=_print_version,
        is_eager=True)] = False,
) -> None:  # fmt: skip
    session.debug = debug
    err.quiet = quiet


def main() -> None:
    """Run the command line; an error of this library is one message, not a traceback."""
    warnings.showwarning = lambda message, *_, **__: print_status(str(message), label="warning: ", style="yellow")
    for name in INNER_THREADS:
        os.environ.setdefault(name, "1")
    arguments = sys.argv[1:]
    end = arguments.index("--") if "--" in arguments else len(arguments)
    first = [argument for argument in arguments[:end] if argument in ANYWHERE]
    rest = [argument for argument in arguments[:end] if argument not in ANYWHERE]
    try:
        app(args=[*first, *rest, *arguments[end:]], standalone_mode=True)
    except (SysidEvoError, OSError) as error:
        print_error(error)
        sys.exit(code_of(error))
