"""Which candidates are kept, and what each weighs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from sysid_evo.arrays import Array

NARROWER = (1.0, 0.5, 0.25, 0.0)
"""The gates that are compared, as shares of how far the widest reaches beyond the best."""
AS_GOOD = 0.01
"""Share of the lowest error by which the mean of more candidates may be worse than that of fewer."""


@dataclass(frozen=True)
class Passed:
    """The ``gate`` that was taken, and the error of the mean of all that are inside each of those compared."""

    gate: float
    compared: tuple[tuple[float, float], ...]


def weights_of(structures: Sequence[str]) -> Array:
    """Return the weights (M,) of members of these classes: a class counts as the root of how many are in it.

    Within a class they are equal; their sum is 1. Structurally different models err in different ways, seeds and
    settings of one mostly in the same: a class of many says more than a class of one, and less than as many classes.
    """
    count = Counter(structures)
    found = np.array([1.0 / np.sqrt(count[structure]) for structure in structures])
    return np.asarray(found / found.sum())


def inside(errors: Sequence[float], gate: float) -> list[int]:
    """Return the numbers of those whose error is at most ``gate`` times the lowest, in their order."""
    lowest = min(errors)
    return [number for number, error in enumerate(errors) if np.isfinite(error) and error <= gate * lowest]


def chosen(
    errors: Sequence[float], gate: float, mean_error: Callable[[list[int]], float], ties: Collection[int] = ()
) -> tuple[list[int], Passed]:
    """Return the numbers of the candidates that are kept, and how the gates compared.

    The gate is narrowed where the mean of those inside it, which ``mean_error`` tells, is worse than that of fewer: the
    widest whose mean is within 1 % of the best of these means. ``ties``, which are as good as the best for all that is
    known, stay while they are inside the widest.
    """
    gates = [1.0 + share * (gate - 1.0) for share in NARROWER]
    widest = inside(errors, gate)
    groups = {one: [number for number in widest if number in ties or number in inside(errors, one)] for one in gates}
    found: dict[tuple[int, ...], float] = {}
    for group in groups.values():
        if tuple(group) not in found:
            found[tuple(group)] = errors[group[0]] if len(group) == 1 else mean_error(group)
    compared = {one: found[tuple(group)] for one, group in groups.items()}
    lowest = min(compared.values())
    taken = next(one for one, error in compared.items() if error <= (1.0 + AS_GOOD) * lowest)
    return groups[taken], Passed(taken, tuple(compared.items()))
