"""Cells that are measured once, not computed: controllers on a robot that is driven, people on anything."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from evaluation.transfer.cell import Cell
from evaluation.transfer.matrix import TransferMatrix
from sysid_evo.errors import ArtefactError, SysidEvoError
from sysid_evo.evolution import Champion
from sysid_evo.files import write_atomically
from sysid_evo.store import RunFolder

FOLDER = Path("results") / "measured"


@dataclass(frozen=True)
class Measured:
    """A cell, who drove (``champion``, the row), and whether the column is a robot, and a physical one."""

    champion: Champion
    cell: Cell
    on_robot: bool
    physical: bool = False


def person(name: str = "human", *, task: str = "point_to_point") -> Champion:
    """Return the row of somebody who drives by hand: without parameters, evolved against nothing."""
    return Champion(name, np.empty(0), (), "min", 0, np.empty((0, 3)), controller="", task=task)


def save_measured(run: RunFolder, measured: Measured) -> Path:
    """Store a cell in ``run``; it takes the place of an earlier one of the same row and column."""
    champion = measured.champion
    value = {
        "cell": measured.cell.to_dict(),
        "champion": {
            **asdict(champion),
            "parameters": champion.parameters.tolist(),
            "history": champion.history.tolist(),
        },
        "on_robot": measured.on_robot,
        "physical": measured.physical,
    }
    text = json.dumps(value, allow_nan=False)
    name = f"{champion.name}@{measured.cell.column}.json".replace(":", "-").replace("/", "-")
    return write_atomically(run.path / FOLDER / name, lambda file: file.write_text(text))


def load_measured(run: RunFolder) -> tuple[Measured, ...]:
    """Return every measured cell of ``run``, the oldest first. Raises `ArtefactError`."""
    files = sorted((run.path / FOLDER).glob("*.json"), key=lambda file: (file.stat().st_mtime_ns, file.name))
    return tuple(_load(file) for file in files)


def _load(path: Path) -> Measured:
    try:
        value = json.loads(path.read_text())
        champion = dict(value["champion"])
        champion["parameters"] = np.asarray(champion["parameters"], dtype=np.float64)
        champion["history"] = np.asarray(champion["history"], dtype=np.float64).reshape(-1, 3)
        champion["against"] = tuple(champion["against"])
        return Measured(Champion(**champion), Cell.from_dict(value["cell"]), value["on_robot"], value["physical"])
    except (OSError, ValueError, KeyError, TypeError, SysidEvoError) as error:
        raise ArtefactError(f"{path}: not a stored cell of the transfer matrix: {error}") from error


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
