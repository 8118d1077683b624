"""Whether a model is farther off in new seconds than on what was held out from its training."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid_evo.adaptation.pieces import Pieces, free_runs, off
from sysid_evo.adaptation.terms import Terms
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.dynamics.stepping import Dynamics
from sysid_evo.errors import InvalidData, PluginError

AS_AT_HOME = 1.5
"""Times the error at home, of the state that is worst, up to which nothing much has shifted."""
MOST_PIECES = 800
"""Free runs of one case: they overlap, and more of them take longer and say the same."""


def held_out_error(cases: Sequence[tuple[Dynamics, Dataset]]) -> Array | None:
    """Return the root mean square error (nx,) of free runs of one second, in the units of the states.

    ``cases`` are models of one family, each with what it did not learn from; None if one of these is too short.
    """
    squares = []
    for model, held in cases:
        try:
            pieces = Pieces.of(model, held)
        except InvalidData:
            return None
        pieces = pieces[np.unique(np.linspace(0, len(pieces) - 1, MOST_PIECES).round().astype(np.int64))]
        terms = Terms.of(held)
        wrong = off(terms, free_runs(model, terms, np.zeros((1, *terms.shape)), pieces), pieces)[0]
        squares.append(((wrong * pieces.scale) ** 2).reshape(-1, held.system.nx))
    return np.asarray(np.sqrt(np.concatenate(squares).mean(axis=0)))


def times_home(errors: Array, scale: Array, at_home: Array) -> float:
    """Return how many times farther off ``errors`` (B, H, nx), in units of ``scale`` (nx,), are than ``at_home`` (nx,).

    What counts is the state for which these are the most: a floor that slips may show in one of them alone. Raises
    `PluginError` if ``at_home`` is something else than a number for each state.
    """
    if np.shape(at_home) != scale.shape:
        raise PluginError(
            f"held_out_error_: expected a number for each of {len(scale)} states, got the shape {np.shape(at_home)}; "
            "sysid_evo.adaptation.held_out_error measures it"
        )
    found = np.sqrt(np.mean(errors**2, axis=(0, 1))) * scale
    return float(np.max(found / np.maximum(at_home, 1e-12 * scale)))
