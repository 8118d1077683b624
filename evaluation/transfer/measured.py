"""Cells that are measured once, not computed: controllers on a robot that is driven, people on anything."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from evaluation.transfer.cell import Cell
from evaluation.transfer.matrix import TransferMatrix
from sysid_evo.errors import SysidEvoError
from sysid_evo.evolution import Champion
from sysid_evo.files import write_atomically
from sysid_evo.registry import Spec
from sysid_evo.system import System

FOLDER = Path("results") / "measured"
BY_HAND = Spec("by_hand")
"""What stands for a controller where a person drives."""


@dataclass(frozen=True)
class Measured:
    """A cell, who drove (``champion``, the row), and whether the column is a robot, and a physical one."""

    champion: Champion
    cell: Cell
    on_robot: bool
    physical: bool = False

    @cached_property
    def digest(self) -> str:
        """SHA-256 of everything in it."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()

    def to_json(self) -> str:
        """Return it as strict JSON."""
        value = {
            "cell": self.cell.to_dict(),
            "champion": self.champion.to_dict(),
            "tensors": {name: array.tolist() for name, array in self.champion.tensors.items()},
            "on_robot": self.on_robot,
            "physical": self.physical,
        }
        return json.dumps(value, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> Measured:
        """Undo `to_json`."""
        value = json.loads(text)
        champion = Champion.from_dict(value["champion"], value["tensors"])
        return cls(champion, Cell.from_dict(value["cell"]), value["on_robot"], value["physical"])


def person(name: str = "human", *, task: str = "point_to_point", system: System | None = None) -> Champion:
    """Return the row of somebody who drives by hand: without parameters, evolved against nothing."""
    return Champion(
        name, np.empty(0), (), "min", 0, np.empty((0, 3)), controller=BY_HAND, task=Spec.parse(task), system=system
    )


def save_measured(run: Path, measured: Measured) -> Path:
    """Store a cell in the run folder ``run``; it takes the place of an earlier one of the same row and column."""
    name = f"{measured.champion.name}@{measured.cell.column}.json"
    text = measured.to_json()
    return write_atomically(run / FOLDER / re.sub(r"[^\w.@+-]+", "-", name), lambda file: file.write_text(text))


def load_measured(run: Path) -> tuple[tuple[Measured, ...], tuple[str, ...]]:
    """Return every measured cell of the run folder, the oldest first, and a remark for each that is damaged."""
    files = sorted((run / FOLDER).glob("*.json"), key=lambda file: (file.stat().st_mtime_ns, file.name))
    found, remarks = [], []
    for file in files:
        try:
            found.append(Measured.from_json(file.read_text(encoding="utf-8")))
        except (OSError, ValueError, KeyError, TypeError, AttributeError, SysidEvoError) as error:
            remarks.append(f"{file} is damaged and left out: {type(error).__name__}: {error}")
    return tuple(found), tuple(remarks)


def with_measured(matrix: TransferMatrix | None, measured: Sequence[Measured]) -> TransferMatrix | None:
    """Return ``matrix`` with the measured cells, in rows and columns of their own where there are none yet.

    The robot that counts as achieved is the physical one driven last, else that of ``matrix``, else the one
    driven last.
    """
    if not measured:
        return matrix
    champions = {champion.name: champion for champion in (matrix.champions if matrix else ())}
    columns = dict.fromkeys(matrix.columns if matrix else ())
    cells = dict(matrix.cells) if matrix else {}
    robot, physical = (matrix.robot if matrix else None), False
    robots = {robot: None} if robot is not None else {}
    for item in measured:
        champions.setdefault(item.champion.name, item.champion)
        columns[item.cell.column] = None
        cells[item.champion.name, item.cell.column] = item.cell
        if item.on_robot:
            robots[item.cell.column] = None
            if item.physical or (not physical and (matrix is None or matrix.robot is None)):
                robot, physical = item.cell.column, physical or item.physical
    return TransferMatrix.of(
        tuple(champions.values()),
        tuple(columns),
        cells.values(),
        families=matrix.families if matrix else None,
        robot=robot,
        other_robots=tuple(name for name in robots if name != robot),
    )
