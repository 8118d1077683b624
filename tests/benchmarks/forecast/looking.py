"""What the controllers of a comparison do on its models and on the emulated car that it recorded."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.cells.plants import runner_of
from evaluation.exploitability.probes import ProbeLimit, probe_limits
from evaluation.prediction.scores import HORIZON
from evaluation.report.report import ReportDocument, load_report
from evaluation.report.sections.prediction import ModelPredictionPart
from evaluation.steps import Steps, training_support
from evaluation.transfer.matrix import transfer_seeds
from sysid_evo.controllers.controller import make_controller
from sysid_evo.data import Dataset
from sysid_evo.data.support import Support
from sysid_evo.engine import DynamicsRunner, Rollouts, Runner
from sysid_evo.evolution import Champion
from sysid_evo.evolution.champion import load_champion
from sysid_evo.files import write_atomically
from sysid_evo.models import DynamicsModel, load_model
from sysid_evo.registry import robot_spec
from sysid_evo.tasks.task import make_task
from sysid_evo.types import Array

TRIALS, TRUTH, OTHER = 100, 300, 1_000_000
"""Trials on every model, trials on the car, and what is added to the seed so that these are other ones."""
RECORDED = 2
"""Trials whose states are looked at."""

Record = dict[str, Any]


@dataclass(frozen=True)
class Material:
    """The models of a run, and what is known about them without the car.

    Without ``support`` of the data neither what is outside them nor probes are looked at.
    """

    models: dict[str, DynamicsModel]
    families: dict[str, str]
    errors: dict[str, float | None]
    seed: int
    support: Support | None = None
    limits: Sequence[ProbeLimit] = ()

    @classmethod
    def of(cls, run: Path, report: ReportDocument) -> Material:
        """Read the models of the comparison in ``run``."""
        training = Dataset.load(next((run / "data").glob("*/training")))
        assert report.prediction is not None
        named = {model.name: model for model in report.models}
        return cls(
            models={name: load_model(_newest(run / "models", name)) for name in named},
            families={name: model.family for name, model in named.items()},
            errors={model.name: _error(model) for model in report.prediction.models},
            support=training_support(training),
            limits=probe_limits(Steps.moving(training)),
            seed=report.run.settings["seed"],
        )


def look(run: Path, out: Path) -> list[Record]:
    """Return a record for each finalist of the comparison in ``run``; results are stored in ``out``.

    The trials on the car are other ones than those on the models.
    """
    kept = out / f"{run.parent.name}-{run.name}.json"
    if kept.is_file():
        found: list[Record] = json.loads(kept.read_text(encoding="utf-8"))
        return found
    report = load_report(run)
    material = Material.of(run, report)
    car = runner_of(robot_spec(report.run.settings["robot"]))
    records: dict[str, Record] = {}
    assert report.controllers is not None
    for one in report.controllers.controllers:
        if one.file and one.against and not one.evolved_on_robot:
            champion = load_champion((run / one.file).with_suffix(""))
            for record in records_of(champion, one.name, material, car):
                records.setdefault(record["digest"], record)
    text = json.dumps(list(records.values()), allow_nan=False)
    write_atomically(kept, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return list(records.values())


def records_of(champion: Champion, name: str, material: Material, car: Runner) -> list[Record]:
    """Return the behaviour of each finalist, the champion first."""
    others = [f.parameters for f in champion.finalists if not np.array_equal(f.parameters, champion.parameters)]
    everyone = np.stack([champion.parameters, *others])
    columns = {label: _column(champion, everyone, label, material) for label in material.models}
    truth = _run(champion, everyone, car, material.seed + OTHER, TRUTH).fitness
    return [
        {
            "name": name,
            "digest": hashlib.sha256(parameters.tobytes()).hexdigest(),
            "against": list(champion.against),
            "achieved": float(truth[number].mean()),
            "columns": {label: rows[number] for label, rows in columns.items()},
        }
        for number, parameters in enumerate(everyone)
    ]


def _column(champion: Champion, everyone: Array, label: str, material: Material) -> list[Record]:
    """Return the results of all finalists on one model: fitness, share outside the data, worst plausibility check."""
    runner, support = DynamicsRunner(material.models[label]), material.support
    fitness = _run(champion, everyone, runner, material.seed, TRIALS).fitness
    told = {"family": material.families[label], "error": material.errors[label]}
    if support is None:
        return [{**told, "fitness": own.tolist()} for own in fitness]
    recorded = _run(champion, everyone, runner, material.seed, RECORDED, record=True)
    whose = np.flatnonzero(recorded.survived.ravel() > 0) // RECORDED
    found = []
    for number in range(len(everyone)):
        runs = [run for which, run in zip(whose, recorded.trajectories, strict=True) if which == number]
        steps = Steps.of(support.system, runs)
        shares = [limit.share(steps) or 0.0 for limit in material.limits]
        found.append(
            {
                **told,
                "fitness": fitness[number].tolist(),
                "outside": steps.share_outside(support) or 0.0,
                "probed": max(shares, default=0.0),
            }
        )
    return found


def _run(
    champion: Champion, everyone: Array, runner: Runner, seed: int, trials: int, *, record: bool = False
) -> Rollouts:
    controller, task = make_controller(champion.controller), make_task(champion.task)
    return runner.bind(controller, task)(everyone, transfer_seeds(seed, trials), record=record)


def _newest(folder: Path, name: str) -> Path:
    """Return the path of the model of this name, without suffix."""
    files = [file for file in folder.glob("*.json") if file.stem.rpartition("-")[0] == name]
    return max(files, key=lambda file: file.stat().st_mtime).with_suffix("")


def _error(model: ModelPredictionPart) -> float | None:
    """Return N after a second, else after the longest horizon, as `error_of` does."""
    at = [score.n for score in model.scores if score.steps == HORIZON] or [score.n for score in model.scores[-1:]]
    return at[0] if at else None
