"""Systems of which one output is measured, small and without noise."""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.system import Channel, System

OUTPUT_ONLY = System((Channel("position", "m"),), (Channel("force", "N", low=-1.0, high=1.0),), dt=0.1)
OSCILLATOR = np.array([[0.98, 0.15], [-0.15, 0.95]])


def recording(seed: int, steps: int = 400, bend: float = 0.0, noise: float = 0.0, centre: float = 0.0) -> Dataset:
    """Return the position of an oscillator from a random state; its spring stiffens with ``bend``."""
    rng = np.random.default_rng(seed)
    controls = np.repeat(rng.uniform(-1.0, 1.0, steps // 5), 5)
    state, outputs = rng.uniform(-0.5, 0.5, 2), [0.0]
    outputs = [state[0]]
    for u in controls:
        state = OSCILLATOR @ state + np.array([0.0, 0.15 * u - bend * state[0] ** 3])
        outputs.append(state[0])
    measured: Array = np.array(outputs) + centre + noise * rng.standard_normal(steps + 1)
    return Dataset.from_arrays(OUTPUT_ONLY, measured, controls)
