"""Who drives: a controller, a script or a person, each asked once a sample."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from sysid_evo.arrays import Array


@dataclass(frozen=True)
class Estimate:
    """What is known of the robot at ``time`` (s, the connection's clock).

    ``pose`` (n_pose,) is the newest that was accepted, ``age`` s old; ``state`` (nx,) is made of
    the poses up to it by a causal filter, so it lags behind.
    """

    time: float
    pose: Array
    state: Array
    age: float


class Pilot(ABC):
    """Decides on the control of every sample."""

    @abstractmethod
    def decide(self, tick: int, estimate: Estimate) -> Array | None:
        """Return the control (nu,) for sample ``tick``, or None to end the run in neutral."""
