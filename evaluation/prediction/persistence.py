"""The yardstick that a model must beat: nothing changes."""

from __future__ import annotations

from typing import Self

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.progress import Progress


class Persistence(DynamicsModel):
    """The next state is the present one; there is nothing to learn."""

    knowledge = "none"

    def __init__(self) -> None:
        """Take no arguments."""

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        return self

    def next_state(self, carry: Array, control: Array) -> Array:
        return carry
