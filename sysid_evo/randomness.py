"""Seeds and counter-based random numbers by (seed, trial, stream).

The generator is Philox, which is counter-based: the number for a step depends only on the key and the step. All
candidates of a generation therefore have the same trials, in any order and engine.
"""

from __future__ import annotations

import numpy as np

from sysid_evo.errors import InvalidArgument
from sysid_evo.types import Array, Seeds

TASK_STREAM = 0
NOISE_STREAM = 1
DRAW_STREAM = 2
CONTROLLER_STREAM = 3


def as_seed(seed: int) -> int:
    """Return ``seed`` as an int. Raises `InvalidArgument` unless it is a whole number >= 0."""
    if isinstance(seed, (int, np.integer)) and not isinstance(seed, bool) and seed >= 0:
        return int(seed)
    raise InvalidArgument(f"seed: expected a whole number >= 0, got {seed!r}")


def derived_seed(seed: int, *key: int) -> int:
    """Return a seed derived from ``seed`` for the part with the numbers ``key``."""
    return int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1, np.uint32)[0])


def keyed_generator(seed: int, *key: int) -> np.random.Generator:
    """Return a generator derived from ``seed`` for the part with the numbers ``key``."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


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


def draw(
    seeds: Seeds, stream: int, shape: tuple[int, ...], draw: str = "standard_normal", *, out: Array | None = None
) -> Array:
    r"""Return the first numbers of the `generator` of each seed in one stream, (E, \*shape).

    ``draw`` is the name of a method that fills an array; ``out`` is filled if it is given. One generator is reset to
    every key, because making a new one takes ten times as long.
    """
    found = np.empty((len(seeds), *shape)) if out is None else out
    if not found.size:
        return found
    counter = np.random.Philox(key=0)
    state = counter.state
    draw_into = getattr(np.random.Generator(counter), draw)
    for trial, seed in zip(found, seeds.tolist(), strict=True):
        state["state"]["key"] = np.array([seed, stream], dtype=np.uint64)
        counter.state = state
        draw_into(out=trial)
    return found


def draw_for_steps(
    seeds: Seeds, horizon: int, n_noise: int, stream: int = NOISE_STREAM, *, out: Array | None = None
) -> Array:
    """Return standard normal numbers for every trial and step, (E, horizon, n_noise), of one stream."""
    return draw(seeds, stream, (horizon, n_noise), out=out)


def draw_for_trials(seeds: Seeds, n_draws: int) -> Array:
    """Return standard normal numbers for every trial, (E, n_draws)."""
    return draw(seeds, DRAW_STREAM, (n_draws,))


def as_generator(rng: np.random.Generator | int | None) -> np.random.Generator:
    """Return ``rng`` if it is a generator, else that of the seed ``rng``; None is seed 0, so results are repeatable."""
    if isinstance(rng, np.random.Generator):
        return rng
    if rng is None or (isinstance(rng, (int, np.integer)) and not isinstance(rng, bool) and rng >= 0):
        return np.random.default_rng(0 if rng is None else rng)
    raise InvalidArgument(f"rng: expected a seed (a whole number >= 0), a Generator or None, got {rng!r}")
