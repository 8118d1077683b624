"""The measured speeds as a table of at most 80 columns, and as JSON."""

from __future__ import annotations

from typing import Any

from rich.table import Table

COLUMNS = ("model", "goals", "1 thread", "2 threads", "NumPy", "JAX", "/NumPy", "2/1", "/JAX")


def speeds(rows: list[dict[str, Any]]) -> Table:
    """Return a table of rows with the keys of `sysid_evo`'s JSON report, see `measure`."""
    table = Table(title="Million environment steps per second", width=80, padding=(0, 1))
    for column in COLUMNS:
        table.add_column(column, justify="left" if column == "model" else "right", overflow="fold")
    for row in rows:
        speed = row["million_steps_per_second"]
        table.add_row(
            row["model"],
            f"{row['mean_fitness']:.1f}",
            *(_number(speed.get(form)) for form in ("one_thread", "two_threads", "numpy", "jax")),
            _number(row["ratio_to_numpy"]),
            f"{row['ratio_of_two_threads']:.2f}",
            _number(row.get("ratio_to_jax")),
        )
    return table


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.1f}"
