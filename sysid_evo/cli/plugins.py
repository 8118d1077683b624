"""`sysid-evo plugin`: write a new thing of a kind, and check one against the contract of its kind."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sysid_evo.cli.console import err, out
from sysid_evo.cli.options import Plugins, load_plugins

if TYPE_CHECKING:
    from sysid_evo.registry import Spec
    from sysid_evo.testing import CheckResult

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
    from sysid_evo.plugin_template import PLUGINS, write_plugin

    where = folder or Path(name)
    for path in write_plugin(name, where, kind):
        out.print(str(path), highlight=False, soft_wrap=True)
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
    from rich.text import Text

    from sysid_evo.registry import Spec

    load_plugins(plugin)
    spec = Spec.parse(name)
    kind = kind or _kind_of(spec.name)
    broken = 0
    for result in _results(kind, spec, data):
        verdict = ("ok    ", "green") if result.failure is None else ("BROKEN", "bold red")
        out.print(Text.assemble(verdict, f" {result.sentence}"))
        if result.failure is not None:
            broken += 1
            out.print(Text(f"       {result.failure}"))
    if broken:
        err.print(f"{name} breaks {broken} of the contract's sentences")
        raise typer.Exit(1)


def _kind_of(name: str) -> str:
    """Return the kind of which one is called ``name``. Raises `UnknownName`, or `InvalidArgument` if several are."""
    from sysid_evo.errors import InvalidArgument, UnknownName
    from sysid_evo.plugin_template import PLUGINS
    from sysid_evo.registry import KINDS

    found = [kind for kind in PLUGINS if name in KINDS[kind].names()]
    if not found:
        raise UnknownName(f"no {', '.join(list(PLUGINS)[:-1])} or {list(PLUGINS)[-1]} is called {name!r}")
    if len(found) > 1:
        raise InvalidArgument(f"{name!r} is a {' and a '.join(found)}: say which with --kind")
    return found[0]


def _results(kind: str, spec: Spec, data: Path | None) -> Iterator[CheckResult]:
    """Yield the verdicts of the kit of ``kind``. Raises `InvalidArgument` for a kind or data that do not fit."""
    from sysid_evo.errors import InvalidArgument

    run = _kit(kind)
    if kind == "reader" and data is None:
        raise InvalidArgument("a reader is checked on a file of its kind: name one with --data")
    if data is None:
        return run(spec.name, **spec.parameters)
    if kind not in FROM_DATA:
        raise InvalidArgument(f"kind {kind} is checked without recordings: leave --data out")
    return run(spec.name, FROM_DATA[kind](data), **spec.parameters)


def _kit(kind: str) -> Callable[..., Iterator[CheckResult]]:
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.plugin_template import PLUGINS

    if kind not in PLUGINS:
        raise InvalidArgument(f"plugin: expected a kind among {', '.join(PLUGINS)}, got {kind!r}")
    if kind == "robot":
        from hardware.testing import run_robot_checks

        return run_robot_checks
    from sysid_evo import testing

    kits: Mapping[str, Callable[..., Iterator[CheckResult]]] = {
        "model": testing.run_checks,
        "task": testing.run_task_checks,
        "controller": testing.run_controller_checks,
        "strategy": testing.run_strategy_checks,
        "reader": testing.run_reader_checks,
    }
    return kits[kind]


def _dataset(path: Path) -> Any:
    from sysid_evo.data import Dataset

    return Dataset.read(path)


FROM_DATA: Mapping[str, Callable[[Path], Any]] = {
    "model": _dataset,
    "task": lambda path: _dataset(path).system,
    "reader": lambda path: path,
}
"""What a kit takes besides the name, made of the path that was given."""
