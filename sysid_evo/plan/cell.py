"""A cell: one piece of work as data, with a name for people and a digest for the machine; the table of their kinds."""

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

CONTRACT = 15
"""Raised whenever the same inputs give another result than before: every stored result is then computed anew."""


@dataclass(frozen=True)
class CellContext:
    """What a cell may use while it computes.

    ``result(cell)`` is the value of a cell that it needs, None if that one failed and this one is
    `CellKind.tolerant`; ``path`` is the path, without suffix, at which its result will be stored, and ``path_of(cell)``
    the one at which that of a cell that it needs stands. What it keeps in the file ``checkpoint`` is there when it is
    computed again after an interruption, and goes when it is done.
    """

    result: Callable[[Cell], Any]
    progress: Progress
    path: Path
    checkpoint: Path
    path_of: Callable[[Cell], Path]


class CellSettings(ABC):
    """What a cell computes with: the settings of one kind of work, in a small frozen dataclass."""

    @abstractmethod
    def inputs(self) -> dict[str, Any]:
        """Return all that the result depends on beside the needed cells, as strict JSON. Labels are no part of it."""

    @abstractmethod
    def compute(self, work: CellContext) -> Any:
        """Return the result."""


S = TypeVar("S", bound=CellSettings, covariant=True, default=Any)


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell(Generic[S]):
    """One piece of work of a plan: ``kind``, ``settings`` and what it ``needs`` say all; equal digests are equal.

    ``name`` is how its files are called, and need not be unique; ``title`` what people read: the kind of work, then
    its object; ``group`` what a log calls many short cells in a single line, empty for a line of its own. ``labels``
    are fields of the result that carry names, see `labelled`. It takes about ``expected_seconds`` on one processor. One
    that is ``resumable`` goes on after an interruption where it was. One that is ``local`` is computed by the process
    that made the plan, as it holds recordings, reads a file or drives a robot; one that is ``local_only``, and all that
    needs it, where the run folder is, as its work or its result names files there. ``known_digest`` is that of a stored
    cell (`stored`), of which no more is known than its record.
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
        """Whether it is computed although some of the cells that it needs failed."""
        return CELL_KINDS[self.kind].tolerant

    @property
    def result(self) -> ResultType:
        """How its result is stored."""
        return CELL_KINDS[self.kind].result

    def labelled(self, value: Any) -> Any:
        """Return a result under this cell's labels: one with the same digest may have been computed under others.

        Several labels are put back only where the result has as many: what failed may have been left out of it.
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
        """SHA-256 of everything that the result depends on: needed cells, and the engine unless it is "auto", too."""
        return self.known_digest or self.digest_here()

    def digest_here(self) -> str:
        """Return what `digest` is with the code of this process: another one if versions or plugins differ."""
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
    """How results of one type are stored, in the folder ``folder`` of a run.

    ``save(value, path, cell)`` writes files, or a folder, that begin with ``path`` and returns the files;
    ``load(path)`` reads them.
    """

    folder: str
    save: Callable[[Any, Path, Cell], list[Path]]
    load: Callable[[Path], Any]


@dataclass(frozen=True)
class CellKind:
    """What all cells of one kind have in common.

    ``version`` is raised whenever they give another result on the same inputs. A cell that is ``tolerant`` is computed
    although some of the cells that it needs failed.
    """

    result: ResultType
    version: int = 1
    tolerant: bool = False


CELL_KINDS: dict[str, CellKind] = {}
"""The kinds of cells by name; a module that defines settings enters theirs."""
