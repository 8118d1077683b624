"""What the controllers of a study do on its models and on the emulated cars; all that its store holds is used."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from evaluation.cells.plants import runner_of
from evaluation.planning import Comparison
from evaluation.prediction.scores import error_of
from evaluation.study.planning import plan_study
from evaluation.study.study import Point, Study
from sysid_evo.cli.progress import PlanProgress
from sysid_evo.evolution import Champion
from sysid_evo.files import write_atomically
from sysid_evo.plan import Plan, Store, execute
from sysid_evo.registry import robot_spec
from tests.benchmarks.forecast.looking import Material, Record, records_of


def looked_for(comparison: Comparison) -> Plan:
    """Return the cells of models, predictions and controllers of a comparison, without the transfer matrix."""
    assert comparison.matrix is not None
    wanted = (*comparison.fits.values(), *comparison.predictions.values(), *comparison.matrix.controllers)
    return Plan.of(wanted)


def compute_points(study: Study, folder: Path, jobs: int) -> None:
    """Compute what `looked_for` of all points is not yet in the store in ``folder``."""
    planned = plan_study(study)
    wanted = [cell for _, comparison in planned.points for cell in looked_for(comparison).cells]
    with PlanProgress(f"--store {folder}", where=planned.where) as bars:
        execute(Plan.of(wanted), Store(folder), observer=bars, jobs=jobs)


def complete_points(study: Study, folder: Path) -> Iterator[tuple[Point, Comparison]]:
    """Yield the points of a study whose cells of `looked_for` are all in the store in ``folder``."""
    store = Store(folder)
    for point, comparison in plan_study(study).points:
        if all(store.find(cell.digest) is not None for cell in looked_for(comparison).cells):
            yield point, comparison


def look_at(point: Point, comparison: Comparison, folder: Path, out: Path) -> list[Record]:
    """Return a record for each finalist of a point; results are stored in ``out``.

    Models, errors and controllers are those of the store in ``folder``, where nothing is written. Finalists are run on
    the models in the trials of the transfer matrix, on the car in other ones.
    """
    kept = out / f"{point.name.replace(', ', '-').replace(' ', '-')}.json"
    if kept.is_file():
        found: list[Record] = json.loads(kept.read_text(encoding="utf-8"))
        return found
    store, experiment = Store(folder), comparison.experiment
    assert comparison.matrix is not None
    models = {label: store.outcome(fit).value for label, fit in comparison.fits.items()}
    known = [label for label, model in models.items() if model is not None]
    material = Material(
        models={label: models[label] for label in known},
        families={label: comparison.fits[label].settings.spec.name for label in known},
        errors={label: error_of(store.outcome(comparison.predictions[label]).value) for label in known},
        seed=experiment.seed,
    )
    robot = comparison.matrix.robot
    car = runner_of(robot_spec(experiment.robot or "emulated_car"))
    champions: list[Champion] = [store.outcome(cell).value for cell in comparison.matrix.controllers]
    records: dict[str, Record] = {}
    for champion in champions:
        if champion is not None and champion.against and robot not in champion.against:
            for record in records_of(champion, champion.name, material, car):
                records.setdefault(record["digest"], record)
    text = json.dumps(list(records.values()), allow_nan=False)
    write_atomically(kept, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return list(records.values())
