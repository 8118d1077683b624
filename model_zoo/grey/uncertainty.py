"""How sure the parameters are: standard errors from the Jacobian, and what the data leave open, in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from model_zoo.grey.parameter import Box, Parameter
from sysid_evo.arrays import Array, IntArray

BLOCKS = 40
"""Blocks of time that count as independent, at most."""
FEWEST_BLOCKS = 8
OPEN = 0.5
"""Share of what the bounds alone say beyond which the data do not determine a direction."""
AT_BOUND = 0.01
NAMED = 0.3
"""Share of a direction from which on a parameter is named with it."""


@dataclass(frozen=True)
class Sureness:
    """Covariance (n, n) of the places in the cube, and by how much correlated errors ``inflate`` it."""

    covariance: Array
    inflation: float
    noise: float


def sureness(errors: Array, jacobian: Array, by_hidden: Array, order: IntArray, *, known: Array) -> Sureness:
    """Return the covariance of parameters from errors (W, m) and their derivatives (W, m, n), (W, m, nh).

    The hidden starts are projected out. Errors within a window, and of windows near each other, hang together: the
    sandwich A^-1 B A^-1 takes the sum of squares of the gradients of whole blocks of time for B (clustered standard
    errors, Liang and Zeger 1986), A = J^T J + noise^2 K^-1, K being ``known`` (n,), the variances without data.
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
    blocks = max(min(FEWEST_BLOCKS, windows), min(BLOCKS, windows // 4))
    sums = np.array([gradients[rows].sum(axis=0) for rows in np.array_split(np.argsort(order, kind="stable"), blocks)])
    sums -= sums.mean(axis=0)
    few = blocks / max(blocks - n, 0.5 * blocks)  # as many gradients as parameters add up to nothing at the optimum
    meat = few * sums.T @ sums * blocks / max(1, blocks - 1) + np.diag(1.0 / known)
    inverse = np.linalg.pinv(bread, hermitian=True)
    covariance = inverse @ meat @ inverse
    naive = np.clip(np.diag(inverse), 1e-300, None)
    determined = naive < OPEN**2 * known
    ratio = np.diag(covariance)[determined] / naive[determined]
    inflation = max(1.0, float(np.median(ratio))) if len(ratio) else 1.0
    # Blocks are few: no direction is surer than errors that do not hang together would make it.
    values, vectors = np.linalg.eigh(covariance)
    least = np.einsum("ij,jk,ki->i", vectors.T, inverse, vectors)
    covariance = (vectors * np.maximum(values, np.minimum(least, 1.0))) @ vectors.T
    return Sureness(covariance, inflation, noise)


def open_questions(
    parameters: Sequence[Parameter], places: Array, covariance: Array, known: Array
) -> tuple[list[str], list[bool]]:
    """Return what the data do not determine, in sentences, and whether each parameter is determined.

    A direction of the cube is open where the standard error is half of what the bounds alone say, or more.
    """
    prior = np.sqrt(known)
    relative = covariance / np.outer(prior, prior)
    values, vectors = np.linalg.eigh(relative)
    slopes = Box.of(parameters).slopes(places) * prior
    said: list[str] = []
    alone: set[int] = set()
    for value, vector in sorted(zip(values, vectors.T, strict=True), key=lambda pair: -pair[0]):
        if value < OPEN**2:
            break
        named = [int(i) for i in np.argsort(-np.abs(vector)) if abs(vector[i]) >= NAMED]
        named = [i for i in named if i not in alone]
        if len(named) == 1 or not named:
            if named:
                alone.add(named[0])
                said.append(_not_determined(parameters[named[0]]))
            continue
        first = vector[named[0]] * slopes[named[0]]
        grow = [parameters[i].name for i in named if vector[i] * slopes[i] * first > 0]
        fall = [parameters[i].name for i in named if vector[i] * slopes[i] * first <= 0]
        falls = f" while {_and(fall)} {'falls' if len(fall) == 1 else 'fall'}" if fall else " together"
        names = _and(grow + fall)
        said.append(f"the data determine only a combination of {names}: {_and(grow)} may grow{falls}, without a change")
    determined = [bool(relative[i, i] < OPEN**2) for i in range(len(parameters))]
    for i, parameter in enumerate(parameters):
        if places[i] < AT_BOUND or places[i] > 1.0 - AT_BOUND:
            end, value = ("lower", parameter.low) if places[i] < AT_BOUND else ("upper", parameter.high)
            said.append(f"{parameter.name} is at its {end} bound, {value:g} {parameter.unit}".rstrip())
    return list(dict.fromkeys(said)), determined


def _not_determined(parameter: Parameter) -> str:
    return (
        f"the data do not determine {parameter.name}: they say little more of it than its bounds, "
        f"{parameter.low:g} to {parameter.high:g} {parameter.unit}".rstrip()
    )


def _and(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
