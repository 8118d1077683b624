"""Options: those of settings classes, those that several commands share, and the completion of their values."""

from __future__ import annotations

import inspect
import math
import os
from collections.abc import Callable, Collection, Iterable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeAlias, get_args

import typer
from pydantic import BaseModel

from sysid_evo.cli.console import as_option
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry.grammar import split_specs
from sysid_evo.registry.plugins import load_plugin
from sysid_evo.registry.registry import KINDS
from sysid_evo.settings import option_of, seconds

RUNS = Path("runs")
"""The folder of run folders if none is named."""


def option(
    description: str, metavar: str = "", *names: str, panel: str = "Run", shown: str = "", values: Values = None,
    **more: Any,
) -> Any:  # fmt: skip
    """Return an option of a help page: its description, the default that is ``shown``, the metavar of its value."""
    more |= _shown(description, metavar, shown, values)
    made: Any = typer.Option  # the names are given in place of a default
    return made(*names, rich_help_panel=panel, **more)


def argument(description: str, metavar: str, *, shown: str = "", values: Values = None) -> Any:
    """Return an argument of a help page, likewise."""
    return typer.Argument(**_shown(description, metavar, shown, values))


def _shown(description: str, metavar: str, shown: str, values: Values) -> dict[str, Any]:
    text = f"{description}{f' ({shown})' if shown else ''}."
    complete = None if values is None else completion(values)
    return {"help": text, "metavar": metavar or None, "show_default": False, "autocompletion": complete}


Values: TypeAlias = Callable[[], Iterable[str]] | None


def completion(values: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Return a function that completes the last of some comma-separated values, such as ``linear,na``."""

    def complete(incomplete: str) -> list[str]:
        before, comma, last = incomplete.rpartition(",")
        inside = before.count("(") > before.count(")")  # the brackets of a SPEC
        return [] if inside else [f"{before}{comma}{value}" for value in values() if value.startswith(last)]

    return complete


def names_of(*kinds: str) -> Callable[[], Iterable[str]]:
    """Return a function that lists the registered names of some kinds; nothing is imported for it."""
    return lambda: [name for kind in kinds for name in KINDS[kind].names()]


def run_folders() -> list[str]:
    """Return the run folders in ``runs``, the newest first."""
    found = [path for path in RUNS.glob("*") if path.is_dir()] if RUNS.is_dir() else []
    return [str(path) for path in sorted(found, key=lambda path: path.stat().st_mtime, reverse=True)]


def fitted_models() -> list[str]:
    """Return the models of the newest run folder by name."""
    newest = next((path for run in run_folders() if (path := Path(run) / "models").is_dir()), None)
    return [] if newest is None else sorted(path.stem for path in newest.glob("*.json"))


def number(low: float, kind: type[int] | type[float] = int, high: float = math.inf) -> Callable[[Any], Any]:
    """Return a parser of numbers from ``low`` to ``high``."""

    def parse(text: Any) -> Any:
        found: float | None = None
        with suppress(ValueError):
            found = kind(text)
        if found is None or not low <= found <= high or math.isinf(found):
            limits = f">= {low:g}" if math.isinf(high) else f"from {low:g} to {high:g}"
            raise typer.BadParameter(f"expected {'an integer' if kind is int else 'a number'} {limits}, got {text!r}")
        return found

    return parse


Plugins: TypeAlias = Annotated[list[Path] | None, option("Python file with plugins; repeatable", "FILE", "--plugin")]
Columns: TypeAlias = Annotated[
    Path | None, option("TOML file: which log column is which channel", "FILE", "--columns", panel="Data and models")
]
Seed: TypeAlias = Annotated[int | None, option("Seed of all random numbers", "N", shown="0", parser=number(0))]
Run: TypeAlias = Annotated[
    Path | None, option("Run folder with the models", "DIR", panel="Models", shown="the newest", values=run_folders)
]
Json: TypeAlias = Annotated[bool, option("Print JSON instead of tables", "", "--json")]
Verbose: TypeAlias = Annotated[bool, option("Print every table of the report", "", "--verbose")]
DryRun: TypeAlias = Annotated[bool, option("Print the plan and its expected duration; stop", "", "--dry-run")]
Out: TypeAlias = Annotated[
    Path | None, option("Run folder (runs/TIME); an existing one is resumed", "DIR", "--out", values=run_folders)
]
Jobs: TypeAlias = Annotated[int | None, option("Parallel processes", "N", shown="one per processor", parser=number(1))]
Scheduler: TypeAlias = Annotated[str | None, option("Dask scheduler: tcp://HOST:PORT or its file", "ADDR")]


def with_settings(model: type[BaseModel], *names: str, **defaults: Any) -> Callable[[Callable[..., None]], Any]:
    """Give a command an option for each of these settings of a class, in the order of the class.

    They come in place of the command's parameter ``settings``, which receives those that were given, and ``defaults``
    of this command. Texts are split and paths resolved here; the settings class converts and checks all else.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        chosen = {name: _annotated(model, name, defaults) for name in model.model_fields if name in names}
        made = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)
            for name, annotation in chosen.items()
        ]
        own = inspect.signature(command, eval_str=True).parameters.values()
        parameters = [one for each in own for one in (made if each.name == "settings" else (each,))]

        def run(**values: Any) -> None:
            given = {name: values.pop(name) for name in chosen}
            settings = {name: converted(model, name, value) for name, value in given.items() if value is not None}
            command(settings={**defaults, **settings}, **values)

        run.__name__, run.__doc__, run.__module__ = command.__name__, command.__doc__, command.__module__
        run.__annotations__ = {one.name: one.annotation for one in parameters}
        run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # read by Typer
        return run

    return decorate


