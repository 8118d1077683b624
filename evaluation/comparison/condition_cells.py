"""What a family does in a condition that it has not learned from, as a cell."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.comparison.model_cells import FIT_SECONDS, FitCell, read_json, write_json
from evaluation.prediction import PredictionProtocol
from evaluation.prediction.conditions import ConditionErrors, within_and_across
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.plan import Cell, Work, cell_seed
from sysid_evo.registry import make_model, models


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
        return write_json([asdict(errors) for errors in value], path)

    def load(self, path: Path) -> tuple[ConditionErrors, ...]:
        return tuple(ConditionErrors(**errors) for errors in read_json(path))

    def seconds(self) -> float:
        return self.conditions * FIT_SECONDS.get(self.fit.preset, 2.0)
