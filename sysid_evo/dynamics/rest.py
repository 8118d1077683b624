"""What holds a body at rest that neither moves nor is told to."""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.lags import CarryLayout
from sysid_evo.system import System

REST_BAND = 0.005
"""Share of the range of the training states, around neutral, that counts as rest."""


def band_of(system: System, envelope: Array, multiple: float) -> Array:
    """Return how near to neutral (nx,) a state counts as rest, by an ``envelope`` (2, nx) ``multiple`` ranges wide."""
    ranges = (envelope[1] - envelope[0]) / multiple
    for i, period in system.periods.items():
        ranges[i] = period
    return np.asarray(REST_BAND * ranges)


def held_at_rest(system: System, layout: CarryLayout, band: Array, carry: Array, control: Array, after: Array) -> Array:
    """Return ``after`` (B, nx), neutral where the body rests within ``band`` (nx,) and all controls are neutral.

    Earlier controls in the carry count too: with dead time, a short pulse acts after it has ended.
    """
    neutral, idle_control = system.neutral_state, system.neutral_control
    still = (np.abs(carry[..., : layout.nx] - neutral) <= band).all(axis=-1)
    past = carry[..., layout.earlier_controls]
    idle = (control == idle_control).all(axis=-1) & (past == np.tile(idle_control, layout.control_lags)).all(axis=-1)
    return np.where((still & idle)[..., None], neutral, after)
