"""A plan: cells in an order in which each comes after those it needs, made without doing any work."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from sysid_evo.errors import InvalidArgument
from sysid_evo.plan.cell import Cell


@dataclass(frozen=True)
class Plan:
    """Distinct ``cells``, each after those it needs, and ``remarks`` on what was left out and why."""

    cells: tuple[Cell, ...]
    remarks: tuple[str, ...] = ()

    @classmethod
    def of(cls, wanted: Iterable[Cell], *, remarks: Iterable[str] = ()) -> Plan:
        """Return the plan of the ``wanted`` cells and all that they need. Raises `InvalidArgument` for a circle."""
        placed: dict[str, Cell] = {}
        under_way: list[str] = []

        def place(cell: Cell) -> None:
            if cell.digest in placed:
                return
            if cell.digest in under_way:
                raise InvalidArgument(f"plan: {cell.title} needs itself")
            under_way.append(cell.digest)
            for needed in cell.needs:
                place(needed)
            under_way.pop()
            placed[cell.digest] = cell

        for cell in wanted:
            place(cell)
        return cls(tuple(placed.values()), tuple(remarks))

    def __len__(self) -> int:
        return len(self.cells)

    def __iter__(self) -> Iterator[Cell]:
        return iter(self.cells)

    def of_kind(self, kind: str) -> tuple[Cell, ...]:
        """Return the cells of one kind."""
        return tuple(cell for cell in self.cells if cell.kind == kind)
