"""Fit of the polynomials of float32 kernels: ``python -m tests.benchmarks.elementary``.

Prints the minimax coefficients, lowest power first, and their largest error before rounding.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from rich.console import Console
from rich.table import Table

from sysid_evo.types import Array

ITERATIONS = 400
END_OF_TANH = 9.0


def lawson(numerator: Array, denominator: Array, f: Array, weight: Array) -> tuple[float, Array, Array]:
    """Return the largest of |weight (N / D - f)|, the coefficients of N, and those of D = 1 + ...

    Least squares with weights raised where the error is large (Lawson), over bases (points, n).
    """
    lawson_weight, d = np.ones(len(f)), np.ones(len(f))
    best: tuple[float, Array, Array] | None = None
    for _ in range(ITERATIONS):
        scale = np.sqrt(lawson_weight) * weight / d
        system = np.concatenate([numerator, -f[:, None] * denominator], axis=1) * scale[:, None]
        size = np.abs(system).max(axis=0)
        solution = np.linalg.lstsq(system / size, f * scale, rcond=1e-15)[0] / size
        p, q = solution[: numerator.shape[1]], solution[numerator.shape[1] :]
        d = 1.0 + denominator @ q
        error = np.abs(weight * (numerator @ p / d - f))
        if best is None or error.max() < best[0]:
            best = float(error.max()), p, q
        lawson_weight = np.maximum(lawson_weight * error / (lawson_weight * error).max(), 1e-12)
    assert best is not None
    return best


def chebyshev_points(end: float, count: int, least: float) -> Array:
    """Return points in (least, end], dense at both ends."""
    x = end / 2.0 * (1.0 + np.cos(np.linspace(0.0, np.pi, count)))
    return x[x > least]


def powers(s: Array, first: int, last: int) -> Array:
    """Return s^first ... s^last, (points, last - first + 1)."""
    return np.stack([s**i for i in range(first, last + 1)], axis=1)


def fit_tanh() -> tuple[float, Array, Array]:
    """Return the error and coefficients of tanh x / x = P(x^2) / Q(x^2), of degree 4 each, on (0, 9]."""
    x = chebyshev_points(END_OF_TANH, 6000, 1e-4)
    s, f = (x / END_OF_TANH) ** 2, np.tanh(x) / x
    error, p, q = lawson(powers(s, 0, 4), powers(s, 1, 4), f, 1.0 / f)
    scale = END_OF_TANH**2
    return error, p / scale ** np.arange(5), q / scale ** np.arange(1, 5)


def fit_odd(function: Callable[[Array], Array], end: float, terms: int) -> tuple[float, Array, Array]:
    """Return the error and coefficients of f(x) = x + x^3 P(x^2) on (0, ``end``]; P has ``terms`` terms."""
    x = chebyshev_points(end, 4000, 1e-5)
    f = function(x) / x
    return lawson(powers(x * x, 1, terms), np.zeros((len(x), 0)), f - 1.0, 1.0 / f)


def main() -> None:
    """Print the coefficients and their errors."""
    fits = {
        "tanh x / x = P / Q": fit_tanh(),
        "sin x = x + x^3 P": fit_odd(np.sin, np.pi / 2, 4),
        "atan x = x + x^3 P": fit_odd(np.arctan, 1.0, 8),
    }
    table = Table("form (P and Q in x^2)", "relative error", "P", "Q without its 1")
    for name, (error, p, q) in fits.items():
        table.add_row(name, f"{error:.2e}", "\n".join(map(repr, p.tolist())), "\n".join(map(repr, q.tolist())))
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
