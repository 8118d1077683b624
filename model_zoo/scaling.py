"""Centre and scale of every channel; the left-right mirror of a planar body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid_evo.carry import CarryLayout
from sysid_evo.data import Dataset
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System
from sysid_evo.types import Array

CONSTANT = 1e-12
"""A standard deviation below this share of the channel's size is rounding error."""
STILL = 1e-6
"""Change in one step of a state that never changes, such as a goal, as a share of its spread: networks leave it so."""


@dataclass(frozen=True)
class ChannelScaling:
    """Deviations of states, centres and deviations of features and controls, RMS ``change`` in one step.

    The features of a periodic state are its sine and cosine (`Features`).
    """

    state_scale: Array
    seen_centre: Array
    seen_scale: Array
    control_centre: Array
    control_scale: Array
    change: Array

    @classmethod
    def of(cls, dataset: Dataset, mirror: Mirror | None = None) -> ChannelScaling:
        """Compute the scaling of ``dataset``; with ``mirror``, channels that change sign in it are centred at zero."""
        windows = dataset.windows(1, moving=True)
        if not len(windows):
            windows = dataset.windows(1)
        system, states, controls = dataset.system, windows.start_states, windows.controls[:, 0]
        change = system.acceleration(states, windows.states[:, 0]) * system.dt
        seen = system.regressors(states) if system.periods else states
        seen_centre, control_centre = seen.mean(axis=0), controls.mean(axis=0)
        if mirror is not None:
            signs = np.repeat(mirror.states, [2 if i in system.periods else 1 for i in range(system.nx)])
            seen_centre = np.where(signs < 0, 0.0, seen_centre)
            control_centre = np.where(mirror.controls < 0, 0.0, control_centre)
        spread, moved = positive(system.spread(states)) if system.periods else deviation(states), np.any(change, axis=0)
        return cls(
            spread,
            seen_centre,
            deviation(seen),
            control_centre,
            deviation(controls),
            np.where(moved, root_mean_square(change), STILL * spread),
        )

    def of_inputs(self, layout: CarryLayout) -> tuple[Array, Array]:
        """Return centre and scale of the features of (carry, control)."""
        return (
            np.array(layout.each_input(self.seen_centre, self.control_centre)),
            np.array(layout.each_input(self.seen_scale, self.control_scale)),
        )


def positive(values: Array) -> Array:
    """Return ``values`` with 1 in place of 0, to divide by."""
    return np.where(values > 0, values, 1.0)


def root_mean_square(values: Array) -> Array:
    """Return the root mean square of each column of (N, n), 1 for a column of zeros."""
    return positive(np.sqrt(np.mean(values**2, axis=0)))


def deviation(values: Array) -> Array:
    """Return the standard deviation of each column of (N, n), 1 for a constant column.

    The computed deviation of a constant such as 0.3 is 1e-17, which must not become a gain.
    """
    spread, size = values.std(axis=0), np.abs(values).max(axis=0)
    return np.where(spread > CONSTANT * size, spread, 1.0)


STEERING = ("steer",)
"""Names of controls that steer, unless others are given."""


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
