"""Models as cells: fitting one, and measuring how well it predicts."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.comparison.named_files import file_digests, named_files
from evaluation.prediction import (
    FORM,
    PERSISTENCE,
    ModelPrediction,
    Persistence,
    PredictionProtocol,
    load_prediction,
    measured_cases,
    save_prediction,
    score_model,
)
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.plan import Cell, Work, cell_seed
from sysid_evo.registry import Spec, make_model, models
from sysid_evo.store import CheckpointFile, load_model, save_model
from sysid_evo.store.manifest import Manifest, read_artefact

DIGEST = re.compile(r"-[0-9a-f]{8}$")
"""What a store puts behind the name of a file."""
FIT_SECONDS = {"quick": 2.0, "standard": 15.0, "paper": 15.0}


def with_preset(spec: Spec, preset: str) -> Spec:
    """Return the spec of a model with what the preset of its family changes; its own parameters win."""
    family: Any = models.get(spec.name)
    return spec.with_parameters(**family.presets.get(preset, {}))


def without_preset(spec: Spec, preset: str) -> Spec:
    """Return the spec of a model without the values that its family has from ``preset``."""
    family: Any = models.get(spec.name)
    brought = family.presets.get(preset, {})
    own = {key: value for key, value in spec.parameters.items() if key not in brought or value != brought[key]}
    return Spec(spec.name, own, spec.label)


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
        training = work.result(self.data).training
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
        return {"form": FORM, "protocol": {**asdict(self.protocol), "horizons": list(self.protocol.horizons)}}

    def compute(self, work: Work) -> ModelPrediction:
        parts = work.result(self.data)
        cases = measured_cases(parts.training, parts.test, self.protocol)
        if self.model is None:
            model: DynamicsModel = Persistence().fit(parts.training, rng=np.random.default_rng(0))
        else:
            model = work.result(self.model)
        return score_model(self.label, model, cases, family=self.family)

    def save(self, value: ModelPrediction, path: Path) -> list[Path]:
        return save_prediction(value, path)

    def load(self, path: Path) -> ModelPrediction:
        return load_prediction(path)

    def named(self, value: ModelPrediction) -> ModelPrediction:
        return replace(value, name=self.label, family=self.family)

    @classmethod
    def persistence(cls, data: Cell) -> PredictCell:
        """Return the cell of the yardstick that a model must beat."""
        return cls(PERSISTENCE, PERSISTENCE, data)


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


def write_json(value: Any, path: Path) -> list[Path]:
    """Write strict JSON to ``path`` with the suffix; return the file."""
    from sysid_evo.files import write_atomically

    text = json.dumps(value, allow_nan=False)
    file = path.with_name(path.name + ".json")
    return [write_atomically(file, lambda temporary: temporary.write_text(text, encoding="utf-8"))]


def read_json(path: Path) -> Any:
    """Read what `write_json` wrote."""
    return json.loads(path.with_name(path.name + ".json").read_text(encoding="utf-8"))
