"""Random numbers by key: the same (seed, trial, stream) always gives the same sequence.

The generator is Philox, which is counter-based: the number for a step depends on the key and on
the step alone, so every candidate of a generation meets the same trials, in any order and engine.
"""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array, Seeds

TASK_STREAM = 0
NOISE_STREAM = 1
DRAW_STREAM = 2
CONTROLLER_STREAM = 3


def generator(seed: int | np.unsignedinteger, stream: int) -> np.random.Generator:
    """Return the generator of one trial and one stream."""
    return np.random.Generator(np.random.Philox(key=np.array([int(seed), stream], dtype=np.uint64)))


def trial_seeds(seed: int, trials: int, *, generation: int = 0) -> Seeds:
    """Return one seed for each trial (trials,), keyed by (seed, generation, trial)."""
    return np.array(
        [
            np.random.SeedSequence(seed, spawn_key=(generation, trial)).generate_state(1, np.uint64)[0]
            for trial in range(trials)
        ],
        dtype=np.uint64,
    )


def step_noise(seeds: Seeds, horizon: int, n_noise: int, stream: int = NOISE_STREAM) -> Array:
    """Return standard normal numbers for every trial and step, (E, horizon, n_noise): a dynamics' or another stream."""
    if not n_noise:
        return np.empty((len(seeds), horizon, 0))
    return np.stack([generator(seed, stream).standard_normal((horizon, n_noise)) for seed in seeds])


def trial_draws(seeds: Seeds, n_draws: int) -> Array:
    """Return standard normal numbers for every trial, (E, n_draws)."""
    if not n_draws:
        return np.empty((len(seeds), 0))
    return np.stack([generator(seed, DRAW_STREAM).standard_normal(n_draws) for seed in seeds])
