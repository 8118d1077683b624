"""The seed of each cell, from the seed of the experiment and what the cell does."""

from __future__ import annotations

import zlib

import numpy as np


def cell_seed(seed: int, work: str) -> int:
    """Return the seed of ``work``: it depends on the experiment's seed and the text, not on its place in a plan."""
    key = zlib.crc32(work.encode())
    return int(np.random.SeedSequence(seed, spawn_key=(key,)).generate_state(1, np.uint32)[0])
