"""Rows of the transfer matrix that need no evolution: controllers written by hand, some with a model inside."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

from evaluation.comparison.champion_cells import ControllerFiles
from evaluation.comparison.columns import Column
from evaluation.comparison.named_files import file_digests, named_files
from sysid_evo.evolution import Champion
from sysid_evo.plan import Cell, Work
from sysid_evo.registry import Spec, controllers, tasks
from sysid_evo.system import System

MODEL = "model"
"""The parameter by which a controller names the models inside it."""


@dataclass(frozen=True, eq=False)
class HandWrittenCell(ControllerFiles):
    """Makes a controller that is run as it is on ``system``; files that it names count by what is in them.

    ``models`` are the cells of the models of the comparison that its parameter ``model`` names by their labels.
    """

    kind = "by_hand"
    members: ClassVar[tuple[Column, ...]] = ()

    spec: Spec
    task: Spec
    system: System
    models: Mapping[str, Cell] = field(default_factory=dict)

    @property
    def title(self) -> str:
        return f"make {self.name}"

    @property
    def name(self) -> str:
        return self.spec.label

    @property
    def needs(self) -> tuple[Cell, ...]:
        return tuple(self.models.values())

    @property
    def at_home(self) -> bool:
        return bool(self.models) or any(named_files(self.spec))

    def inputs(self) -> dict[str, Any]:
        spec = named_models(self.spec, {label: cell.digest for label, cell in self.models.items()})
        return {
            "controller": controllers.identity(spec),
            "files": file_digests(spec),
            "task": tasks.identity(self.task),
            "system": self.system.to_dict(),
        }

    def compute(self, work: Work) -> Champion:
        files = {label: f"{work.where(cell).resolve()}.json" for label, cell in self.models.items()}
        return Champion.hand_written(named_models(self.spec, files), self.task, self.system)

    def named(self, value: Champion) -> Champion:
        return replace(value, name=self.name)


def labels_inside(spec: Spec, labels: Collection[str]) -> tuple[str, ...]:
    """Return which of ``labels`` the parameter ``model`` of a controller names."""
    value = spec.parameters.get(MODEL, ())
    return tuple(name for name in ([value] if isinstance(value, str) else value) if name in labels)


def named_models(spec: Spec, names: Mapping[str, str]) -> Spec:
    """Return ``spec`` with other ``names`` for the models inside."""
    if not names:
        return spec
    value = spec.parameters[MODEL]
    one = isinstance(value, str)
    found = [names.get(name, name) for name in ([value] if one else value)]
    return Spec(spec.name, {**spec.parameters, MODEL: found[0] if one else found}, spec.label)
