"""Names, models list, plugin new, plugin check: what has a name, and the contracts of one's own things."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

import hardware
import model_zoo
import sysid_evo
from sysid_evo.cli.console import err, out, say, table_of, tell
from sysid_evo.cli.options import Json, Plugins, load_plugins
from sysid_evo.errors import InvalidArgument, UnknownName, did_you_mean
from sysid_evo.registry.grammar import Spec
from sysid_evo.registry.registry import KINDS, models
from sysid_evo.testing.template import PLUGINS, write_plugin

if TYPE_CHECKING:
    from sysid_evo.testing.contract import CheckResult

app = typer.Typer(
    help="Models, tasks, controllers, strategies, robots and readers of your own.",
    no_args_is_help=True,
)


@app.command("new")
def new(
    name: Annotated[str, typer.Argument(help="Its name, such as my_model.")],
    kind: Annotated[
        str,
        typer.Option(help="model, task, controller, strategy, robot or reader."),
    ] = "model",
    folder: Annotated[Path | None, typer.Option("--out", help="Folder (default: one of that name).")] = None,
) -> None:
    """Write a working package: one file, one entry-point line, one test."""
    where = folder or Path(name)
    for path in write_plugin(name, where, kind):
        say(str(path))
    options = PLUGINS[kind].check.replace("tests/", f"{shlex.quote(str(where))}/tests/")
    err.print(
        f"check it with: sysid-evo plugin check {name} --plugin {shlex.quote(str(where / name) + '.py')}{options}",
        highlight=False,
        soft_wrap=True,
    )


@app.command("check")
def check(
    name: Annotated[str, typer.Argument(help="Its registered name, or NAME(parameter=value, ...).")],
    kind: Annotated[str | None, typer.Option(help="model, task, ... (default: the kind that has the name).")] = None,
    data: Annotated[
        Path | None,
        typer.Option(help="Recordings for a model or a task (default: made-up systems); an example file of a reader."),
    ] = None,
    plugin: Plugins = None,
) -> None:
    """Run the contract of a thing's kind and print every sentence with its verdict."""
    load_plugins(plugin)
    spec = Spec.parse(name)
    kind = kind or _kind_of(spec.name)
    broken = 0
    for result in _results(kind, spec, data):
        verdict = ("ok", "green") if result.failure is None else ("BROKEN", "bold red")
        line = Table.grid(padding=(0, 1))  # a wrapped sentence continues in the second column
        line.add_column(width=len("BROKEN"))
        said = result.sentence + (f": {result.idle}" if result.idle else "")
        line.add_row(Text("-", "dim") if result.idle else Text(*verdict), Text(said))
        if result.failure is not None:
            broken += 1
            line.add_row("", Text(result.failure))
        out.print(line)
    if broken:
        err.print(f"{name} breaks {broken} rules of the contract")
        raise typer.Exit(1)


def _kind_of(name: str) -> str:
    """Return the kind of which one is called ``name``. Raises `UnknownName`, or `InvalidArgument` if several are."""
    found = [kind for kind in PLUGINS if name in KINDS[kind].names()]
    if not found:
        raise UnknownName(f"no {', '.join(list(PLUGINS)[:-1])} or {list(PLUGINS)[-1]} is called {name!r}")
    if len(found) > 1:
        raise InvalidArgument(f"{name!r} is a {' and a '.join(found)}: say which with --kind")
    return found[0]


def _results(kind: str, spec: Spec, data: Path | None) -> Iterator[CheckResult]:
    """Yield the verdicts of the contract of ``kind``. Raises `InvalidArgument` for a kind or data that do not fit."""
    if kind not in PLUGINS:
        raise InvalidArgument(f"plugin: expected a kind among {', '.join(PLUGINS)}, got {kind!r}")
    run = hardware.CONTRACTS[kind].run
    if kind == "reader" and data is None:
        raise InvalidArgument("a reader is checked on a file of its kind: name one with --data")
    if data is None:
        return run(spec.name, **spec.parameters)
    if kind not in FROM_DATA:
        raise InvalidArgument(f"kind {kind} is checked without recordings: leave --data out")
    return run(spec.name, FROM_DATA[kind](data), **spec.parameters)


