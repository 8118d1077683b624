"""Cells of models: fit, read from a file, predict, refit without a condition."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.cells.data import Split
from evaluation.prediction.cases import SECOND, PredictionProtocol, measured_cases
from evaluation.prediction.scores import (
    PERSISTENCE,
    ConditionErrors,
    ModelPrediction,
)
from evaluation.prediction.scoring import Persistence, score_model, within_and_across
from evaluation.storage import load_result, save_result
from sysid_evo.artefacts import CheckpointFile, Manifest, read_artefact
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidData
from sysid_evo.models import DynamicsModel, load_model, save_model
from sysid_evo.models.base import make_model
from sysid_evo.plan import Cell, Work, cell_seed
from sysid_evo.registry import Spec, models
from sysid_evo.validation.measures import mean_over_channels

DIGEST = re.compile(r"-[0-9a-f]{8}$")
"""What a store puts behind the name of a file."""
FIT_SECONDS = {"quick": 2.0, "standard": 15.0, "paper": 15.0}


@dataclass(frozen=True, eq=False)
class FitCell(Cell):
    """Fits the family in ``spec``, all its parameters settled, to the training part of ``data``."""

    kind = "fit"
    place = "models"

    spec: Spec
    data: Cell
    seed: int
    preset: str = field(default="quick", compare=False)

    @property
    def title(self) -> str:
        return f"fit {self.spec.label}"

    @property
    def name(self) -> str:
        return self.spec.label

    @property
    def needs(self) -> tuple[Cell, ...]:
        return (self.data,)

    def inputs(self) -> dict[str, Any]:
        used = [models.identity(name) for name in make_model(self.spec).uses()]
        files = file_digests(self.spec)
        further = {**({"uses": used} if used else {}), **({"files": files} if files else {})}
        return {"model": models.identity(self.spec), "seed": self.seed, **further}

    @property
    def at_home(self) -> bool:
        return any(named_files(self.spec))

    def compute(self, work: Work) -> DynamicsModel:
        return self.learn(work.result(self.data).training, work)

    def learn(self, training: Dataset, work: Work) -> DynamicsModel:
        """Return a model of its family that was fitted to ``training``, with the same seed as the one of this cell."""
        rng = np.random.default_rng(cell_seed(self.seed, f"fit {self.spec.name}"))
        model = make_model(self.spec)
        model.checkpoint = CheckpointFile(work.checkpoint)
        model.fit(training, rng=rng, progress=work.progress)
        model.checkpoint = None
        return model

    @property
    def resumable(self) -> bool:
        return bool(getattr(models.get(self.spec.name), "resumable", False))

    def save(self, value: DynamicsModel, path: Path) -> list[Path]:
        return files_of(save_model(value, path, seed=self.seed, data=self.data.digest))

    def load(self, path: Path) -> DynamicsModel:
        return load_model(path)

    def seconds(self) -> float:
        budget = models.parameters(self.spec.name).get("budget")
        return float(self.spec.parameters.get("budget", budget or FIT_SECONDS.get(self.preset, 2.0)))


@dataclass(frozen=True, eq=False)
class PredictCell(Cell):
    """Measures the prediction error of a model on the test part of ``data``; without one, of persistence."""

    kind = "predict"

    label: str
    family: str
    data: Cell
    model: Cell | None = None
    protocol: PredictionProtocol = field(default_factory=PredictionProtocol)

    @property
    def title(self) -> str:
        return f"predict with {self.label}"

    @property
    def name(self) -> str:
        return f"prediction-{self.label}"

    @property
    def needs(self) -> tuple[Cell, ...]:
        return (self.data,) if self.model is None else (self.data, self.model)

    def inputs(self) -> dict[str, Any]:
        return {"protocol": {**asdict(self.protocol), "horizons": list(self.protocol.horizons)}}

    def compute(self, work: Work) -> ModelPrediction:
        parts = work.result(self.data)
        cases = measured_cases(parts.training, parts.test, self.protocol)
        if self.model is None:
            model: DynamicsModel = Persistence().fit(parts.training, rng=np.random.default_rng(0))
        else:
            model = work.result(self.model)
        return score_model(self.label, model, cases, family=self.family)

    def save(self, value: ModelPrediction, path: Path) -> list[Path]:
        return save_result(value, path)

    def load(self, path: Path) -> ModelPrediction:
        return load_result(ModelPrediction, path)

    def named(self, value: ModelPrediction) -> ModelPrediction:
        return replace(value, name=self.label, family=self.family)

    @classmethod
    def persistence(cls, data: Cell) -> PredictCell:
        """Return the cell of the yardstick that a model must beat."""
        return cls(PERSISTENCE, PERSISTENCE, data)


@dataclass(frozen=True)
class HeldOutScore:
    """Normalised error N of a model after ``steps`` on held-out data that form ``blocks`` blocks of time.

    ``judged_on`` names these data in words; ``n`` is None if they do not allow an estimate.
    """

    n: float | None
    steps: int | None
    blocks: int | None
    judged_on: str


@dataclass(frozen=True, eq=False)
class JudgeCell(Cell):
    """Measures the prediction error on the test part; without one, of a copy fitted to all but the last quarter.

    A model that held data out during its own fit already reports its error on them; no copy is fitted.
    """

    kind = "judge"

    fit: FitCell
    protocol: PredictionProtocol = field(default_factory=PredictionProtocol)

    @property
    def title(self) -> str:
        return f"judge {self.fit.name}"

    @property
    def name(self) -> str:
        return f"judged-{self.fit.name}"

    @property
    def needs(self) -> tuple[Cell, ...]:
        return (self.fit.data, self.fit)

    def inputs(self) -> dict[str, Any]:
        return {"protocol": {**asdict(self.protocol), "horizons": list(self.protocol.horizons)}}

    def compute(self, work: Work) -> HeldOutScore:
        parts, model, judged_on = work.result(self.fit.data), work.result(self.fit), "the test part"
        if parts.test is None and model.held_out_error_ is not None:
            moving = [e.states[rows] for e, rows in zip(parts.training, parts.training.moving, strict=True)]
            spread = model.system.spread(np.concatenate(moving))
            errors = np.divide(model.held_out_error_, spread, out=np.full_like(spread, np.nan), where=spread > 0.0)
            second = round(SECOND / model.system.dt)
            return HeldOutScore(float(mean_over_channels(errors)), second, None, "what it held out while it was fitted")
        try:
            if parts.test is None:
                parts = Split().of(parts.training)
                judged_on = "the last quarter of the data, which a copy of it has not learned from"
            cases = measured_cases(parts.training, parts.test, self.protocol)
            horizon = cases.main_horizon
            if judged_on != "the test part":
                model = self.fit.learn(parts.training, work)
            score = score_model(self.fit.name, model, cases, family="").score(horizon)
        except InvalidData as error:
            return HeldOutScore(None, None, None, str(error))
        if score is None or not np.isfinite(score.n):
            return HeldOutScore(None, None, None, "; ".join(cases.notes))
        return HeldOutScore(score.n, horizon, cases.blocks(horizon), judged_on)

    def save(self, value: HeldOutScore, path: Path) -> list[Path]:
        return save_result(value, path)

    def load(self, path: Path) -> HeldOutScore:
        return load_result(HeldOutScore, path)

    def seconds(self) -> float:
        return self.fit.seconds()


@dataclass(frozen=True, eq=False)
class StoredModel(Cell):
    """A model in a file of its own, outside any run: found by what the file holds."""

    kind = "model"
    place = "models"

    path: Path

    @property
    def title(self) -> str:
        return f"read {self.path}"

    @property
    def name(self) -> str:
        return DIGEST.sub("", self.path.stem)

    @cached_property
    def manifest(self) -> Manifest:
        """What stands in its manifest. Raises `ArtefactError`."""
        return read_artefact(self.path, "model")[0]

    @property
    def family(self) -> str:
        """The registered name of its family."""
        return self.manifest.name

    def inputs(self) -> dict[str, Any]:
        manifest = self.manifest
        return {
            "model": models.identity(Spec(manifest.name, manifest.parameters)),
            "system": manifest.system,
            "learned": manifest.learned,
            "tensors": manifest.sha256,
        }

    def compute(self, work: Work) -> DynamicsModel:
        return load_model(self.path)

    def save(self, value: DynamicsModel, path: Path) -> list[Path]:
        return files_of(save_model(value, path, seed=self.manifest.seed, data=self.manifest.data))

    def load(self, path: Path) -> DynamicsModel:
        return load_model(path)


def files_of(manifest: Path) -> list[Path]:
    """Return both files of an artefact."""
    return [manifest, manifest.with_name(manifest.name.removesuffix(".json") + ".safetensors")]


@dataclass(frozen=True, eq=False)
class ConditionsCell(Cell):
    """Fits the family of ``fit`` once for each condition without it, and measures it there beside the fitted model."""

    kind = "conditions"

    fit: FitCell
    conditions: int
    protocol: PredictionProtocol = field(default_factory=PredictionProtocol)

    @property
    def title(self) -> str:
        return f"leave conditions out of {self.fit.name}"

    @property
    def name(self) -> str:
        return f"conditions-{self.fit.name}"

    @property
    def needs(self) -> tuple[Cell, ...]:
        return (self.fit.data, self.fit)

    def inputs(self) -> dict[str, Any]:
        protocol = {**asdict(self.protocol), "horizons": list(self.protocol.horizons)}
        return {"model": models.identity(self.fit.spec), "protocol": protocol}

    def compute(self, work: Work) -> tuple[ConditionErrors, ...]:
        parts = work.result(self.fit.data)

        def learn(rest: Dataset) -> DynamicsModel:
            seed = cell_seed(self.fit.seed, f"fit {self.fit.spec.name}")
            model: DynamicsModel = make_model(self.fit.spec)
            return model.fit(rest, rng=np.random.default_rng(seed))

        return within_and_across(work.result(self.fit), learn, parts.training, parts.test, self.protocol)

    def save(self, value: tuple[ConditionErrors, ...], path: Path) -> list[Path]:
        return save_result(value, path)

    def load(self, path: Path) -> tuple[ConditionErrors, ...]:
        return load_result(tuple[ConditionErrors, ...], path)

    def seconds(self) -> float:
        return self.conditions * FIT_SECONDS.get(self.fit.preset, 2.0)


def file_digests(spec: Spec) -> list[str]:
    """Return the SHA-256 of every file, with its other half, that a parameter of ``spec`` names."""
    return [hashlib.sha256(file.read_bytes()).hexdigest() for file in named_files(spec)]


def named_files(spec: Spec) -> Iterator[Path]:
    """Yield the files, with their halves, that the parameters of ``spec`` name."""
    for value in spec.parameters.values():
        for text in value if isinstance(value, (list, tuple)) else [value]:
            if isinstance(text, str):
                stem = text.removesuffix(".safetensors").removesuffix(".json")
                yield from (file for file in map(Path, (f"{stem}.json", f"{stem}.safetensors")) if file.is_file())
