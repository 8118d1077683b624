"""A cell: one unit of work as data, with a readable name and a digest; the table of cell kinds."""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Generic

from typing_extensions import TypeVar

from sysid_evo.processors import engine_inputs
from sysid_evo.progress import Progress

CONTRACT = 16
"""Increased whenever the same inputs give another result: all stored results are then computed again."""


@dataclass(frozen=True)
class CellContext:
    """Access of a cell to its inputs and files while it computes.

    - ``result(cell)``: value of a needed cell; None if that cell failed and this one is `CellKind.tolerant`.
    - ``path``: path, without suffix, of the result; ``path_of(cell)``: the same of a needed cell.
    - ``checkpoint``: file that persists over an interruption and is removed when the cell is done.
    """

    result: Callable[[Cell], Any]
    progress: Progress
    path: Path
    checkpoint: Path
    path_of: Callable[[Cell], Path]


class CellSettings(ABC):
    """Settings of one kind of work, a small frozen dataclass with the computation."""

    @abstractmethod
    def inputs(self) -> dict[str, Any]:
        """Return all inputs of the result except the needed cells, as strict JSON, without labels."""

    @abstractmethod
    def compute(self, work: CellContext) -> Any:
        """Return the result."""


S = TypeVar("S", bound=CellSettings, covariant=True, default=Any)


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell(Generic[S]):
    """One unit of work of a plan, defined by ``kind``, ``settings`` and ``needs``; cells with equal digests are equal.

    - ``name``: file name, not necessarily unique; ``title``: text for users, the kind of work and its object.
    - ``group``: label of many short cells that share one log line; empty for a line per cell.
    - ``labels``: fields of the result that hold names, see `labelled`.
    - ``expected_seconds``: expected time on one processor; ``resumable``: True if it resumes after an interruption.
    - ``local``: True if the process that made the plan computes it; it may hold recordings or drive a robot.
    - ``local_only``: True if it, and all cells that need it, are computed where the run folder is.
    - ``known_digest``: digest of a cell that is known by its record only (`stored`).
    """

    kind: str
    name: str
    title: str
    settings: S
    needs: tuple[Cell, ...] = ()
    labels: Mapping[str, Any] = field(default_factory=dict)
    group: str = ""
    expected_seconds: float = 1.0
    resumable: bool = False
    local: bool = False
    local_only: bool = False
    known_digest: str = ""

    @property
    def tolerant(self) -> bool:
        """True if it is computed although some of its needed cells failed."""
        return CELL_KINDS[self.kind].tolerant

    @property
    def result(self) -> ResultType:
        """The storage format of its result."""
        return CELL_KINDS[self.kind].result

    def labelled(self, value: Any) -> Any:
        """Return ``value`` with this cell's labels; it may have been computed under other labels.

        A list of labels is applied only if the result has the same number of entries, since failed entries may be
        missing from it.
        """
        fitting = {
            name: label
            for name, label in self.labels.items()
            if isinstance(label, str) or len(label) == len(getattr(value, name))
        }
        return replace(value, **fitting) if fitting else value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Cell) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all inputs of the result, including needed cells, and the engine unless it is "auto"."""
        return self.known_digest or self.digest_here()

    def digest_here(self) -> str:
        """Return the digest under the code of this process; it differs if versions or plugins differ."""
        content = {
            "kind": self.kind,
            "version": CELL_KINDS[self.kind].version,
            "contract": CONTRACT,
            "inputs": self.settings.inputs(),
            "needs": [cell.digest for cell in self.needs],
            **engine_inputs(),
        }
        text = json.dumps(content, sort_keys=True, allow_nan=False, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class ResultType:
    """Storage of results of one type in the folder ``folder`` of a run.

    ``save(value, path, cell)`` writes files (or a folder) whose names begin with ``path`` and returns the files;
    ``load(path)`` reads them.
    """

    folder: str
    save: Callable[[Any, Path, Cell], list[Path]]
    load: Callable[[Path], Any]


@dataclass(frozen=True)
class CellKind:
    """Common properties of the cells of one kind.

    ``version`` increases whenever the same inputs give another result. A ``tolerant`` cell is computed although some of
    its needed cells failed.
    """

    result: ResultType
    version: int = 1
    tolerant: bool = False


CELL_KINDS: dict[str, CellKind] = {}
"""The cell kinds by name; the module that defines the settings registers its kind."""


class Observer:
    """Callbacks of an execution; these do nothing. Several cells may be computed at the same time."""

    def plan(self, cells: int, kept: int, seconds: float) -> None:
        """Called first: number of ``cells``, number of stored results (``kept``), expected ``seconds`` of the rest."""

    def start(self, cell: Cell) -> None:
        """Called when ``cell`` begins."""

    def progress(self, cell: Cell, done: int, total: int, note: str = "") -> None:
        """Called after ``done`` of ``total`` steps of ``cell``, with a short ``note``."""

    def finish(self, cell: Cell, *, cached: bool, reason: str | None) -> None:
        """Called when ``cell`` is done, was done before (``cached``), or failed for ``reason``."""

    def remark(self, sentence: str) -> None:
        """Called with a notice for the user that does not stop the execution."""
