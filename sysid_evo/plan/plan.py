"""A plan: cells in the order of their needs; making a plan computes nothing."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from sysid_evo.errors import InvalidArgument
from sysid_evo.plan.cell import Cell
from sysid_evo.randomness import derived_seed

MAX_YEARS = 10.0
"""Limit of a plan in years of one processor (four days of a thousand processors); a longer plan is a mistake."""
YEAR = 365.25 * 86400.0
"""In seconds."""


@dataclass(frozen=True)
class Plan:
    """Distinct ``cells``, each after its needs, and ``remarks`` on omitted work."""

    cells: tuple[Cell, ...]
    remarks: tuple[str, ...] = ()

    @classmethod
    def of(cls, wanted: Iterable[Cell], *, remarks: Iterable[str] = ()) -> Plan:
        """Return the plan of the ``wanted`` cells with their needs. Raises `InvalidArgument` for years of work."""
        placed: dict[str, Cell] = {}

        def place(cell: Cell) -> None:
            if cell.digest not in placed:
                for needed in cell.needs:
                    place(needed)
                placed[cell.digest] = cell

        for cell in wanted:
            place(cell)
        expected = {cell.title: cell.expected_seconds for cell in placed.values()}
        if sum(expected.values()) > MAX_YEARS * YEAR:
            longest = max(expected, key=expected.__getitem__)
            raise InvalidArgument(
                f"plan: {longest} would take about {expected[longest] / YEAR:.2g} years on one processor; the limit of "
                f"a plan is {MAX_YEARS:g} years. Reduce generations, trials, their steps, repeats or minutes"
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
    """Return the seed of ``work``, which depends on the experiment's seed and the text only."""
    return derived_seed(seed, zlib.crc32(work.encode()))


def local_cells(plan: Plan) -> set[str]:
    """Return the digests of the cells that must be computed where the run folder is, and of those that need them."""
    found: set[str] = set()
    for cell in plan:
        if cell.local_only or any(needed.digest in found for needed in cell.needs):
            found.add(cell.digest)
    return found


def critical_path(plan: Plan) -> dict[str, float]:
    """Return, by digest, the seconds from the start of a cell to the end of the longest chain of dependent cells."""
    ahead = {cell.digest: cell.expected_seconds for cell in plan}
    for cell in reversed(plan.cells):
        for needed in cell.needs:
            ahead[needed.digest] = max(ahead[needed.digest], needed.expected_seconds + ahead[cell.digest])
    return ahead
