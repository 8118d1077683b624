"""A study in one call: plan it, compute what is missing, write what was found."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from evaluation.comparison import check_run_folder
from evaluation.study.gathering import gather
from evaluation.study.parquet import save_parquet
from evaluation.study.planning import PlannedStudy, plan_study
from evaluation.study.results import StudyResults
from evaluation.study.study import FILE, Study
from sysid_evo.errors import InvalidArgument
from sysid_evo.plan import Observer, Scheduler, Store, execute


def run_study(
    study: Study | str | Path | Mapping[str, Any],
    *,
    out: str | Path | None = None,
    observer: Observer | None = None,
    jobs: int | None = None,
    scheduler: Scheduler | None = None,
) -> StudyResults:
    """Compute what is missing of a study and return what was found; it is written into the folder ``out``, too.

    ``study`` is a `Study`, its file, or its settings. ``out`` is ``runs/<name of the file>`` if it is left out.
    Up to ``jobs`` cells are computed side by side, or those that the workers of a ``scheduler`` have room for::

        from evaluation import run_study

        found = run_study({
            "title": "Two families on two cars",
            "experiment": {"models": ["linear", "nearest_neighbour"], "minutes": 1.0, "generations": 20},
            "grid": {"robot": ["emulated_car", "emulated_car(seed=1)"], "seed": "0..1"},
        }, out="runs/two_families")
        print([(row.point, row.controller, row.achieved) for row in found.controllers])

    Raises what `plan_study` does, before any work.
    """
    found = study if isinstance(study, Study) else Study.of(study) if isinstance(study, Mapping) else Study.read(study)
    if out is None and not isinstance(study, (str, Path)):
        raise InvalidArgument("out: expected a folder for a study that is not in a file")
    folder = study_folder(out, Path(str(study)))
    planned = plan_study(found)
    found.write(folder / FILE)
    execute(planned.plan, Store(folder), observer=observer, jobs=jobs, scheduler=scheduler)
    return finish(planned, folder)


def study_folder(out: str | Path | None, file: Path) -> Path:
    """Return ``out``, else ``runs/<name of the file>``, if it is new, empty or a run. Raises `InvalidArgument`."""
    return check_run_folder(Path("runs") / file.stem if out is None else out)


def finish(planned: PlannedStudy, folder: Path) -> StudyResults:
    """Return what stands in ``folder``, and write tables, document and page there."""
    from evaluation.report.study import save_study

    results = gather(planned, folder)
    save_parquet(results, folder)
    save_study(results, folder)
    return results
