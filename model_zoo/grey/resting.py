"""A grey box at rest: nothing moves, nothing is commanded, so nothing begins."""

from __future__ import annotations

import numpy as np

from model_zoo.grey.structure import Structure
from sysid_evo.arrays import Array
from sysid_evo.dynamics import REST_BAND


def held_at_rest(structure: Structure, band: Array | None, carry: Array, control: Array, after: Array) -> Array:
    """Return the extended states ``after`` (B, n), neutral where nothing moves and nothing is commanded.

    ``band`` (n,) is how near to neutral counts as rest, None for nowhere; see `DynamicsModel.held`.
    """
    if band is None:
        return after
    system, layout = structure.extended, structure.layout
    idle = system.neutral_control
    still = (np.abs(carry[:, : system.nx] - system.neutral_state) <= band).all(axis=1)
    still &= (control == idle).all(axis=1)
    still &= (carry[:, layout.earlier_controls] == np.tile(idle, layout.control_lags)).all(axis=1)
    return np.where(still[:, None], system.neutral_state, after)


def extended_band(structure: Structure, band: Array) -> Array:
    """Return how near to neutral each extended state counts as rest (n,), of ``band`` (nx,) for the measured ones."""
    more = structure.extended.states[structure.system.nx :]
    width = [channel.high - channel.low if channel.bounded else 1.0 for channel in more]
    return np.concatenate([band, REST_BAND * np.array(width)])
