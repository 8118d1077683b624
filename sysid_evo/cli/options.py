"""Options that several commands have, and what their values become."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

from sysid_evo.cli.console import as_option
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry.grammar import split_specs
from sysid_evo.registry.plugins import load_plugin

Seed: TypeAlias = Annotated[int | None, typer.Option(help="Everything random follows from it (0).", min=0)]
Preset: TypeAlias = Annotated[str | None, typer.Option(help="Budget: quick (default), standard or paper.")]
Plugins: TypeAlias = Annotated[
    list[Path] | None, typer.Option("--plugin", help="Python file with further models, tasks, ...; repeatable.")
]
Columns: TypeAlias = Annotated[Path | None, typer.Option("--columns", help="TOML file: which column is which channel.")]
Test: TypeAlias = Annotated[
    list[str] | None, typer.Option("--test", help="Episode (file name without suffix) held back; repeatable.")
]
Json: TypeAlias = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]
DryRun: TypeAlias = Annotated[bool, typer.Option("--dry-run", help="Print what would be computed, and stop.")]
Out: TypeAlias = Annotated[Path | None, typer.Option("--out", help="Run folder (default runs/TIME).")]
Jobs: TypeAlias = Annotated[
    int | None, typer.Option(min=1, help="Cells computed side by side (default: one a processor).")
]
Scheduler: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="Compute the cells on a Dask cluster: tcp://HOST:PORT, tls://HOST:PORT, or the scheduler's .json file."
    ),
]
Task: TypeAlias = Annotated[str | None, typer.Option(help="What to achieve, NAME(parameter=value, ...).")]
Controller: TypeAlias = Annotated[str | None, typer.Option(help="What is evolved, NAME(parameter=value, ...).")]
Strategy: TypeAlias = Annotated[str | None, typer.Option(help="How it is evolved, NAME(parameter=value, ...).")]
Aggregate: TypeAlias = Annotated[
    str | None, typer.Option(help="How the fitnesses on several models become one: min, mean, median or a plugin's.")
]
Noise: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="What evolution must cope with, such as domain_randomisation(sensor=0.1, latency=2, gain=0.15), or none "
        "(default: "
        "what is usual for the task); see the docs."
    ),
]
Penalty: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="What a trial loses in evolution where models cannot be believed, such as uncertainty(outside=5)."
    ),
]
Generations: TypeAlias = Annotated[int | None, typer.Option(min=1, help="Of controllers, instead of the preset's.")]
Trials: TypeAlias = Annotated[int | None, typer.Option(min=1, help="Of every candidate in each generation.")]
Procedure: TypeAlias = Annotated[
    str | None,
    typer.Option(help="recommended (search in each model, choice by others, polish on all) or plain (all at once)."),
]
Schedule: TypeAlias = Annotated[
    str | None,
    typer.Option(help="Easier stages first: stage(task=NAME(parameter=value), models=[a, b], until=FITNESS), ..."),
]
Repeats: TypeAlias = Annotated[
    int | None, typer.Option(min=1, help="From different seeds; the best counts, all are listed.")
]

EstimatorDelay: TypeAlias = Annotated[
    float | None,
    typer.Option(min=0.0, help="Milliseconds by which controllers know the state late, in evolution and claims."),
]


def load_plugins(paths: Iterable[str | Path] | None) -> None:
    """Import every plugin file."""
    for path in paths or ():
        load_plugin(path)


def settings_of(values: Mapping[str, Any], names: Iterable[str]) -> dict[str, Any]:
    """Return the settings called ``names`` that the options of a command give.

    Option and setting have the same name, except ``plugin``; the value is converted to that of the setting.
    """
    becomes: dict[str, Callable[[Any], Any]] = {
        "data": resolved, "plugins": resolved, "columns": column_map, "test": tuple,
        "estimator_delay": lambda milliseconds: milliseconds / 1000.0,
        **{name: partial(listed, as_option(name)) for name in ("models", "ensembles", "baselines")},
    }  # fmt: skip
    values = {**values, "plugins": values.get("plugin")}
    return {
        name: becomes.get(name, lambda value: value)(values[name]) for name in names if values.get(name) is not None
    }


def listed(option: str, text: str | None) -> tuple[str, ...] | None:
    """Split ``a, b(c=1, d=2)`` at the commas outside brackets. Raises `InvalidArgument` that names the option."""
    if text is None:
        return None
    try:
        return tuple(split_specs(text))
    except InvalidArgument as error:
        raise InvalidArgument(f"{option}: {error}") from error


def resolved(paths: Sequence[Path] | None) -> tuple[str, ...] | None:
    """Return paths as absolute ones, which hold in any folder."""
    return None if paths is None else tuple(str(path.resolve()) for path in paths)


def column_map(columns: Path | None) -> str | None:
    """Return the absolute path of a column map, or the name of a shipped one."""
    return None if columns is None else str(columns.resolve() if columns.exists() else columns)


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
