"""What can be drawn of a trial, whatever the task."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.system import Channel


@dataclass(frozen=True)
class Target:
    """Where a state was wanted: its ``channel``, its ``place`` among the states, and what it was to be.

    ``values`` (K,) holds one for each sample, or one for all of them; an error below ``tolerance`` counts as met.
    """

    channel: Channel
    place: int
    values: Array
    tolerance: float


@dataclass(frozen=True)
class Scene:
    """Places in a trial, in m from the task's origin, and targets of states; a task without any has an empty scene.

    ``markers`` (k, 2) are places to be reached, in order: the first ``reached`` of them were, the others
    lie ahead. ``radius`` is that of each marker, 0 for a point. What happens stays within ``extent`` of
    the origin, None where that is not known. ``walls`` are lines (k, 2); ``targets`` what states were to be.
    """

    markers: Array = field(default_factory=lambda: np.empty((0, 2)))
    reached: int = 0
    radius: float = 0.0
    extent: float | None = None
    walls: tuple[Array, ...] = ()
    targets: tuple[Target, ...] = ()

    @property
    def next_marker(self) -> Array | None:
        """The first marker that lies ahead, (2,) m; None if there is none."""
        return self.markers[self.reached] if self.reached < len(self.markers) else None
