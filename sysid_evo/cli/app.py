"""The table of commands, the group that imports a command when it is run, and options of the whole program."""

from __future__ import annotations

import ast
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command, get_group

from sysid_evo.cli.console import EXIT_CODES, as_option, code_of, err, out, print_error, session, tell
from sysid_evo.errors import InvalidArgument, Meaningless, SysidEvoError, printable, refuse_meaningless
from sysid_evo.processors import INNER_THREADS
from sysid_evo.version import __version__

MARKUP: Any = "markdown"


Table: TypeAlias = Mapping[str, "str | Table"]

COMMANDS: Table = {
    "compare": "experiments:compare",
    "study": "experiments:study",
    "import": "recordings:import_",
    "inspect": "recordings:inspect",
    "record": "robots:record",
    "fit": "experiments:fit",
    "tune": "models:tune",
    "adapt": "models:adapt",
    "evolve": "controllers:evolve",
    "exploit": "controllers:exploit",
    "transfer": "controllers:transfer",
    "drive": "robots:drive",
    "export": "export:export",
    "report": "experiments:report",
    "names": "plugins:list_names",
    "runs": "runs:app",
    "models": {"list": "plugins:list_models", "show": "models:show_model"},
    "plugin": "plugins:app",
    "robots": "robots:app",
}
"""Where each command or group of them is, ``module:name``. A group may be a table, of commands in several modules."""
SUMMARIES = {"models": "The model families."}
"""Short help of the groups that are tables; that of all others is read where they are."""

JOBS = Meaningless(("jobs",), "the workers of the cluster compute the cells", {"scheduler": ()})

REFUSED = {
    "compare": (JOBS,),
    "fit": (JOBS,),
    "evolve": (JOBS,),
    "study": (JOBS, Meaningless(("jobs", "scheduler", "dry_run"), "nothing is computed", {"render": ()})),
    "record": (Meaningless(("minutes",), "its manoeuvres have lengths of their own", {"manoeuvre": ()}),),
    "tune": (Meaningless(("budget",), "the number of trials ends the search", {"trials": ()}),),
    "export": (Meaningless(("real",), "NumPy computes in double precision", {"to": ("python",)}),),
    "drive": (
        Meaningless(("robot",), "the model is driven instead", {"model": ()}),
        Meaningless(("watch",), "driving by hand shows the page anyway", unless=("controller",)),
        Meaningless(("host", "port"), "no page is served", {"controller": ()}, unless=("watch", "open")),
    ),
}
"""Options of a command that others make meaningless: giving both is refused. `compare` also refuses those of
`evaluation.experiment.MEANINGLESS`. With --dry-run all are taken: it says what the same command would do without it.
"""

ANYWHERE = ("--debug", "--quiet")
"""Options of the whole program, which may stand behind a command, too."""


def load(name: str, table: Table = COMMANDS) -> Any:
    """Import the command ``name`` of a table."""
    where = table[name]
    if not isinstance(where, str):
        return LazyGroup(where, name=name, help=SUMMARIES[name], no_args_is_help=True, rich_markup_mode=MARKUP)
    module, _, found = where.partition(":")
    target = getattr(import_module(f"sysid_evo.cli.{module}"), found)
    holder = typer.Typer(rich_markup_mode=MARKUP)
    if isinstance(target, typer.Typer):
        holder.add_typer(target, name=name)
    else:
        holder.command(name, cls=CheckedCommand)(target)
    return get_group(holder).commands[name]


def summary(name: str, table: Table) -> str:
    """Return the short help of a command, read from its source: to import all of them takes long."""
    module, _, found = str(table[name]).partition(":")
    for node in () if name in SUMMARIES else ast.parse((Path(__file__).parent / f"{module}.py").read_bytes()).body:
        if isinstance(node, ast.FunctionDef) and node.name == found:
            return " ".join((ast.get_docstring(node) or "").partition("\n\n")[0].split())
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == found and isinstance(node.value, ast.Call):
            return next(str(ast.literal_eval(one.value)) for one in node.value.keywords if one.arg == "help")
    return SUMMARIES[name]


class CheckedCommand(TyperCommand):
    """Refuses options that have no effect next to others on the command line, before anything is done: `REFUSED`."""

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
        refuse_meaningless(REFUSED.get(self.name or "", ()), given, given, as_option)
        return super().invoke(ctx)


def misplaced(word: str, words: Sequence[str], options: Sequence[Any]) -> str:
    """Return what to do about a ``word`` that belongs to no option and no argument."""
    behind = [one for text in words[: words.index(word)] for one in options if text in one.opts]
    if not behind or getattr(behind[-1], "is_flag", True):
        return f"{word!r} belongs to no option; see --help"
    name, commas = behind[-1].opts[0], "; did you mean values with commas, without spaces?"
    if behind[-1].multiple:
        return f"{name} must be repeated before each of its values: {name} {word}"
    return f"{name} takes one value, not {word!r} too{commas if 'commas' in (behind[-1].help or '') else ''}"


def typed(ctx: Any) -> dict[str, Any]:
    """Return the values of the options given on the command line by name: baselines for --baselines."""
    return {
        option.opts[0].removeprefix("--").replace("-", "_"): ctx.params[option.name]
        for option in ctx.command.params
        if option.param_type_name == "option" and ctx.get_parameter_source(option.name).name == "COMMANDLINE"
    }


class LazyGroup(TyperGroup):
    """Lists the commands of the table, and imports one when it is run, completed or asked for help."""

    def __init__(self, table: Table = COMMANDS, **settings: Any) -> None:
        super().__init__(**settings)
        self.table = table

    def list_commands(self, ctx: Any) -> list[str]:
        return list(self.table)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name in self.commands or cmd_name not in self.table:
            return self.commands.get(cmd_name)
        return TyperCommand(cmd_name, help=summary(cmd_name, self.table), rich_markup_mode=MARKUP)

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except Exception as error:
            if isinstance(getattr(error, "message", None), str):  # wrong usage: Typer prints it itself
                error.message = printable(error.message)  # type: ignore[attr-defined]  # Typer has its own copy of Click's errors
            raise

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, _, rest = super().resolve_command(ctx, args)
        return name, None if name is None else load(name, self.table), rest


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
        print_error(error)
        sys.exit(code_of(error))
