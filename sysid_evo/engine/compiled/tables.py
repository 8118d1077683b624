"""What the loop over time reads beside the kernels' own numbers: how controls are switched, limits, noise."""

from __future__ import annotations

from typing import Any

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.engine.compiled.memory import empty_lines
from sysid_evo.kernels import LANES, QUARTER, Precision
from sysid_evo.switches import level_boundaries
from sysid_evo.system import System


def actuation_table(system: System, precision: Precision, *, before_tanh: bool = False) -> Array:
    """Return `System.actuate` as numbers: the width of a row, then one row a control.

    ``[count, low, high, level 0, level 1, boundary 1, level 2, boundary 2, ...]``; count 0 is continuous, -1 too,
    but of an output that is still to be squashed (``before_tanh``); boundaries are then those before tanh. A boundary
    belongs to the level nearer to zero, so that a negative one is the last number of ``precision`` below it.
    """
    most = max((len(channel.levels) for channel in system.controls if channel.levels), default=0)
    system.actuate(np.zeros(system.nu))  # raises for a control that has neither limits nor levels
    table = np.zeros((system.nu, 4 + 2 * most))
    for row, channel in zip(table, system.controls, strict=True):
        row[0], row[1], row[2] = -1.0 if before_tanh else 0.0, channel.low, channel.high
        if channel.levels is not None:
            row[0], row[3] = len(channel.levels), channel.levels[0]
            for i, boundary in enumerate(level_boundaries(len(channel.levels)), start=1):
                bound = np.array(np.arctanh(boundary) if before_tanh else boundary, precision)
                row[2 + 2 * i] = channel.levels[i]
                row[3 + 2 * i] = np.nextafter(bound, -np.inf, dtype=precision) if boundary < 0.0 else bound
    return np.concatenate([[table.shape[1]], table.ravel()])


def envelope_table(envelope: Array | None, nx: int, precision: Precision) -> Array:
    """Return the lowest and the highest value of each state, none infinite, and the largest number of ``precision``."""
    most = np.finfo(precision).max
    limits = np.full((2, nx), np.inf) * [[-1.0], [1.0]] if envelope is None else envelope
    return np.append(np.clip(limits, -most, most), most)


def noise_table(noise: Array, precision: Precision) -> Any:
    """Return ``noise`` (E, steps, n_noise) as the loop reads it, flat.

    Of up to sixteen trials it is (steps, n_noise, 16), and every lane looks up that of its trial; of more it is
    (steps, n_noise, E + LANES), the trials in order, again and again, so that any 64 rollouts that follow each
    other find theirs in one piece.
    """
    trials, steps, n_noise = noise.shape
    if not n_noise:
        return empty_lines(0, precision)
    by_trial = np.ascontiguousarray(noise.reshape(trials, -1).T, dtype=precision)
    if trials <= QUARTER:
        found = empty_lines(steps * n_noise * QUARTER, precision)
        found.reshape(-1, QUARTER)[:, :trials] = by_trial
        return found
    found = empty_lines(steps * n_noise * (trials + LANES), precision)
    in_order = np.arange(trials + LANES) % trials
    np.take(by_trial, in_order, axis=1, out=found.reshape(-1, trials + LANES), mode="clip")
    return found
