"""Everything that has a name, of every kind, as a table or JSON."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer

from sysid_evo.cli.console import out
from sysid_evo.cli.options import Json, Plugins, load_plugins


def list_names(
    kind: Annotated[str | None, typer.Argument(help="model, task, controller, ... (default: all).")] = None,
    plugin: Plugins = None,
    as_json: Json = False,
) -> None:
    """List what can be named, NAME(parameter=value, ...), with its parameters and their defaults."""
    from rich.table import Table
    from rich.text import Text

    from sysid_evo.errors import UnknownName
    from sysid_evo.registry import KINDS

    load_plugins(plugin)
    if kind is not None and kind not in KINDS:
        raise UnknownName(f"no kind of thing is called {kind!r}; there are {', '.join(KINDS)}")
    rows = [row for name, registry in KINDS.items() if kind in (None, name) for row in names_of(registry)]
    if as_json:
        out.print_json(json.dumps(rows))
        return
    table = Table(box=None, pad_edge=False)
    for heading in ("kind", "name", "what it is"):
        table.add_column(heading, no_wrap=heading != "what it is")
    for row in rows:
        table.add_row(row["kind"], row["name"], Text(row["summary"]))
        if row["parameters"]:
            table.add_row("", "", Text(f"({row['parameters']})", style="dim"))
    out.print(table)


def names_of(registry: Any) -> list[dict[str, str]]:
    """Return a row for each name of a registry that can be loaded."""
    rows = []
    for name, factory in registry.load_all():
        summary = (factory.__doc__ or "").strip().splitlines() or [""]
        known = registry.parameters(name)
        parameters = ", ".join(
            f"{key}={value!r}" if isinstance(value, (bool, int, float, str, tuple, type(None))) else f"{key}"
            for key, value in known.items()
            if key is not None and key not in registry.given
        )
        rows.append({"kind": registry.kind, "name": name, "summary": summary[0], "parameters": parameters})
    return rows