def _annotated(model: type[BaseModel], name: str, defaults: dict[str, Any]) -> Any:
    """Return the type of an option of a setting: a text, or a list of texts if it is repeated."""
    field, info = model.model_fields[name], option_of(model, name)
    shown = info.shown if name not in defaults and info.shown else _written(defaults.get(name, field.default))
    words = [one for part in get_args(field.annotation) for one in (get_args(part) or (part,)) if isinstance(one, str)]
    values = names_of(info.kind) if info.kind else partial(list, words) if words else None
    names = (info.option,) if info.option else ()
    made = option(str(field.description), info.metavar, *names, panel=info.panel, shown=shown, values=values)
    annotated: Any = Annotated
    return annotated[list[str] | None if _repeated(model, name) else str | None, made]


def _written(default: Any) -> str:
    """Return a default as it is typed; nothing if it is None, empty or no time."""
    if isinstance(default, float):
        return f"{default:g}" if default else ""
    return "" if default is None else ",".join(default) if isinstance(default, tuple) else str(default)


def _repeated(model: type[BaseModel], name: str) -> bool:
    """Return whether an option is given once for each value of a list."""
    return "tuple" in str(model.model_fields[name].annotation) and option_of(model, name).metavar != "LIST"


def converted(model: type[BaseModel], name: str, value: Any) -> Any:
    """Return the text of an option, or its texts, as the setting expects it."""
    metavar = option_of(model, name).metavar
    if name == "columns":
        path = Path(value)
        return str(path.resolve() if path.exists() else path)  # a file, or the name of a shipped one
    if _repeated(model, name):
        return resolved([Path(text) for text in value]) if metavar in ("PATH", "FILE") else tuple(value)
    if metavar == "TIME":
        return time_of(as_option(name), value)
    return listed(as_option(name), value) if "tuple" in str(model.model_fields[name].annotation) else value


def load_plugins(paths: Iterable[str | Path] | None) -> None:
    """Import every plugin file."""
    for path in paths or ():
        load_plugin(path)


def time_of(name: str, text: str) -> float:
    """Return the value of an option that is a time, in seconds. Raises `InvalidArgument` that names the option."""
    try:
        return seconds(text)
    except InvalidArgument as error:
        raise InvalidArgument(f"{name}: {error}") from error


def listed(option: str, text: str | None) -> tuple[str, ...]:
    """Split ``a, b(c=1, d=2)`` at the commas outside brackets. Raises `InvalidArgument` that names the option."""
    if text is None:
        return ()
    try:
        return tuple(split_specs(text))
    except InvalidArgument as error:
        raise InvalidArgument(f"{option}: {error}") from error


def resolved(paths: Iterable[Path]) -> tuple[str, ...]:
    """Return paths as absolute ones, which hold in any folder."""
    return tuple(str(path.resolve()) for path in paths)


def check_new_folder(folder: Path, *, overwrite: bool = False, replaced: Collection[str] = ()) -> None:
    """Raise `InvalidArgument` unless ``folder`` is new or empty and can be written.

    With ``overwrite`` it may also hold the files of a data set, ``replaced``, and nothing else.
    """
    standing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not standing.is_dir():
        raise InvalidArgument(f"--out: expected a folder, but {standing} is a file")
    if not os.access(standing, os.W_OK):
        raise InvalidArgument(f"--out: expected a folder that can be written, got {folder}")
    if standing != folder:
        return
    inside = {path.name for path in folder.iterdir()}
    further = sorted(inside.difference(replaced))
    if further:
        kept = "; --overwrite replaces a data set alone" if overwrite else ""
        raise InvalidArgument(f"--out: expected a new or an empty folder, but {folder} holds {further[0]!r}{kept}")
    if inside and not overwrite:
        raise InvalidArgument(
            f"--out: expected a new or an empty folder, but {folder} holds a data set; --overwrite replaces it"
        )
