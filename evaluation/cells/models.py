"""Cells of models: fit, read from a file, predict, refit without a condition."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.cells.data import HoldOut
from evaluation.prediction.cases import SECOND, PredictionProtocol, measured_cases
from evaluation.prediction.scores import ConditionError, ModelPrediction
from evaluation.prediction.scoring import Persistence, condition_errors, score_model
from evaluation.storage import result_of
from sysid_evo.artefacts import CheckpointFile, Manifest, read_artefact
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidData
from sysid_evo.models import DynamicsModel, load_model, save_model
from sysid_evo.models.base import make_model
from sysid_evo.models.sanity import SanityCheck
from sysid_evo.plan import CELL_KINDS, Cell, CellContext, CellKind, CellSettings, ResultType, cell_seed
from sysid_evo.registry import Spec, models
from sysid_evo.validation.measures import mean_over_channels

DIGEST = re.compile(r"-[0-9a-f]{8}$")
"""Suffix that a store adds to the name of a file."""
PROTOCOL = PredictionProtocol()
FIT_SECONDS = {"quick": 2.0, "standard": 15.0, "paper": 15.0}


@dataclass(frozen=True)
class Fit(CellSettings):
    """Fit of the family in ``spec``, with all its parameters given, to the training part of ``data``."""

    spec: Spec
    data: Cell
    seed: int
    preset: str = "quick"

    def cell(self) -> Cell[Fit]:
        usual = models.parameters(self.spec.name).get("budget") or FIT_SECONDS.get(self.preset, 2.0)
        return Cell(
            kind="fit",
            name=self.spec.label,
            title=f"fit {self.spec.label}",
            settings=self,
            needs=(self.data,),
            expected_seconds=float(self.spec.parameters.get("budget", usual)),
            resumable=bool(getattr(models.get(self.spec.name), "resumable", False)),
            local_only=any(named_files(self.spec)),
        )

    def inputs(self) -> dict[str, Any]:
        used = [models.identity(name) for name in make_model(self.spec).families_used()]
        files = file_digests(self.spec)
        further = {**({"families_used": used} if used else {}), **({"files": files} if files else {})}
        return {"model": models.identity(self.spec), "seed": self.seed, **further}

    def compute(self, work: CellContext) -> DynamicsModel:
        return self.learn(work.result(self.data).training, work)

    def learn(self, training: Dataset, work: CellContext | None = None) -> DynamicsModel:
        """Return a model of its family fitted to ``training``, with the same seed as the model of this cell.

        With ``work`` it reports its progress there, and resumes after an interruption.
        """
        model = make_model(self.spec)
        model.checkpoint = None if work is None else CheckpointFile(work.checkpoint)
        rng = np.random.default_rng(cell_seed(self.seed, f"fit {self.spec.name}"))
        model.fit(training, rng=rng, progress=None if work is None else work.progress)
        model.checkpoint = None
        return model

    @property
    def origin(self) -> dict[str, Any]:
        """Origin of the model, as stored in its manifest."""
        return {"seed": self.seed, "data": self.data.digest}


@dataclass(frozen=True)
class Predict(CellSettings):
    """Prediction error of a model on the test part of ``data``; without a model, of persistence."""

    label: str
    family: str
    data: Cell
    model: Cell | None = None

    def cell(self) -> Cell[Predict]:
        return Cell(
            kind="predict",
            name=f"prediction-{self.label}",
            title=f"predict with {self.label}",
            settings=self,
            needs=(self.data,) if self.model is None else (self.data, self.model),
            labels={"name": self.label, "family": self.family},
        )

    def inputs(self) -> dict[str, Any]:
        return {"protocol": asdict(PROTOCOL)}

    def compute(self, work: CellContext) -> ModelPrediction:
        parts = work.result(self.data)
        cases = measured_cases(parts.training, parts.test, PROTOCOL)
        if self.model is None:
            persistence = Persistence().fit(parts.training, rng=np.random.default_rng(0))
            return score_model(self.label, persistence, cases, family=self.family)
        check = SanityCheck.of((parts.training, parts.test))
        return score_model(self.label, work.result(self.model), cases, family=self.family, check=check)


@dataclass(frozen=True)
class HeldOutScore:
    """Normalised error N of a model after ``steps`` on held-out data that form ``blocks`` blocks of time.

    ``evaluated_on`` names these data in words; ``n`` is None if they do not allow an estimate. ``warning`` is that of
    the `SanityCheck`.
    """

    n: float | None
    steps: int | None
    blocks: int | None
    evaluated_on: str
    warning: str = ""


@dataclass(frozen=True)
class ScoreFit(CellSettings):
    """Prediction error on the test part; without one, of a copy fitted to all but the last quarter.

    If a model held data out during its own fit, its error on them is used, and no copy is fitted.
    """

    fit: Cell[Fit]

    def cell(self) -> Cell[ScoreFit]:
        name = self.fit.name
        return Cell(
            kind="score",
            name=f"scored-{name}",
            title=f"score {name}",
            settings=self,
            needs=(self.fit.settings.data, self.fit),
            expected_seconds=self.fit.expected_seconds,
        )

    def inputs(self) -> dict[str, Any]:
        return {"protocol": asdict(PROTOCOL)}

    def compute(self, work: CellContext) -> HeldOutScore:
        fit = self.fit.settings
        parts, model, evaluated_on = work.result(fit.data), work.result(self.fit), "the test part"
        if parts.test is None and model.held_out_error_ is not None:
            moving = [e.states[rows] for e, rows in zip(parts.training, parts.training.moving, strict=True)]
            spread = model.system.spread(np.concatenate(moving))
            errors = np.divide(model.held_out_error_, spread, out=np.full_like(spread, np.nan), where=spread > 0.0)
            second = round(SECOND / model.system.dt)
            return HeldOutScore(float(mean_over_channels(errors)), second, None, "the data held out during its fit")
        try:
            if parts.test is None:
                parts = HoldOut().of(parts.training)
                evaluated_on = "the last quarter of the data (a copy was fitted to the rest)"
            cases = measured_cases(parts.training, parts.test, PROTOCOL)
            horizon = cases.main_horizon
            if evaluated_on != "the test part":
                model = fit.learn(parts.training, work)
            check = SanityCheck.of((parts.training, parts.test))
            found = score_model(self.fit.name, model, cases, family="", check=check)
            score = found.score(horizon)
        except InvalidData as error:
            return HeldOutScore(None, None, None, str(error))
        if score is None or not np.isfinite(score.n):
            return HeldOutScore(None, None, None, "; ".join(cases.notes))
        return HeldOutScore(score.n, horizon, cases.blocks(horizon), evaluated_on, found.warning)


@dataclass(frozen=True)
class StoredModelCell(CellSettings):
    """A model in a file outside any run, identified by the content of the file."""

    path: Path

    def cell(self) -> Cell[StoredModelCell]:
        name = DIGEST.sub("", self.path.stem)
        return Cell(kind="model", name=name, title=f"read {self.path}", settings=self, local=True)

    @cached_property
    def manifest(self) -> Manifest:
        """Its manifest. Raises `ArtefactError`."""
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

    def compute(self, work: CellContext) -> DynamicsModel:
        return load_model(self.path)

    @property
    def origin(self) -> dict[str, Any]:
        """Origin of the model, as stored in its manifest."""
        return {"seed": self.manifest.seed, "data": self.manifest.data}


def files_of(manifest: Path) -> list[Path]:
    """Return both files of an artefact."""
    return [manifest, manifest.with_name(manifest.name.removesuffix(".json") + ".safetensors")]


@dataclass(frozen=True)
class LeaveConditionsOut(CellSettings):
    """Fit of the family of ``fit`` without each condition in turn; its error there next to that of the full fit."""

    fit: Cell[Fit]
    conditions: int

    def cell(self) -> Cell[LeaveConditionsOut]:
        name = self.fit.name
        return Cell(
            kind="conditions",
            name=f"conditions-{name}",
            title=f"leave conditions out of {name}",
            settings=self,
            needs=(self.fit.settings.data, self.fit),
            expected_seconds=self.conditions * FIT_SECONDS.get(self.fit.settings.preset, 2.0),
        )

    def inputs(self) -> dict[str, Any]:
        return {"model": models.identity(self.fit.settings.spec), "protocol": asdict(PROTOCOL)}

    def compute(self, work: CellContext) -> tuple[ConditionError, ...]:
        fit = self.fit.settings
        parts = work.result(fit.data)
        return condition_errors(work.result(self.fit), fit.learn, parts.training, parts.test, PROTOCOL)


def file_digests(spec: Spec) -> list[str]:
    """Return the SHA-256 of every file that a parameter of ``spec`` names, and of its second half."""
    return [hashlib.sha256(file.read_bytes()).hexdigest() for file in named_files(spec)]


def named_files(spec: Spec) -> Iterator[Path]:
    """Yield the files that the parameters of ``spec`` name, and their second halves."""
    for value in spec.parameters.values():
        for text in value if isinstance(value, (list, tuple)) else [value]:
            if isinstance(text, str):
                stem = text.removesuffix(".safetensors").removesuffix(".json")
                yield from (file for file in map(Path, (f"{stem}.json", f"{stem}.safetensors")) if file.is_file())


def _save(value: DynamicsModel, path: Path, cell: Cell[Fit | StoredModelCell]) -> list[Path]:
    return files_of(save_model(value, path, **cell.settings.origin))


MODELS = ResultType("models", _save, load_model)
CELL_KINDS["fit"] = CELL_KINDS["model"] = CellKind(MODELS, version=6)
CELL_KINDS["predict"] = CellKind(result_of(ModelPrediction), version=3)
CELL_KINDS["score"] = CellKind(result_of(HeldOutScore), version=2)
CELL_KINDS["conditions"] = CellKind(result_of(tuple[ConditionError, ...]), version=3)
