"""Unknown parameters and hidden states: bounds, standard errors, undetermined parameters, tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid_evo.errors import InvalidArgument
from sysid_evo.system import Channel
from sysid_evo.types import Array, IntArray

DECADE = 10.0
"""Positive bounds with at least this ratio are searched on a logarithmic scale."""


@dataclass(frozen=True)
class Parameter:
    """An unknown number between ``low`` and ``high``, with a first ``guess`` and a ``unit``.

    With ``spread`` the guess is prior knowledge, such as a measurement: a normal prior with that standard deviation.
    """

    name: str
    guess: float
    low: float
    high: float
    unit: str = ""
    spread: float | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise InvalidArgument(
                f"parameter {self.name!r}: expected finite bounds low < high, got {self.low} and {self.high}; "
                "use wide ones if little is known"
            )
        if not self.low <= self.guess <= self.high:
            raise InvalidArgument(
                f"parameter {self.name!r}: expected a guess within [{self.low:g}, {self.high:g}], got {self.guess:g}"
            )
        if self.spread is not None and not self.spread > 0.0:
            raise InvalidArgument(f"parameter {self.name!r}: expected a spread > 0, got {self.spread}")

    @property
    def logarithmic(self) -> bool:
        """Whether it is searched on a logarithmic scale."""
        return self.low > 0.0 and self.high >= DECADE * self.low


@dataclass(frozen=True)
class HiddenState:
    """An unmeasured state: ``unit``, value at rest (``initial``), and bounds."""

    name: str
    unit: str = ""
    initial: float = 0.0
    low: float = -1.0
    high: float = 1.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low <= self.initial <= self.high):
            raise InvalidArgument(
                f"hidden state {self.name!r}: expected finite low <= initial <= high, "
                f"got {self.low}, {self.initial}, {self.high}"
            )

    @property
    def channel(self) -> Channel:
        """The state as a channel of the extended system."""
        return Channel(self.name, self.unit, low=self.low, high=self.high, neutral=self.initial)


@dataclass(frozen=True)
class ParameterBounds:
    """The bounds of n parameters as the unit cube in which they are searched: (..., n) to (..., n).

    Raises `InvalidArgument` if two have the same name.
    """

    parameters: Sequence[Parameter]

    def __post_init__(self) -> None:
        names = [parameter.name for parameter in self.parameters]
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise InvalidArgument(f"parameters: names must differ, repeated: {', '.join(repeated)}")

    @property
    def _ends(self) -> tuple[Array, Array, Array]:
        logarithmic = np.array([p.logarithmic for p in self.parameters], dtype=bool)
        low, high = (np.array([getattr(p, end) for p in self.parameters], dtype=float) for end in ("low", "high"))
        return (
            logarithmic,
            np.where(logarithmic, np.log(np.where(logarithmic, low, 1.0)), low),
            np.where(logarithmic, np.log(np.where(logarithmic, high, 1.0)), high),
        )

    def values(self, places: Array) -> Array:
        """Return the parameters at these points of the cube."""
        logarithmic, low, high = self._ends
        there = low + np.asarray(places) * (high - low)
        return np.where(logarithmic, np.exp(np.where(logarithmic, there, 0.0)), there)

    def places(self, values: Array) -> Array:
        """Undo `values`."""
        logarithmic, low, high = self._ends
        values = np.asarray(values, dtype=float)
        there = np.where(logarithmic, np.log(np.where(logarithmic, values, 1.0)), values)
        return np.asarray(np.clip((there - low) / (high - low), 0.0, 1.0))

    def slopes(self, places: Array) -> Array:
        """Return the derivative of each parameter along its side of the cube, (..., n)."""
        logarithmic, low, high = self._ends
        return (high - low) * np.where(logarithmic, self.values(places), 1.0)


BLOCKS = 40
"""Largest number of blocks of time that count as independent."""
MIN_BLOCKS = 8
OPEN = 0.5
"""A direction is undetermined if its standard error exceeds this share of that given by the bounds alone."""
AT_BOUND = 0.01
NAMED = 0.3
"""Share of a direction above which a parameter is named in its sentence."""


def parameter_covariance(
    errors: Array, jacobian: Array, by_hidden: Array, order: IntArray, *, known: Array
) -> tuple[Array, float, float]:
    """Return the covariance (n, n) of points in the cube, its inflation by correlated errors, and the noise.

    They come from errors (W, m) and their derivatives (W, m, n), (W, m, nh).
    The hidden initial states are projected out. Errors within a window and of neighbouring windows are correlated: in
    the sandwich A^-1 B A^-1, B is the sum of squared gradients of whole blocks of time (clustered standard errors,
    Liang and Zeger 1986) and A = J^T J + noise^2 K^-1, with K = ``known`` (n,), the variances without data.
    """
    windows, m, n = jacobian.shape
    if by_hidden.shape[2]:
        base, _ = np.linalg.qr(by_hidden)
        jacobian = jacobian - base @ (np.swapaxes(base, 1, 2) @ jacobian)
        errors = errors - (base @ (np.swapaxes(base, 1, 2) @ errors[..., None]))[..., 0]
    free = max(1, windows * (m - by_hidden.shape[2]) - n)
    noise = float(np.sqrt(np.sum(errors**2) / free)) + 1e-12
    bread = np.einsum("wmi,wmj->ij", jacobian, jacobian) / noise**2 + np.diag(1.0 / known)
    gradients = np.einsum("wmi,wm->wi", jacobian, errors) / noise**2
    blocks = max(min(MIN_BLOCKS, windows), min(BLOCKS, windows // 4))
    sums = np.array([gradients[rows].sum(axis=0) for rows in np.array_split(np.argsort(order, kind="stable"), blocks)])
    sums -= sums.mean(axis=0)
    few = blocks / max(blocks - n, 0.5 * blocks)  # n sums of gradients are zero at the optimum
    meat = few * sums.T @ sums * blocks / max(1, blocks - 1) + np.diag(1.0 / known)
    inverse = np.linalg.pinv(bread, hermitian=True)
    covariance = inverse @ meat @ inverse
    naive = np.clip(np.diag(inverse), 1e-300, None)
    determined = naive < OPEN**2 * known
    ratio = np.diag(covariance)[determined] / naive[determined]
    inflation = max(1.0, float(np.median(ratio))) if len(ratio) else 1.0
    # With few blocks: no direction is more certain than uncorrelated errors would make it.
    values, vectors = np.linalg.eigh(covariance)
    least = np.einsum("ij,jk,ki->i", vectors.T, inverse, vectors)
    covariance = (vectors * np.maximum(values, np.minimum(least, 1.0))) @ vectors.T
    return covariance, inflation, noise


def undetermined_parameters(
    parameters: Sequence[Parameter], places: Array, covariance: Array, known: Array
) -> tuple[list[str], list[bool]]:
    """Return sentences on what the data do not determine, and whether each parameter is determined.

    A direction of the cube is undetermined if its standard error is at least half of that given by the bounds alone.
    """
    prior = np.sqrt(known)
    relative = covariance / np.outer(prior, prior)
    values, vectors = np.linalg.eigh(relative)
    slopes = ParameterBounds(parameters).slopes(places) * prior
    notes: list[str] = []
    alone: set[int] = set()
    for value, vector in sorted(zip(values, vectors.T, strict=True), key=lambda pair: -pair[0]):
        if value < OPEN**2:
            break
        named = [int(i) for i in np.argsort(-np.abs(vector)) if abs(vector[i]) >= NAMED]
        named = [i for i in named if i not in alone]
        if len(named) == 1 or not named:
            if named:
                alone.add(named[0])
                one = parameters[named[0]]
                notes.append(
                    f"{one.name} is not determined by the data: its uncertainty is nearly as wide as its bounds, "
                    f"{one.low:g} to {one.high:g} {one.unit}".rstrip()
                )
            continue
        first = vector[named[0]] * slopes[named[0]]
        grow = [parameters[i].name for i in named if vector[i] * slopes[i] * first > 0]
        fall = [parameters[i].name for i in named if vector[i] * slopes[i] * first <= 0]
        falls = f" while {_and(fall)} {'falls' if len(fall) == 1 else 'fall'}" if fall else " together"
        names = _and(grow + fall)
        notes.append(f"the data determine only a combination of {names}: {_and(grow)} may grow{falls} without effect")
    determined = [bool(relative[i, i] < OPEN**2) for i in range(len(parameters))]
    for i, parameter in enumerate(parameters):
        if places[i] < AT_BOUND or places[i] > 1.0 - AT_BOUND:
            end, value = ("lower", parameter.low) if places[i] < AT_BOUND else ("upper", parameter.high)
            notes.append(f"{parameter.name} is at its {end} bound, {value:g} {parameter.unit}".rstrip())
    return list(dict.fromkeys(notes)), determined


def _and(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


CORRELATED = 0.9
"""Size of a correlation above which two parameters are listed as correlated."""


def parameter_rows(
    parameters: Sequence[Parameter], values: Array, covariance: Array, determined: Sequence[bool]
) -> list[dict[str, Any]]:
    """Return a row for every parameter: value, standard error, unit, bounds, whether the data determine it.

    ``values`` (n,) and their ``covariance`` (n, n) are in units. A row with ``correlations`` has those above 0.9, by
    the name of the other parameter.
    """
    errors = np.sqrt(np.diag(covariance))
    with np.errstate(all="ignore"):
        correlations = covariance / np.outer(errors, errors) - np.eye(len(errors))
    strong = [
        {one.name: float(value) for one, value in zip(parameters, row, strict=True) if abs(value) > CORRELATED}
        for row in correlations
    ]
    return [
        {
            "parameter": parameter.name,
            "value": float(value),
            "standard error": float(error),
            "unit": parameter.unit,
            "low": parameter.low,
            "high": parameter.high,
            "determined": known,
            **({"correlations": others} if others else {}),
        }
        for parameter, value, error, known, others in zip(parameters, values, errors, determined, strong, strict=True)
    ]
