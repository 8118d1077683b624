"""The main job in one call: fit families, evolve controllers, compare both."""

from __future__ import annotations

import hashlib
import json
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from evaluation.comparison.experiment import FILE, Experiment
from evaluation.comparison.planning import Comparison, check_experiment, plan_comparison
from evaluation.report import Report, save_report
from evaluation.transfer import load_measured
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidArgument
from sysid_evo.plan import Observer, Scheduler, Store, execute
from sysid_evo.registry import load_plugin


def compare(
    data: Dataset | str | Path | Iterable[str | Path] | None = None,
    *,
    out: str | Path | None = None,
    observer: Observer | None = None,
    jobs: int | None = None,
    scheduler: Scheduler | None = None,
    **settings: Any,
) -> Report:
    """Fit models, evolve controllers in them, and compare both; return the report.

    ``data`` is a data set or where its logs are; without it an emulated car is recorded. ``out`` is the
    run folder, where results are kept and found again (default: a new ``runs/<time>``); the report is
    written there too. Up to ``jobs`` cells are computed side by side, or those that the workers of a ``scheduler``
    have room for, see `execute`. ``settings`` are those of `Experiment`::

        from evaluation import compare

        report = compare(
            "logs/",
            test=["last_drive"],
            models=["linear", "near2=nearest_neighbour(state_lags=2)", "parametrised"],
            ensembles=["near2+parametrised"],
            task="point_to_point(arena_radius=1.0)",
            seed=1,
        )
        print(report.transfer.pick, report.prediction.ranking(20)[0].name)

    Raises what `plan_comparison` does, before any work.
    """
    folder = check_run_folder(out)
    dataset = data if isinstance(data, Dataset) else None
    if data is not None and not isinstance(data, Dataset):
        listed = [data] if isinstance(data, (str, Path)) else list(data)
        settings = {**settings, "data": tuple(str(Path(path).resolve()) for path in listed)}
    experiment = Experiment.of({name: _plain(value) for name, value in settings.items()})
    for plugin in experiment.plugins:
        load_plugin(plugin)
    check_experiment(experiment)
    if dataset is None and experiment.data is not None:
        dataset = Dataset.read(experiment.data, columns=experiment.columns)
    measured, _ = load_measured(folder)
    comparison = plan_comparison(experiment, dataset=dataset, measured=measured)
    comparison.experiment.write(folder / FILE)
    store = Store(folder)
    execute(comparison.plan, store, observer=observer, jobs=jobs, scheduler=scheduler)
    return finished(comparison, store)


def finished(comparison: Comparison, store: Store, *, afresh: bool = False) -> Report:
    """Return the report of what ``store`` holds, and write it into the run folder.

    A page that shows just that already is drawn again only if it is wanted ``afresh``.
    """
    report = Report.of(comparison, store)
    results = [(cell.digest, None if record is None else (record.status, record.files))
               for cell in comparison.plan for record in [store.find(cell.digest)]]  # fmt: skip
    save_report(report, store.path, of=hashlib.sha256(json.dumps(results).encode()).hexdigest(), afresh=afresh)
    return report


def check_run_folder(out: str | Path | None) -> Path:
    """Return ``out``, or a new ``runs/<time>``, if it can be written and is new, empty or a run; nothing is made.

    Raises `InvalidArgument`.
    """
    folder = Path(out) if out is not None else Path("runs") / time.strftime("%Y-%m-%d_%H-%M-%S")
    standing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not standing.is_dir():
        raise InvalidArgument(f"--out: expected a folder, but {standing} is a file")
    try:
        with tempfile.TemporaryFile(dir=standing):
            inside = sorted(path.name for path in folder.iterdir()) if standing == folder else []
    except OSError as error:
        raise InvalidArgument(
            f"--out: expected a folder that can be written, got {folder}: {error.strerror}"
        ) from error
    if inside and not is_run(folder):
        raise InvalidArgument(
            f"--out: expected a new folder, an empty one, or a run; {folder} holds {inside[0]!r} and is no run"
        )
    return folder


def is_run(folder: Path) -> bool:
    """Whether ``folder`` is a run folder."""
    return (folder / FILE).is_file() or (folder / "cells").is_dir()


def _plain(value: Any) -> Any:
    """Return lists as tuples and paths as text, so that the experiment can be stored."""
    if isinstance(value, (list, tuple)):
        return tuple(_plain(item) for item in value)
    return str(value) if isinstance(value, Path) else value
