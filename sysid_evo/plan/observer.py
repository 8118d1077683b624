"""The observer of an execution: progress bars and logs derive from it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sysid_evo.plan.cell import Cell


class Observer:
    """Callbacks of an execution; these do nothing. Several cells may be computed at the same time."""

    def plan(self, cells: int, kept: int, seconds: float) -> None:
        """Called first: number of ``cells``, number of stored results (``kept``), expected ``seconds`` of the rest."""

    def start(self, cell: Cell) -> None:
        """Called when ``cell`` begins."""

    def progress(self, cell: Cell, done: int, total: int, note: str = "") -> None:
        """Called after ``done`` of ``total`` steps of ``cell``, with a short ``note``."""

    def finish(self, cell: Cell, *, cached: bool, reason: str | None) -> None:
        """Called when ``cell`` is done, was done before (``cached``), or failed for ``reason``."""

    def remark(self, sentence: str) -> None:
        """Called with a notice for the user that does not stop the execution."""
