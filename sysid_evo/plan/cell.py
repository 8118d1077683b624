"""The contract of a cell: one piece of work with a name for people and a digest for the machine."""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from sysid_evo.processors import engine_inputs
from sysid_evo.progress import Progress

CONTRACT = 15
"""Raised whenever the same inputs give another result than before: every stored result is then computed anew."""


@dataclass(frozen=True)
class Work:
    """What a cell may use while it computes.

    ``result(cell)`` is the value of a cell that it needs, None if that one failed and this one is
    `Cell.tolerant`; ``place`` is the path, without suffix, at which its result will be stored, and ``where(cell)`` the
    one at which that of a cell that it needs stands. What it keeps in the file ``checkpoint`` is there when it is
    computed again after an interruption, and goes when it is done.
    """

    result: Callable[[Cell], Any]
    progress: Progress
    place: Path
    checkpoint: Path
    where: Callable[[Cell], Path]


class Cell(ABC):
    """One piece of work of a plan; concrete cells are frozen dataclasses without ``eq``: equal digests are equal.

    ``kind`` says what it computes; results stand in the folder ``place`` of a run. A cell that is
    ``tolerant`` is computed although some of the cells that it needs failed. One that is ``resumable`` goes on
    after an interruption where it was.
    """

    kind: ClassVar[str]
    place: ClassVar[str] = "results"
    tolerant: ClassVar[bool] = False

    @property
    @abstractmethod
    def title(self) -> str:
        """What people read: the kind of work, then its object."""

    @property
    @abstractmethod
    def name(self) -> str:
        """How its files are called; need not be unique."""

    @property
    def group(self) -> str:
        """What a log calls many short cells of one kind in a single line; empty for a line of its own."""
        return ""

    @property
    def resumable(self) -> bool:
        """Whether it goes on after an interruption where it was."""
        return False

    @property
    def at_home(self) -> bool:
        """Whether it must be computed where the run folder is, as its work or its result names files there."""
        return False

    @property
    def needs(self) -> tuple[Cell, ...]:
        """The cells whose results it takes."""
        return ()

    @abstractmethod
    def inputs(self) -> dict[str, Any]:
        """Return all else that its result depends on, as strict JSON. Labels are no part of it."""

    @abstractmethod
    def compute(self, work: Work) -> Any:
        """Return the result."""

    @abstractmethod
    def save(self, value: Any, path: Path) -> list[Path]:
        """Write ``value`` to files or a folder that begin with ``path``; return the files."""

    @abstractmethod
    def load(self, path: Path) -> Any:
        """Read what `save` wrote."""

    def named(self, value: Any) -> Any:
        """Return the result under this cell's labels: one with the same digest may have been computed under others."""
        return value

    def seconds(self) -> float:
        """Return about how long it takes on one processor."""
        return 1.0

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Cell) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of everything that the result depends on: needed cells, and the engine unless it is "auto", too."""
        content = {
            "kind": self.kind,
            "contract": CONTRACT,
            "inputs": self.inputs(),
            "needs": [cell.digest for cell in self.needs],
            **engine_inputs(),
        }
        text = json.dumps(content, sort_keys=True, allow_nan=False, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()
