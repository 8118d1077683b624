"""Options generated from settings classes, and the few that commands share."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

from sysid_evo.errors import InvalidArgument

Seed: TypeAlias = Annotated[int | None, typer.Option(help="Everything random follows from it (0).", min=0)]

Preset: TypeAlias = Annotated[str | None, typer.Option(help="Budget: quick, standard or paper.")]

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
        help="What evolution must cope with, such as envelope(sensor=0.1, latency=2, gain=0.15), or none (default: "
        "what is usual for the task); see the docs."
    ),
]

Caution: TypeAlias = Annotated[
    str | None,
    typer.Option(help="What a trial loses in evolution where models cannot be believed, such as doubt(outside=5)."),
]

Generations: TypeAlias = Annotated[int | None, typer.Option(min=1, help="Of controllers, instead of the preset's.")]

Trials: TypeAlias = Annotated[int | None, typer.Option(min=1, help="Of every candidate in each generation.")]

Recipe: TypeAlias = Annotated[
    str | None,
    typer.Option(help="recommended (search in each model, choice by others, polish on all) or plain (all at once)."),
]

Schedule: TypeAlias = Annotated[
    str | None,
    typer.Option(help="Easier stages first: stage(task=NAME(parameter=value), models=[a, b], until=FITNESS), ..."),
]

Runs: TypeAlias = Annotated[
    int | None, typer.Option(min=1, help="From different seeds; the best counts, all are listed.")
]

EstimatorDelay: TypeAlias = Annotated[
    float | None,
    typer.Option(min=0.0, help="Milliseconds by which controllers know the state late, in evolution and claims."),
]


def load_plugins(paths: list[Path] | None) -> None:
    """Import every plugin file."""
    from sysid_evo.registry.plugins import load_plugin

    for path in paths or []:
        load_plugin(path)


def listed(option: str, text: str | None) -> tuple[str, ...] | None:
    """Split ``a, b(c=1, d=2)`` at the commas outside brackets. Raises `InvalidArgument` that names the option."""
    from sysid_evo.registry.grammar import split

    if text is None:
        return None
    try:
        return tuple(split(text))
    except InvalidArgument as error:
        raise InvalidArgument(f"{option}: {error}") from error


def given(**settings: Any) -> dict[str, Any]:
    """Return the settings that stand on the command line: those that are not None."""
    return {name: value for name, value in settings.items() if value is not None}


def seconds(milliseconds: float | None) -> float | None:
    """Return milliseconds as seconds."""
    return None if milliseconds is None else milliseconds / 1000.0


def check_new_folder(folder: Path) -> None:
    """Raise `InvalidArgument` unless ``folder`` is new or empty and can be written."""
    standing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not standing.is_dir():
        raise InvalidArgument(f"--out: expected a folder, but {standing} is a file")
    if not os.access(standing, os.W_OK):
        raise InvalidArgument(f"--out: expected a folder that can be written, got {folder}")
    if standing == folder and any(folder.iterdir()):
        raise InvalidArgument(f"--out: expected a new or an empty folder, but {folder} holds something already")


def split_members(text: str) -> tuple[str, ...]:
    """Split ``a,b,c`` at the commas outside brackets. Raises `InvalidArgument`."""
    members = listed("--against", text) or ()
    repeated = sorted({member for member in members if members.count(member) > 1})
    if repeated:
        raise InvalidArgument(f"--against: {', '.join(repeated)} is named twice")
    return members


def existing(columns: Path) -> str:
    """Return the path of a column map, or the name of a shipped one."""
    return str(columns.resolve()) if columns.exists() else str(columns)


def parsed(option: str, given: Sequence[str]) -> dict[str, str]:
    """Return patterns by condition from texts ``NAME=PATTERN``. Raises `InvalidArgument` that names the option."""
    patterns = {}
    for text in given:
        name, equals, pattern = text.partition("=")
        if not (name and equals and pattern):
            raise InvalidArgument(f"{option}: expected NAME=PATTERN, such as wet='rain_*', got {text!r}")
        if name in patterns:
            raise InvalidArgument(f"{option}: {name!r} is given twice")
        patterns[name] = pattern
    return patterns
