"""Tables as plain text cells, rendered alike in the terminal and on the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.transfer import ControllerSummary, Estimate


@dataclass(frozen=True)
class Heat:
    """What the page paints behind the cells of a table, without its first column.

    ``shades`` (rows, columns) from 0 to 1, None for no shade; ``framed`` cells (row, column) have a frame;
    a line stands left of the ``divided`` column. ``alarm`` paints in the colour of warnings.
    """

    shades: tuple[tuple[float | None, ...], ...]
    framed: frozenset[tuple[int, int]] = frozenset()
    divided: int | None = None
    alarm: bool = False


@dataclass(frozen=True)
class Sheet:
    """A table: the first column names the rows. A cell may hold several lines.

    ``note`` says how the numbers came about; ``details`` asks the page to fold the table away, ``prose``
    to set its cells as text rather than as numbers, ``code`` as commands to copy; ``heat`` paints them.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    details: bool = False
    prose: bool = False
    code: bool = False
    heat: Heat | None = None

    @property
    def sorts(self) -> bool:
        """Whether a reader may sort the rows."""
        return not (self.prose or self.code) and len(self.rows) > 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "rows", tuple(tuple(row) for row in self.rows))


def number(value: float | None, digits: int = 1) -> str:
    """Return ``value`` with that many decimals, a dash for None and nan."""
    return f"{value:.{digits}f}" if value is not None and np.isfinite(value) else "–"


def three_digits(value: float) -> str:
    """Return ``value`` with about three digits: 0.123, 1.23, 12.3, 123."""
    size = abs(value)
    return number(value, 3 if size < 0.9995 else 2 if size < 9.995 else 1 if size < 99.95 else 0)


def plus_minus(estimate: Estimate | None) -> str:
    """Return ``11.5 ±0.3``, the value and its standard error; a dash for None."""
    return "–" if estimate is None else f"{number(estimate.value)} ±{number(estimate.standard_error)}"


def within(estimate: Estimate | None, digits: int = 1) -> str:
    """Return the value, and below it its interval: ``11.5`` over ``11.2 to 11.9``; a dash for None."""
    if estimate is None:
        return "–"
    ends = (estimate.low, estimate.high)
    known = all(map(np.isfinite, ends))
    return lines(number(estimate.value, digits), " to ".join(number(end, digits) for end in ends) if known else "")


def of_each_run(controller: ControllerSummary) -> str:
    """Return the fitness of the champion of each evolution run, three a line; empty for fewer than two runs."""
    found = [f"{fitness:.1f}" for fitness in controller.seed_fitness]
    return "\n".join(", ".join(found[i : i + 3]) for i in range(0, len(found), 3)) if len(found) > 1 else ""


def lines(*parts: str) -> str:
    """Join the parts that are not empty, one a line."""
    return "\n".join(part for part in parts if part)


def listed(names: Sequence[str]) -> str:
    """Join names with commas, a dash for none."""
    return ", ".join(names) if names else "–"
