"""`sysid-evo plugin`: write a new model family, and check one against the contract."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sysid_evo.cli.console import err, out
from sysid_evo.cli.options import Plugins, load_plugins

app = typer.Typer(help="Model families of your own.", no_args_is_help=True)


@app.command("new")
def new(
    name: Annotated[str, typer.Argument(help="Name of the family, such as my_model.")],
    folder: Annotated[Path | None, typer.Option("--out", help="Folder (default: one of that name).")] = None,
) -> None:
    """Write a working package: one file, one entry-point line, one test."""
    from sysid_evo.plugin_template import write_plugin

    where = folder or Path(name)
    for path in write_plugin(name, where):
        out.print(str(path), highlight=False, soft_wrap=True)
    err.print(
        f"check it with: sysid-evo plugin check {name} --plugin {where / name}.py", highlight=False, soft_wrap=True
    )


@app.command("check")
def check(
    name: Annotated[str, typer.Argument(help="Name of a registered family.")],
    data: Annotated[Path | None, typer.Option(help="Recordings to fit it to (default: a made-up car).")] = None,
    plugin: Plugins = None,
) -> None:
    """Run the contract of a model family and print every sentence with its verdict."""
    from rich.text import Text

    from sysid_evo.data import Dataset
    from sysid_evo.testing import run_checks

    load_plugins(plugin)
    broken = 0
    for result in run_checks(name, Dataset.read(data) if data is not None else None):
        verdict = ("ok    ", "green") if result.failure is None else ("BROKEN", "bold red")
        out.print(Text.assemble(verdict, f" {result.sentence}"))
        if result.failure is not None:
            broken += 1
            out.print(Text(f"       {result.failure}"))
    if broken:
        err.print(f"{name} breaks {broken} of the contract's sentences")
        raise typer.Exit(1)
