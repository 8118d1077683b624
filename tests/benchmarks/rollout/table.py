"""The measured speeds as a table of at most 80 columns, and as JSON."""

from __future__ import annotations

from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

COLUMNS = ("model", "goals", "1 thr.", "2 thr.", "NumPy", "JAX", "1/NumPy", "1/JAX", "2/1")


def speeds(rows: list[dict[str, Any]]) -> Table:
    """Return the table of ``rows``, which are what `measure` returns."""
    table = Table(title="Million environment steps per second", box=SIMPLE_HEAD, padding=(0, 1), collapse_padding=True)
    for column in COLUMNS:
        table.add_column(column, justify="left" if column == "model" else "right", no_wrap=True)
    for row in rows:
        speed = row["million_steps_per_second"]
        table.add_row(
            row["model"],
            f"{row['mean_fitness']:.1f}",
            *(_number(speed.get(form)) for form in ("one_thread", "two_threads", "numpy", "jax")),
            _number(row["ratio_to_numpy"]),
            _number(row.get("ratio_to_jax")),
            f"{row['ratio_of_two_threads']:.2f}",
        )
    return table


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.1f}"
