"""Switches: which level of a discrete control an output in [-1, 1] selects."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from sysid_evo.arrays import Array

SWITCH_MARGIN = 0.9
"""Boundaries between levels are equal parts of [-1, 1] drawn together by this factor.

Three levels then switch at -0.3 and 0.3, as in section 5.2 of the paper.
"""


@cache
def level_boundaries(n_levels: int) -> tuple[float, ...]:
    """Return the ``n_levels - 1`` outputs at which a switch changes its level."""
    return tuple(SWITCH_MARGIN * np.arange(2 - n_levels, n_levels, 2) / n_levels)


def switch(raw: Array, levels: Sequence[float], control: Array) -> None:
    """Write the level that each output in [-1, 1] selects to ``control``; a boundary itself is inner."""
    control[...] = levels[0]
    for boundary, level in zip(level_boundaries(len(levels)), levels[1:], strict=True):
        np.copyto(control, level, where=(raw >= boundary) if boundary < 0 else (raw > boundary))
