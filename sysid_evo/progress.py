"""How long work tells how far it is: a callable, so that libraries never print."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Called now and then with the steps done and the steps in all.

    What it raises stops the work, which leaves things as they were before it began.
    """

    def __call__(self, done: int, total: int) -> None: ...


class Counter:
    """Counts ``total`` parts of long work and tells a `Progress`, if there is one."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self.progress = progress
        self.total = total
        self.done = 0

    def advance(self, parts: int = 1) -> None:
        """Tell that ``parts`` more are done; 0 only says that the work goes on."""
        self.done += parts
        if self.progress is not None:
            self.progress(self.done, self.total)
