"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

Seed: TypeAlias = Annotated[int, typer.Option(help="Everything random follows from it.", min=0)]
Preset: TypeAlias = Annotated[str, typer.Option(help="Budget: quick, standard or paper.")]
Plugins: TypeAlias = Annotated[
    list[Path] | None, typer.Option("--plugin", help="Python file with further models, tasks, ...; repeatable.")
]
Columns: TypeAlias = Annotated[Path | None, typer.Option("--columns", help="TOML file: which column is which channel.")]
Test: TypeAlias = Annotated[
    list[str] | None, typer.Option("--test", help="Episode (file name without suffix) held back; repeatable.")
]
Json: TypeAlias = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]

EstimatorDelay: TypeAlias = Annotated[
    float, typer.Option(min=0.0, help="Milliseconds by which controllers know the state late while they evolve.")
]


def load_plugins(paths: list[Path] | None) -> None:
    """Import every plugin file."""
    from sysid_evo.registry import load_plugin

    for path in paths or []:
        load_plugin(path)


def split_names(text: str | None) -> tuple[str, ...]:
    """Split ``a,b,c``."""
    return tuple(name.strip() for name in (text or "").split(",") if name.strip())


def new_run_folder(out: Path | None) -> Path:
    """Return ``out``, or a new ``runs/<time>``."""
    import time

    return out or Path("runs") / time.strftime("%Y-%m-%d_%H-%M-%S")


def latest_run_folder(run: Path | None) -> Path:
    """Return ``run``, or the newest folder in ``runs/`` that holds models."""
    from sysid_evo.errors import InvalidArgument

    if run is not None:
        return run
    found = sorted(Path("runs").glob("*/models"), key=lambda path: path.stat().st_mtime)
    if not found:
        raise InvalidArgument("no run folder given, and runs/ holds none with models: fit some first, or use --run")
    return found[-1].parent
