"""Systems of which one output is measured, small and without noise."""

from __future__ import annotations

import numpy as np

from sysid_evo.data import Dataset
from sysid_evo.system import Channel, System
from sysid_evo.types import Array

OUTPUT_ONLY = System((Channel("position", "m"),), (Channel("force", "N", low=-1.0, high=1.0),), dt=0.1)
OSCILLATOR = np.array([[0.98, 0.15], [-0.15, 0.95]])


def recording(
    seed: int, steps: int = 400, bend: float = 0.0, noise: float = 0.0, centre: float = 0.0, waves: float = 0.0
) -> Dataset:
    """Return the position of an oscillator from a random state; its spring stiffens with ``bend``.

    The control acts through a curve with ``waves``, which a unit alone cannot follow.
    """
    rng = np.random.default_rng(seed)
    controls = np.repeat(rng.uniform(-1.0, 1.0, steps // 5), 5)
    state, outputs = rng.uniform(-0.5, 0.5, 2), [0.0]
    outputs = [state[0]]
    for u in controls:
        state = OSCILLATOR @ state + np.array([0.0, 0.15 * (u + waves * np.sin(5.0 * u)) - bend * state[0] ** 3])
        outputs.append(state[0])
    measured: Array = np.array(outputs) + centre + noise * rng.standard_normal(steps + 1)
    return Dataset.from_arrays(OUTPUT_ONLY, measured, controls)


def chain(seed: int, steps: int = 600) -> Dataset:
    """Return what comes out of a chain of five: two oscillators, the first behind a curve that saturates, and a lag."""
    rng = np.random.default_rng(seed)
    controls = rng.uniform(-1.0, 1.0, steps)
    turning = 0.9 * np.array([[np.cos(0.6), np.sin(0.6)], [-np.sin(0.6), np.cos(0.6)]])
    slower = 0.9 * np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])
    first, second, lag, outputs = np.zeros(2), np.zeros(2), 0.0, [0.0]
    for u in controls:
        lag = 0.7 * lag + np.tanh(second[0])
        second = slower @ second + np.array([0.0, first[0]])
        first = turning @ first + np.array([0.0, u])
        outputs.append(lag)
    measured: Array = np.array(outputs) + 0.01 * rng.standard_normal(steps + 1)
    return Dataset.from_arrays(OUTPUT_ONLY, measured, controls)
