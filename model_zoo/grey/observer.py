"""Where hidden states are, from a short history of what is measured."""

from __future__ import annotations

import numpy as np

from model_zoo.grey.structure import Structure
from sysid_evo.arrays import Array

ROUNDS = 3
STEP = 1e-4
"""Of the spread of a hidden state: the step of a difference quotient."""


def follow(structure: Structure, p: Array, states: Array, controls: Array, hidden: Array) -> Array:
    """Return the hidden states (n, ..., B) after a history (B, L + 1, nx), (B, L, nu) from those at its beginning.

    All other states are the measured ones at every sample; the first command counts as held before.
    """
    rows, rank = structure.hidden_rows, p.ndim
    for k in range(controls.shape[1]):
        carry = structure.start(p, states[:, : k + 1], controls[:, : max(k, 1)], hidden)
        control = controls[:, k].T.reshape(structure.system.nu, *[1] * (rank - 2), -1)
        hidden = structure.step(p, carry, control)[0][rows]
    return hidden


def observed(
    structure: Structure, p: Array, states: Array, controls: Array, *, mean: Array, spread: Array, noise: Array
) -> Array:
    """Return the most likely hidden states (n, B) at the end of a history (B, L + 1, nx), (B, L, nu).

    Those at its beginning are normal with ``mean`` and ``spread`` (n,) before anything is seen; a free run from there
    is off what is measured by ``noise`` (nx,). Three rounds of Gauss and Newton, each row for itself.
    """
    n, batch, length = len(mean), len(states), controls.shape[1]
    low, high = structure.extended.limits[:, structure.hidden_rows, None]
    guess = np.zeros((n, batch))
    p3 = p[:, None, None]
    for _ in range(ROUNDS if length else 0):
        moved = np.tile(guess[:, None], (1, 1 + n, 1))
        moved[np.arange(n), 1 + np.arange(n)] += STEP
        hidden = mean[:, None, None] + spread[:, None, None] * moved
        carry = structure.start(p3, states[:, :1], controls[:, :1], hidden)
        off = np.empty((length, 1 + n, batch, structure.system.nx))
        for k in range(length):
            carry = np.concatenate(structure.step(p3, carry, controls[:, k].T[:, None]))
            reached = np.moveaxis(carry[: structure.system.nx], 0, -1)
            off[k] = structure.system.difference(reached, np.broadcast_to(states[:, k + 1], reached.shape)) / noise
        error = np.moveaxis(off[:, 0], 1, 0).reshape(batch, -1)
        by = np.moveaxis((off[:, 1:] - off[:, :1]) / STEP, (1, 2), (-1, 0)).reshape(batch, -1, n)
        error, by = np.nan_to_num(error), np.nan_to_num(by)
        normal = np.swapaxes(by, 1, 2) @ by + np.eye(n)
        gradient = np.einsum("bmi,bm->bi", by, error) + guess.T
        guess = np.clip(guess - np.linalg.solve(normal, gradient[..., None])[..., 0].T, -4.0, 4.0)
    began = np.clip(mean[:, None] + spread[:, None] * guess, low, high)
    return follow(structure, p[:, None], states, controls, began)
