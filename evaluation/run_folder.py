"""The layout of a run folder: check, newest run, content, unneeded files."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

from evaluation.experiment import FILE, Experiment
from sysid_evo.errors import InvalidArgument
from sysid_evo.plan import CHECKPOINT, Store


def check_run_folder(out: str | Path | None) -> Path:
    """Return ``out``, or a new ``runs/<time>``, if it can be written and is new, empty or a run; nothing is created.

    Raises `InvalidArgument`.
    """
    folder = Path(out) if out is not None else Path("runs") / time.strftime("%Y-%m-%d_%H-%M-%S")
    existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not existing.is_dir():
        raise InvalidArgument(f"--out: expected a folder, but {existing} is a file")
    try:
        with tempfile.TemporaryFile(dir=existing):
            inside = sorted(path.name for path in folder.iterdir()) if existing == folder else []
    except OSError as error:
        raise InvalidArgument(
            f"--out: expected a folder that can be written, got {folder}: {error.strerror}"
        ) from error
    if inside and not is_run(folder):
        raise InvalidArgument(
            f"--out: expected a new folder, an empty one, or a run; {folder} contains {inside[0]!r} and is no run"
        )
    return folder


def is_run(folder: Path) -> bool:
    """Whether ``folder`` is a run folder."""
    return (folder / FILE).is_file() or (folder / "cells").is_dir()


def seed_of_run(run: Path | None) -> int:
    """Return the seed of the experiment in a run folder, 0 if there is none, so that all use the same trials."""
    seed: int = 0 if run is None else stored_settings(run).get("seed", 0)
    return seed


def stored_settings(folder: Path) -> dict[str, Any]:
    """Return the settings of the experiment in a folder, none if it has none. Raises `InvalidArgument`."""
    return Experiment.read(folder) if (folder / FILE).is_file() else {}


CHOSEN = "recommended"
"""The file in ``controllers`` with a copy of the recommended controller, under its own name."""


def run_of_controller(controller: Path) -> Path | None:
    """Return the run folder of a controller's file, if it is in one."""
    folder = controller.resolve().parent
    return folder.parent if folder.name == "controllers" else None


def latest_run_folder(run: Path | None) -> Path:
    """Return ``run``, or the newest folder in ``runs/`` that contains models. Raises `InvalidArgument`."""
    if run is not None:
        if not run.is_dir():
            raise InvalidArgument(f"--run: expected a run folder, found none at {run}")
        return run
    found = sorted(Path("runs").glob("*/models"), key=lambda path: path.stat().st_mtime)
    if not found:
        raise InvalidArgument("no run folder given, and runs/ has none with models: fit some first, or use --run")
    return found[-1].parent


def runs_in(folder: Path) -> list[Path]:
    """Return the run folders in ``folder``, the oldest first."""
    found = [path for path in folder.glob("*") if path.is_dir() and is_run(path)]
    return sorted(found, key=lambda path: path.stat().st_mtime)


def store_of_run(run: Path) -> Store:
    """Return the store of a run folder. Raises `InvalidArgument` if it is none."""
    if not is_run(run):
        raise InvalidArgument(f"expected a run folder, found none at {run}")
    return Store(run)


def settings_of_run(run: Path) -> dict[str, Any]:
    """Return `stored_settings`. Raises `InvalidArgument` if ``run`` is no run folder."""
    return stored_settings(store_of_run(run).path)


def summary_of_run(run: Path) -> dict[str, Any]:
    """Return the number of cells by state, their duration, the fitted models, and whether there is a report."""
    records = store_of_run(run).records()
    return {
        "run": str(run),
        "done": sum(record.status == "done" for record in records),
        "failed": sum(record.status == "failed" for record in records),
        "seconds": round(sum(record.seconds for record in records), 1),
        "models": sorted({record.name for record in records if record.kind == "fit"}),
        "report": (run / "report.html").is_file(),
    }


def unneeded_files(run: Path) -> list[Path]:
    """Return the files in a run folder that no finished cell needs. Raises `InvalidArgument` during a computation."""
    store = store_of_run(run)
    if store.busy():
        raise InvalidArgument(f"{run}: a process is computing in this run; wait until it has finished")
    kept = {name for record in store.records() if record.status == "done" for name in record.files}
    return [
        file
        for place in ("cells", "data", "models", "controllers", "results")
        for file in sorted((run / place).rglob("*"))
        if file.is_file() and ".locks" not in file.parts and _is_litter(file, run, kept, store)
    ]


def _is_litter(file: Path, run: Path, kept: set[str], store: Store) -> bool:
    name = file.relative_to(run)
    copied = name.parent.as_posix() == "controllers" and file.stem == CHOSEN and name.as_posix() not in kept
    if name.parts[:2] == ("results", "measured") or "journal" in name.parts or copied:
        return False
    if file.suffix == CHECKPOINT:
        owner = store.find(file.stem)
        return owner is not None and owner.status == "done"
    if name.parts[0] != "cells":
        return name.as_posix() not in kept
    record = store.find(file.stem) if file.suffix == ".json" else None
    return record is None or record.status == "failed"
