"""Small cells whose result is a number, for the tests of plans and stores."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sysid_evo.plan import Cell, Observer, Work


@dataclass(frozen=True, eq=False)
class Number(Cell):
    """Adds ``number`` to the results of the cells it needs; ``label`` is how people call it.

    Each computation appends a line to ``diary``, if there is one, and takes ``seconds_long``. ``then`` is
    called in it; what it raises makes the cell fail. A need that failed counts as 1000.
    """

    kind = "number"

    number: int = 1
    required: tuple[Cell, ...] = ()
    label: str = "one"
    diary: Path | None = None
    seconds_long: float = 0.0
    then: Callable[[], object] | None = None

    @property
    def title(self) -> str:
        return f"count {self.label}"

    @property
    def name(self) -> str:
        return self.label

    @property
    def needs(self) -> tuple[Cell, ...]:
        return self.required

    def inputs(self) -> dict[str, Any]:
        return {"number": self.number}

    def compute(self, work: Work) -> int:
        work.progress(0, 1)
        if self.diary is not None:
            with self.diary.open("a") as file:
                file.write(f"{os.getpid()} {self.label}\n")
        time.sleep(self.seconds_long)
        if self.then is not None:
            self.then()
        found = [work.result(cell) for cell in self.required]
        return self.number + sum(1000 if value is None else value for value in found)

    def save(self, value: int, path: Path) -> list[Path]:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.with_name(f"{path.name}.txt")
        file.write_text(json.dumps(value))
        return [file]

    def load(self, path: Path) -> int:
        return int(json.loads(path.with_name(f"{path.name}.txt").read_text()))


@dataclass(frozen=True, eq=False)
class Tolerant(Number):
    """Is computed although some of what it needs failed."""

    kind = "tolerant number"
    tolerant = True


@dataclass(frozen=True, eq=False)
class Named(Number):
    """Its result carries its label."""

    kind = "named number"

    def named(self, value: int) -> tuple[str, int]:  # type: ignore[override]  # a label stands beside it
        return self.label, value


@dataclass(frozen=True, eq=False)
class AtHome(Number):
    """Must be computed where the run is."""

    at_home = True


class Watching(Observer):
    """Keeps which cells were computed, and all remarks."""

    def __init__(self) -> None:
        self.computed: list[str] = []
        self.kept: list[str] = []
        self.failed: dict[str, str] = {}
        self.remarks: list[str] = []

    def finish(self, cell: Cell, *, cached: bool, reason: str | None) -> None:
        (self.kept if cached else self.computed).append(cell.name)
        if reason is not None:
            self.failed[cell.name] = reason

    def remark(self, sentence: str) -> None:
        self.remarks.append(sentence)
