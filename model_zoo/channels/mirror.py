"""The left-right symmetry of a body on a plane: what changes sign in a mirror."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System

STEERING = ("steer",)
"""Controls that steer unless others are named."""


@dataclass(frozen=True)
class Mirror:
    """Signs (nx,) and (nu,), -1 for the channels that change sign when left and right are exchanged."""

    states: Array
    controls: Array

    @classmethod
    def of(cls, system: System, turning: Sequence[str] | None = None) -> Mirror | None:
        """Return the mirror of a planar body whose controls ``turning`` (`STEERING`) steer it; None if it has none."""
        steering = [name for name in (turning or STEERING) if name in system.control_names]
        if not isinstance(system.motion, PlanarBody) or not steering:
            return None
        sideways = {system.motion.lateral, system.motion.yaw_rate}
        return cls(
            np.array([-1.0 if name in sideways else 1.0 for name in system.state_names]),
            np.array([-1.0 if name in steering else 1.0 for name in system.control_names]),
        )
