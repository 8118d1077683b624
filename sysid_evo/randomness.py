"""Seeds and counter-based random numbers by (seed, trial, stream).

The generator is Philox, which is counter-based: the number for a step depends on the key and on
the step alone, so every candidate of a generation meets the same trials, in any order and engine.
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
    """Return ``seed`` as a plain number. Raises `InvalidArgument` for anything but a whole number >= 0."""
    if isinstance(seed, (int, np.integer)) and not isinstance(seed, bool) and seed >= 0:
        return int(seed)
    raise InvalidArgument(f"seed: expected a whole number >= 0, got {seed!r}")


def derived_seed(seed: int, *key: int) -> int:
    """Return the seed of one part of what ``seed`` decides, by the numbers of the part."""
    return int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1, np.uint32)[0])


def keyed_generator(seed: int, *key: int) -> np.random.Generator:
    """Return the generator of one part of what ``seed`` decides, so that no generator has to be kept."""
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
    r"""Return what the `generator` of each seed draws first from one stream, (E, \*shape).

    ``draw`` is the name of a method that fills an array; ``out`` is filled if it is given. One generator is turned to
    every key in turn, as it takes ten times as long to make one.
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
    """Return standard normal numbers for every trial and step, (E, horizon, n_noise): a dynamics' or another stream."""
    return draw(seeds, stream, (horizon, n_noise), out=out)


def draw_for_trials(seeds: Seeds, n_draws: int) -> Array:
    """Return standard normal numbers for every trial, (E, n_draws)."""
    return draw(seeds, DRAW_STREAM, (n_draws,))


def as_generator(rng: np.random.Generator | int | None) -> np.random.Generator:
    """Return a generator: the one given, or that of a seed; None is seed 0, so that the same call gives the same."""
    if isinstance(rng, np.random.Generator):
        return rng
    if rng is None or (isinstance(rng, (int, np.integer)) and not isinstance(rng, bool) and rng >= 0):
        return np.random.default_rng(0 if rng is None else rng)
    raise InvalidArgument(f"rng: expected a seed (a whole number >= 0), a Generator or None, got {rng!r}")
