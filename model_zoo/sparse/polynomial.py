"""Polynomials of several variables as a list of exponents: evaluated in batches, printed with units."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations_with_replacement

import numpy as np

from sysid_evo.arrays import Array, IntArray


def monomials(n_inputs: int, degree: int) -> IntArray:
    """Return the exponents (T, n_inputs) of all monomials up to ``degree``, constant first, by rising degree."""
    rows = [
        np.bincount(np.array(chosen, dtype=np.int64), minlength=n_inputs)
        for order in range(degree + 1)
        for chosen in combinations_with_replacement(range(n_inputs), order)
    ]
    return np.array(rows, dtype=np.int64)


def evaluate(inputs: Array, exponents: IntArray) -> Array:
    """Return the monomials (B, T) of ``inputs`` (B, n)."""
    terms = np.ones((len(inputs), len(exponents)))
    for power in range(1, int(exponents.max(initial=0)) + 1):
        for column in range(exponents.shape[1]):
            rows = np.flatnonzero(exponents[:, column] >= power)
            if len(rows):
                terms[:, rows] *= inputs[:, column, None]
    return terms


def term_name(exponents: IntArray, names: Sequence[str]) -> str:
    """Return one monomial in words, such as ``forward_speed^2 steer``; ``1`` for the constant."""
    parts = [name if power == 1 else f"{name}^{power}" for name, power in zip(names, exponents, strict=True) if power]
    return " ".join(parts) or "1"


def term_unit(exponents: IntArray, units: Sequence[str], of: str) -> str:
    """Return the unit of a coefficient of this monomial in a quantity measured in ``of``."""
    below = [
        f"({unit})" + (f"^{power}" if power > 1 else "")
        for unit, power in zip(units, exponents, strict=True)
        if power and unit
    ]
    return of if not below else f"({of or '1'})/" + "/".join(below)


def equation(
    left: str, unit: str, coefficients: Array, exponents: IntArray, names: Sequence[str], units: Sequence[str]
) -> str:
    """Return one equation; every coefficient (T,) that is not zero is followed by its unit in brackets."""
    parts = []
    for value, powers in zip(coefficients, exponents, strict=True):
        if value:
            dimension = term_unit(powers, units, unit)
            name = term_name(powers, names)
            factor = f"{abs(value):.6g}" + (f" [{dimension}]" if dimension else "")
            parts.append(("- " if value < 0 else "+ ") + factor + ("" if name == "1" else f" {name}"))
    right = " ".join(parts) if parts else "0"
    return f"{left} = {right.removeprefix('+ ')}"


def lagged_names(names: Sequence[str], controls: Sequence[str], lags: tuple[int, int]) -> list[str]:
    """Return the names of (carry, control): states, earlier states, earlier controls, control."""
    earlier = [f"{name}[-{lag}]" for lag in range(1, lags[0] + 1) for name in names]
    held = [f"{name}[-{lag}]" for lag in range(1, lags[1] + 1) for name in controls]
    return [*names, *earlier, *held, *controls]
