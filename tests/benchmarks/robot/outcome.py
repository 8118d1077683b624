"""What a stress test found: rows of a table, each with its verdict."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text


@dataclass(frozen=True)
class Row:
    """``passed`` of ``count`` repetitions of ``case`` fulfilled ``demand``; ``figures`` holds the measurements."""

    case: str
    demand: str
    passed: int
    count: int
    figures: dict[str, Any]

    @property
    def holds(self) -> bool:
        return self.passed == self.count


def spread(values: Sequence[float]) -> dict[str, float]:
    """Return median and largest of ``values`` (s), in ms."""
    if not values:
        return {}
    return {"median_ms": round(1000.0 * float(np.median(values)), 1), "worst_ms": round(1000.0 * max(values), 1)}


def table_of(rows: Sequence[Row]) -> Table:
    """Return ``rows`` as a table."""
    table = Table("case", "demand", "passed", "figures")
    for row in rows:
        figures = ", ".join(f"{name.replace('_', ' ')} {_shown(value)}" for name, value in row.figures.items())
        table.add_row(row.case, row.demand, f"{row.passed} of {row.count}", Text(figures))
    return table


def save(rows: Sequence[Row], path: Path) -> None:
    """Write ``rows`` as JSON."""
    listed = [{**vars(row), "holds": row.holds} for row in rows]
    path.write_text(json.dumps(listed, indent=2) + "\n", encoding="utf-8")


def _shown(value: Any) -> str:
    """Return a figure as text: the items of a dictionary or a list without brackets."""
    if isinstance(value, dict):
        return " ".join(f"{name.replace('_', ' ')} {_shown(inner)}" for name, inner in value.items())
    if isinstance(value, list):
        return "; ".join(map(_shown, value))
    return str(value)
