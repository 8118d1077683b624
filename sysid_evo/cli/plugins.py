"""Names, models list, plugin new, plugin check: registered names, and the contracts of plugins."""

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
from sysid_evo.cli.console import err, out, print_line, print_status, table_of
from sysid_evo.cli.options import Json, Plugins, argument, load_plugins, option
from sysid_evo.errors import InvalidArgument, UnknownName, did_you_mean
from sysid_evo.registry.grammar import Spec
from sysid_evo.registry.registry import KINDS, models
from sysid_evo.testing.template import PLUGINS, write_plugin

if TYPE_CHECKING:
    from sysid_evo.testing.contract import CheckResult


def new(
    name: Annotated[str, argument("Name of the plugin, such as my_model", "NAME")],
    kind: Annotated[str, option("model, task, controller, strategy, adapter, robot or reader", "NAME", panel="Plugin",
        shown="model", values=lambda: PLUGINS)] = "model",
    folder: Annotated[Path | None, option("Folder of the package", "DIR", "--out", shown="NAME")] = None,
) -> None:  # fmt: skip
    """Write a plugin package: one file, one entry point, one test."""
    where = folder or Path(name)
    for path in write_plugin(name, where, kind):
        print_line(str(path))
    options = PLUGINS[kind].check.replace("tests/", f"{shlex.quote(str(where))}/tests/")
    file = shlex.quote(f"{where / name}.py")
    print_status(f"check it with: sysid-evo plugin check {name} --plugin {file}{options}")
    if kind == "model":
        print_status(f"compare it with: sysid-evo compare --plugin {file} --models {name},parametrised --minutes 3")


def check(
    name: Annotated[str, argument("Registered name, or NAME(parameter=value, ...)", "SPEC")],
    kind: Annotated[str | None, option("Kind of the plugin, if several kinds have the name", "NAME", panel="Plugin",
        values=lambda: PLUGINS)] = None,
    data: Annotated[Path | None, option("Recordings for a model or a task (example systems); example file of a reader",
        "PATH", panel="Plugin")] = None,
    plugin: Plugins = None,
) -> None:  # fmt: skip
    """Check a plugin against the contract of its kind.

    Prints each rule of the contract with ok or FAILED; exit code 1 if one failed.
    """
    load_plugins(plugin)
    spec = Spec.parse(name)
    kind = kind or _kind_of(spec.name)
    failed = 0
    for result in _results(kind, spec, data):
        verdict = ("ok", "green") if result.failure is None else ("FAILED", "bold red")
        line = Table.grid(padding=(0, 1))  # a wrapped rule continues in the second column
        line.add_column(width=len("FAILED"))
        sentences = result.rule + (f": {result.idle}" if result.idle else "")
        line.add_row(Text("-", "dim") if result.idle else Text(*verdict), Text(sentences))
        if result.failure is not None:
            failed += 1
            line.add_row("", Text(result.failure))
        out.print(line)
    if failed:
        err.print(f"{name} breaks rules of the contract ({failed})")
        raise typer.Exit(1)


def _kind_of(name: str) -> str:
    """Return the kind that ``name`` belongs to. Raises `UnknownName`, or `InvalidArgument` if there are several."""
    found = [kind for kind in PLUGINS if name in KINDS[kind].names()]
    if not found:
        hint = did_you_mean(name, [known for kind in PLUGINS for known in KINDS[kind].names()])
        raise UnknownName(
            f"no {', '.join(list(PLUGINS)[:-1])} or {list(PLUGINS)[-1]} is called {name!r}.{hint} If it is defined in "
            "your own file, add --plugin FILE"
        )
    if len(found) > 1:
        raise InvalidArgument(f"{name!r} is a {' and a '.join(found)}: choose one with --kind")
    return found[0]


def _results(kind: str, spec: Spec, data: Path | None) -> Iterator[CheckResult]:
    """Yield the results of the contract of ``kind``. Raises `InvalidArgument` for a wrong kind or wrong data."""
    if kind not in PLUGINS:
        raise InvalidArgument(f"plugin: expected a kind among {', '.join(PLUGINS)}, got {kind!r}")
    run = hardware.CONTRACTS[kind].run
    if kind == "reader" and data is None:
        raise InvalidArgument("a reader is checked on an example file: name one with --data")
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
"""The further argument of a contract, made from a path."""


def list_models(
    plugin: Plugins = None,
    form: Annotated[str, option("table or markdown", "NAME", "--format", shown="table",
        values=lambda: ("table", "markdown"))] = "table",
    as_json: Json = False,
) -> None:  # fmt: skip
    """List the model families and the physics they assume."""
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
    table = table_of("family", "assumes", "description", whole=("family", "assumes"))
    for row in rows:
        table.add_row(row["name"], row["knowledge"], Text(row["summary"] or ""))
        if row["lacking"]:
            table.add_row("", "", Text(f"cannot run here: {row['lacking']}", style="yellow"))
    out.print(table)
    out.print(Text(KNOWLEDGE))


KNOWLEDGE = (
    "assumes: black nothing, dark grey a differential equation, grey equations of the system whose parameters are "
    "fitted"
)


def families_as_markdown() -> str:
    """Return the families that can be loaded as a Markdown table, for the documentation."""
    lines = [
        "| family | what it is | physics assumed | structure | periodic angles | fit time |",
        "|---|---|---|---|---|---|",
    ]
    for name, found in models.load_all():
        family: Any = found
        seconds = model_zoo.fit_seconds(name) or getattr(family, "typical_fit_seconds", None)
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
    kind: Annotated[str | None, argument("model, task, controller, ...; without it the kinds are listed", "KIND",
        values=lambda: KINDS)] = None,
    plugin: Plugins = None, as_json: Json = False,
) -> None:  # fmt: skip
    """List the names that a SPEC may use, with their parameters.

    A SPEC is NAME or NAME(parameter=value, ...). The defaults of the parameters are listed, too.
    """
    load_plugins(plugin)
    plurals = {registry.group.rpartition(".")[2]: name for name, registry in KINDS.items()}
    kind = plurals.get(kind or "", kind)
    if kind is not None and kind not in KINDS:
        meant = did_you_mean(kind, [*KINDS, *plurals])
        raise UnknownName(f"there is no kind {kind!r}.{meant} The kinds are {', '.join(KINDS)}")
    if kind is None and not as_json:
        kinds = table_of("kind", "names")
        for name, registry in KINDS.items():
            kinds.add_row(name, ", ".join(registry.names()))
        out.print(kinds)
        print_status("sysid-evo names KIND lists descriptions and parameters")
        return
    rows = [row for name, registry in KINDS.items() if kind in (None, name) for row in names_of(registry)]
    if as_json:
        out.print_json(data=rows)
        return
    table = table_of("kind", "name", "description", whole=("kind", "name"))
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
