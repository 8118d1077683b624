"""How free runs depend on the coefficients of a correction: derivatives that are carried along beside the runs."""

from __future__ import annotations

import numpy as np

from sysid_evo.adaptation.pieces import Pieces
from sysid_evo.adaptation.terms import Terms
from sysid_evo.arrays import Array
from sysid_evo.dynamics.stepping import Dynamics, clip_state

STEP = 1e-4
"""Of a difference, in spreads of what is changed."""
STEEPEST = 1e6
"""Largest derivative that is believed: a run that diverges has larger ones."""


def sensitivities(model: Dynamics, terms: Terms, coefficients: Array, pieces: Pieces) -> tuple[Array, Array]:
    """Return where free runs go, (B, H, nx), and their derivatives by ``coefficients``, (size * nx, B, H, nx).

    With S_k the derivatives of the carry, S_k+1 = (dg/dcarry) S_k + dg/dC, g being one step of ``model`` with the
    correction. The former is found by differences in those parts of the carry that depend on the coefficients, a few
    states instead of all coefficients; the latter exactly, as a step is affine in them.
    """
    (batch, horizon, _), nx, count = pieces.controls.shape, terms.system.nx, coefficients.size
    spread = pieces.carry.std(axis=0)
    steps = STEP * np.where(spread > 0.0, spread, 1.0)
    carry, along = pieces.carry, np.zeros((batch, pieces.carry.shape[1], count))
    runs, derivatives = np.empty((batch, horizon, nx)), np.empty((count, batch, horizon, nx))
    with np.errstate(all="ignore"):
        for k in range(horizon):
            moved = np.flatnonzero(along.any(axis=(0, 2)))
            beside = np.repeat(carry[None], 1 + len(moved), axis=0)
            beside[np.arange(len(moved)) + 1, :, moved] += steps[moved, None]
            control = np.tile(pieces.controls[:, k], (len(beside), 1))
            flat = beside.reshape(-1, beside.shape[2])
            reached = model.step(flat, control, np.zeros((len(flat), model.n_noise)) if model.n_noise else None)
            corrected = terms.corrected(flat[:, :nx], control, reached[:, :nx], coefficients)
            after, _ = clip_state(np.concatenate([corrected, reached[:, nx:]], axis=1), pieces.envelope)
            after = after.reshape(beside.shape)
            changes = ((after[1:] - after[0]) / steps[moved, None, None]).transpose(1, 2, 0)
            direct = _by_coefficients(terms, carry[:, :nx], control[:batch], reached[:batch, :nx])
            unbounded = reached[:batch, :nx] + direct @ coefficients.ravel()
            direct[np.abs(unbounded - after[0, :, :nx]) > 1e-9 * (1.0 + np.abs(unbounded))] = 0.0
            along = changes @ along[:, moved]
            along[:, :nx] += direct
            along = np.clip(np.nan_to_num(along), -STEEPEST, STEEPEST)
            carry = after[0]
            runs[:, k], derivatives[:, :, k] = carry[:, :nx], along[:, :nx].transpose(2, 0, 1)
    return runs, derivatives


def _by_coefficients(terms: Terms, state: Array, control: Array, after: Array) -> Array:
    """Return the derivatives (B, nx, size * nx) of the next state by the coefficients, which are the same for all."""
    pushes = np.diag(terms.unit)[:, None]
    coasting = terms.system.integrate(state, np.zeros_like(state))
    of_terms = terms.system.integrate(np.repeat(state[None], len(pushes), axis=0), pushes + 0.0 * state) - coasting
    of_gains = np.broadcast_to(terms.system.dt * pushes, of_terms.shape)
    own = terms.size - len(terms.strength)
    moves = np.stack([of_terms] * own + [of_gains] * (terms.size - own))
    regressors = terms(state, control, after)
    return np.einsum("bs,sjbi->bisj", regressors, moves).reshape(len(state), terms.system.nx, -1)
