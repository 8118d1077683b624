"""A plan: cells in an order in which each comes after those it needs, made without doing any work."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from sysid_evo.errors import InvalidArgument
from sysid_evo.plan.again import Again
from sysid_evo.plan.cell import Cell


@dataclass(frozen=True)
class Plan:
    """Distinct ``cells``, each after those it needs, and ``remarks`` on what was left out and why.

    ``again`` says how other processes make the same plan; without it all cells are computed in this one.
    """

    cells: tuple[Cell, ...]
    remarks: tuple[str, ...] = ()
    again: Again | None = None

    @classmethod
    def of(cls, wanted: Iterable[Cell], *, remarks: Iterable[str] = (), again: Again | None = None) -> Plan:
        """Return the plan of the ``wanted`` cells and all that they need. Raises `InvalidArgument` for a circle."""
        placed: dict[str, Cell] = {}
        under_way: dict[int, Cell] = {}
        visited: dict[int, Cell] = {}

        def place(cell: Cell) -> None:
            if id(cell) in under_way:  # told by identity: in a circle nothing has a digest
                raise InvalidArgument(f"plan: {cell.title} needs itself")
            if id(cell) in visited:
                return
            under_way[id(cell)] = visited[id(cell)] = cell
            for needed in cell.needs:
                place(needed)
            del under_way[id(cell)]
            placed.setdefault(cell.digest, cell)

        for cell in wanted:
            place(cell)
        return cls(tuple(placed.values()), tuple(remarks), again)

    def __len__(self) -> int:
        return len(self.cells)

    def __iter__(self) -> Iterator[Cell]:
        return iter(self.cells)

    def of_kind(self, kind: str) -> tuple[Cell, ...]:
        """Return the cells of one kind."""
        return tuple(cell for cell in self.cells if cell.kind == kind)
