"""What is known of coefficients, said in words: ``damping of yaw_rate <= 0``, ``steer in forward_speed = 0``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import permutations

import numpy as np
from scipy.optimize import lsq_linear

from model_zoo.sparse.polynomial import term_name
from sysid_evo.arrays import Array, BoolArray, IntArray
from sysid_evo.errors import InvalidArgument

SENTENCE = re.compile(r"\s*(?P<what>.+?)\s*(?P<sign><=|>=|==|=)\s*(?P<number>[-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*")
WHAT = "'TERM in STATE <= 0', 'damping of STATE <= 0' or 'terms with INPUT in STATE = 0', also with >= and ="


def bounds(
    sentences: Sequence[str],
    exponents: IntArray,
    names: Sequence[str],
    states: Sequence[str],
    *,
    as_far_as_there: bool = False,
) -> tuple[Array, Array]:
    """Return the lowest and highest value (T, nx) of every coefficient. Raises `InvalidArgument`.

    ``exponents`` (T, n) are those of the features ``names``. The damping of a state is the coefficient of the state
    itself in its own equation. With ``as_far_as_there`` a sentence on a term that is not among these says nothing.
    """
    low, high = np.full((len(exponents), len(states)), -np.inf), np.full((len(exponents), len(states)), np.inf)
    for sentence in sentences:
        found = SENTENCE.fullmatch(sentence)
        if found is None:
            raise InvalidArgument(f"constraints: expected {WHAT}; got {sentence!r}")
        chosen, state = _meant(found["what"], sentence, exponents, names, states)
        if not chosen.any() and not as_far_as_there:
            some = ", ".join(term_name(row, names) for row in exponents[:8])
            raise InvalidArgument(f"constraints: no such term: {sentence!r}; there are {some}, ...")
        number = float(found["number"])
        if found["sign"] != "<=":
            low[chosen, state] = np.maximum(low[chosen, state], number)
        if found["sign"] != ">=":
            high[chosen, state] = np.minimum(high[chosen, state], number)
    if (low > high).any():
        row, state = np.argwhere(low > high)[0]
        raise InvalidArgument(
            f"constraints: nothing is allowed for {term_name(exponents[row], names)} in {states[state]}: "
            f"at least {low[row, state]:g} and at most {high[row, state]:g}"
        )
    return low, high


def _meant(
    what: str, sentence: str, exponents: IntArray, names: Sequence[str], states: Sequence[str]
) -> tuple[BoolArray, int]:
    """Return which terms (T,) of which state's equation are meant."""
    damping = re.fullmatch(r"damping of (.+)", what)
    term, _, state = (damping[1], "", damping[1]) if damping else what.rpartition(" in ")
    if state.strip() not in states or not term:
        raise InvalidArgument(f"constraints: expected {WHAT} with STATE out of {', '.join(states)}; got {sentence!r}")
    every = re.fullmatch(r"terms with (.+)", term.strip())
    if every:
        chosen = np.any(exponents[:, [every[1].strip() == name for name in names]] > 0, axis=1)
    else:
        wanted = re.sub(r"[\s*]", "", term)
        chosen = np.array([wanted in _spellings(row, names) for row in exponents])
    return np.asarray(chosen, dtype=np.bool_), list(states).index(state.strip())


def _spellings(powers: IntArray, names: Sequence[str]) -> set[str]:
    """Return every way to write a term without blanks: its factors in any order."""
    parts = [name if power == 1 else f"{name}^{power}" for name, power in zip(names, powers, strict=True) if power]
    return {re.sub(r"[\s*]", "", "".join(order)) for order in permutations(parts)} if parts else {"1"}


def bounded_fit(terms: Array, target: Array, low: Array, high: Array, used: BoolArray, ridge: float) -> Array:
    """Return the least-squares coefficients (T,) of the terms ``used`` (T,) within bounds (T,), zero for the others.

    A term whose bounds exclude zero is always used.
    """
    used = (used | (low > 0) | (high < 0)) & ~((low == 0) & (high == 0))
    found = np.zeros(len(used))
    fixed = used & (low == high)
    found[fixed] = low[fixed]
    free = used & ~fixed
    if free.any():
        rest = target - terms @ found
        matrix = np.concatenate([terms[:, free], np.sqrt(ridge) * np.eye(int(free.sum()))])
        solution = lsq_linear(matrix, np.concatenate([rest, np.zeros(int(free.sum()))]), (low[free], high[free]))
        found[free] = np.clip(solution.x, low[free], high[free])
    return found