FROM_DATA: Mapping[str, Callable[[Path], Any]] = {
    "model": lambda path: sysid_evo.Dataset.read(path),
    "task": lambda path: sysid_evo.Dataset.read(path).system,
    "reader": lambda path: path,
}
"""What a contract takes besides the name, made of the path that was given."""


def list_models(
    plugin: Plugins = None,
    form: Annotated[str, typer.Option("--format", help="table or markdown.")] = "table",
    as_json: Json = False,
) -> None:
    """List every model family that can be loaded, with what it assumes."""
    load_plugins(plugin)
    if form not in ("table", "markdown"):
        raise InvalidArgument(f"--format: expected table or markdown, got {form!r}")
    if form == "markdown":
        out.print(families_as_markdown(), highlight=False, soft_wrap=True)
        return
    rows: list[dict[str, str | None]] = []
    for name, knowledge in models.each(lambda name: str(models.glance(name, "knowledge") or "")):
        lacking = models.missing_package(name)
        why = None if lacking is None else str(lacking)
        rows.append({"name": name, "knowledge": knowledge, "summary": models.summary(name), "lacking": why})
    if as_json:
        out.print_json(data=rows)
        return
    table = table_of("family", "assumes", "what it is", whole=("family", "assumes"))
    for row in rows:
        table.add_row(row["name"], row["knowledge"], Text(row["summary"] or ""))
        if row["lacking"]:
            table.add_row("", "", Text(f"cannot run here: {row['lacking']}", style="yellow"))
    out.print(table)


def families_as_markdown() -> str:
    """Return the families that can be loaded as a Markdown table, for the documentation."""
    lines = [
        "| family | what it is | physics assumed | structure | periodic angles | fit time |",
        "|---|---|---|---|---|---|",
    ]
    for name, found in models.load_all():
        family: Any = found
        seconds = model_zoo.fit_seconds(name) or getattr(family, "usual_seconds", None)
        cells = (
            f"`{name}`",
            models.summary(name).replace("|", "\\|"),
            family.knowledge,
            family.model_class or "several",
            "yes" if family.periodic else "no",
            "" if seconds is None else f"{seconds:g} s",
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def list_names(
    kind: Annotated[str | None, typer.Argument(help="model, task, controller, ... (default: the kinds).")] = None,
    plugin: Plugins = None,
    as_json: Json = False,
) -> None:
    """List what can be named, NAME(parameter=value, ...); of one kind also the parameters and their defaults."""
    load_plugins(plugin)
    plurals = {registry.group.rpartition(".")[2]: name for name, registry in KINDS.items()}
    kind = plurals.get(kind or "", kind)
    if kind is not None and kind not in KINDS:
        meant = did_you_mean(kind, [*KINDS, *plurals])
        raise UnknownName(f"no kind of thing is called {kind!r}.{meant} There are {', '.join(KINDS)}")
    if kind is None and not as_json:
        kinds = table_of("kind", "names")
        for name, registry in KINDS.items():
            kinds.add_row(name, ", ".join(registry.names()))
        out.print(kinds)
        tell("sysid-evo names KIND says what each is, and which parameters it has")
        return
    rows = [row for name, registry in KINDS.items() if kind in (None, name) for row in names_of(registry)]
    if as_json:
        out.print_json(data=rows)
        return
    table = table_of("kind", "name", "what it is", whole=("kind", "name"))
    for row in rows:
        table.add_row(row["kind"], row["name"], Text(row["summary"]))
        if row["parameters"]:
            table.add_row("", "", Text(f"({row['parameters']})", style="dim"))
    out.print(table)


def names_of(registry: Any) -> list[dict[str, str]]:
    """Return a row for each name of a registry that can be loaded."""
    rows = []
    for name, _ in registry.load_all():
        known = registry.parameters(name)
        parameters = ", ".join(
            f"{key}={value!r}" if isinstance(value, (bool, int, float, str, tuple, type(None))) else f"{key}"
            for key, value in known.items()
            if key is not None and key not in registry.given
        )
        rows.append({"kind": registry.kind, "name": name, "summary": registry.summary(name), "parameters": parameters})
    return rows
