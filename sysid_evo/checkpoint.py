"""Where long work keeps how far it is: something that takes a state, so that libraries never write."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, TypeAlias

from sysid_evo.arrays import Array

State: TypeAlias = Mapping[str, Array | int | float | str]
"""Everything that is needed to go on, by name: float64 arrays, numbers and text, which can be stored."""


class Checkpoint(Protocol):
    """Keeps the last state of long work; `sysid_evo.store.CheckpointFile` keeps it in a file."""

    def load(self, identity: str) -> State | None:
        """Return what was saved under this ``identity``, None if there is nothing that can be used."""
        ...

    def due(self) -> bool:
        """Whether it is time to save again; results never depend on it."""
        ...

    def save(self, identity: str, state: State) -> None:
        """Keep ``state`` in place of what was kept before."""
        ...
