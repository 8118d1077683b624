"""A plan: cells in order of their needs, made without doing any work."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from sysid_evo.errors import InvalidArgument
from sysid_evo.plan.cell import Cell
from sysid_evo.randomness import derived_seed

MOST_YEARS = 10.0
"""Longest plan, in years of one processor: a longer one is a mistake. A thousand processors take four days."""
YEAR = 365.25 * 86400.0
"""In seconds."""


@dataclass(frozen=True)
class Plan:
    """Distinct ``cells``, each after those it needs, and ``remarks`` on what was left out and why."""

    cells: tuple[Cell, ...]
    remarks: tuple[str, ...] = ()

    @classmethod
    def of(cls, wanted: Iterable[Cell], *, remarks: Iterable[str] = ()) -> Plan:
        """Return the plan of the ``wanted`` cells and all that they need.

        Raises `InvalidArgument` for years of work, as cells foresee it (`Cell.expected_seconds`).
        """
        placed: dict[str, Cell] = {}

        def place(cell: Cell) -> None:
            if cell.digest not in placed:
                for needed in cell.needs:
                    place(needed)
                placed[cell.digest] = cell

        for cell in wanted:
            place(cell)
        foreseen = {cell.title: cell.expected_seconds for cell in placed.values()}
        if sum(foreseen.values()) > MOST_YEARS * YEAR:
            longest = max(foreseen, key=foreseen.__getitem__)
            raise InvalidArgument(
                f"plan: {longest} would take about {foreseen[longest] / YEAR:.2g} years on one processor, and no plan "
                f"of more than {MOST_YEARS:g} years is begun: ask for less of it, such as generations, trials, runs, "
                "minutes"
            )
        return cls(tuple(placed.values()), tuple(remarks))

    def __len__(self) -> int:
        return len(self.cells)

    def __iter__(self) -> Iterator[Cell]:
        return iter(self.cells)

    def of_kind(self, kind: str) -> tuple[Cell, ...]:
        """Return the cells of one kind."""
        return tuple(cell for cell in self.cells if cell.kind == kind)


def cell_seed(seed: int, work: str) -> int:
    """Return the seed of ``work``: it depends on the experiment's seed and the text, not on its place in a plan."""
    return derived_seed(seed, zlib.crc32(work.encode()))


def local_cells(plan: Plan) -> set[str]:
    """Return the digests of the cells that must be computed where the run is, and of those that need them."""
    found: set[str] = set()
    for cell in plan:
        if cell.local_only or any(needed.digest in found for needed in cell.needs):
            found.add(cell.digest)
    return found


def critical_path(plan: Plan) -> dict[str, float]:
    """Return by digest the seconds from the beginning of each cell to the end of all that waits for it in turn."""
    ahead = {cell.digest: cell.expected_seconds for cell in plan}
    for cell in reversed(plan.cells):
        for needed in cell.needs:
            ahead[needed.digest] = max(ahead[needed.digest], needed.expected_seconds + ahead[cell.digest])
    return ahead
