"""How long work tells how far it is: a callable, so that libraries never print."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Called now and then with the steps done and the steps in all."""

    def __call__(self, done: int, total: int) -> None: ...
