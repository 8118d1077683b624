"""Rows of the transfer matrix that need no evolution: controllers written by hand, some with a model inside."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from evaluation.comparison.champion_cells import ControllerFiles
from evaluation.comparison.columns import Column
from sysid_evo.evolution import Champion
from sysid_evo.plan import Work
from sysid_evo.registry import Spec, controllers, tasks
from sysid_evo.system import System


@dataclass(frozen=True, eq=False)
class HandWrittenCell(ControllerFiles):
    """Makes a controller that is run as it is on ``system``; files that it names count by what is in them."""

    kind = "by_hand"
    members: ClassVar[tuple[Column, ...]] = ()

    spec: Spec
    task: Spec
    system: System

    @property
    def title(self) -> str:
        return f"make {self.name}"

    @property
    def name(self) -> str:
        return self.spec.label

    def inputs(self) -> dict[str, Any]:
        return {
            "controller": controllers.identity(self.spec),
            "files": [hashlib.sha256(file.read_bytes()).hexdigest() for file in _files(self.spec)],
            "task": tasks.identity(self.task),
            "system": self.system.to_dict(),
        }

    def compute(self, work: Work) -> Champion:
        return Champion.hand_written(self.spec, self.task, self.system)

    def named(self, value: Champion) -> Champion:
        return replace(value, name=self.name)


def _files(spec: Spec) -> Iterator[Path]:
    """Yield the files, with their halves, that the parameters of ``spec`` name."""
    for value in spec.parameters.values():
        for text in value if isinstance(value, (list, tuple)) else [value]:
            if isinstance(text, str):
                stem = text.removesuffix(".safetensors").removesuffix(".json")
                yield from (file for file in map(Path, (f"{stem}.json", f"{stem}.safetensors")) if file.is_file())
