"""Polynomials of several variables as a list of exponents: evaluated in batches, printed with units."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations_with_replacement

import numpy as np

from model_zoo.sparse.units import quotient
from sysid_evo.arrays import Array, IntArray

DEGREES = (2, 3)
"""What is tried where the degree is left open."""
MOST_TERMS: Mapping[str, int] = {"all": 250, "few": 150}
"""Terms of the largest library that is tried, by how many lags are."""


def library_size(n_inputs: int, degree: int) -> int:
    """Return how many monomials up to ``degree`` there are."""
    return math.comb(n_inputs + degree, degree)


def monomials(n_inputs: int, degree: int) -> IntArray:
    """Return the exponents (T, n_inputs) of all monomials up to ``degree``, constant first, by rising degree."""
    rows = [
        np.bincount(np.array(chosen, dtype=np.int64), minlength=n_inputs)
        for order in range(degree + 1)
        for chosen in combinations_with_replacement(range(n_inputs), order)
    ]
    return np.array(rows, dtype=np.int64)


def evaluate(inputs: Array, exponents: IntArray) -> Array:
    """Return the monomials (B, T) of ``inputs`` (B, n): factor by factor, for all terms at once."""
    rows = np.concatenate([inputs.T, np.ones((1, len(inputs)))])
    used = exponents.cumsum(axis=1)
    degree = int(used[:, -1].max(initial=0)) if used.size else 0
    terms = rows[np.sum(used <= 0, axis=1)]
    for power in range(1, degree):
        terms *= rows[np.sum(used <= power, axis=1)]  # past its last factor a term is multiplied by 1
    return terms.T


def term_name(exponents: IntArray, names: Sequence[str]) -> str:
    """Return one monomial in words, such as ``forward_speed^2 steer``; ``1`` for the constant."""
    parts = [name if power == 1 else f"{name}^{power}" for name, power in zip(names, exponents, strict=True) if power]
    return " ".join(parts) or "1"


def equation(
    left: str, unit: str, coefficients: Array, exponents: IntArray, names: Sequence[str], units: Sequence[str]
) -> str:
    """Return one equation; every coefficient (T,) that is not zero is followed by its unit in brackets."""
    parts = []
    for value, powers in zip(coefficients, exponents, strict=True):
        if value:
            dimension = quotient(unit, zip(units, (int(power) for power in powers), strict=True))
            name = term_name(powers, names)
            factor = f"{abs(value):.4g}" + (f" [{dimension}]" if dimension else "")
            parts.append(("- " if value < 0 else "+ ") + factor + ("" if name == "1" else f" {name}"))
    right = " ".join(parts) if parts else "0"
    return f"{left} = {right.removeprefix('+ ')}"
