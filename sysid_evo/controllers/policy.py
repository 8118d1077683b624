"""A policy that reinforcement learning found elsewhere, as a controller: its network, layer by layer."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Self

import numpy as np

from sysid_evo.arrays import Array, check_shape
from sysid_evo.controllers.controller import Controller, View
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import register_controller

if TYPE_CHECKING:
    from sysid_evo.export.program import Program


def rectified(values: Array) -> Array:
    """Return ``values`` with those below zero as zero."""
    return np.maximum(values, 0.0)


def clipped(values: Array) -> Array:
    """Return ``values`` kept in [-1, 1]."""
    return np.clip(values, -1.0, 1.0)


INNER: Mapping[str, Callable[[Array], Array]] = {"tanh": np.tanh, "relu": rectified}
OUTPUT: Mapping[str, Callable[[Array], Array]] = {"clip": clipped, "tanh": np.tanh}


@register_controller("policy")
class Policy(Controller):
    """The mean of a policy: a multi-layer perceptron whose last layer is linear and then kept within [-1, 1].

    ::

        h_1 = f(W_1 o + b_1),    ...,    y = g(W_n h_(n-1) + b_n)

    ``hidden`` lists the units of the inner layers, ``inner`` is f, "tanh" or "relu", ``output`` is g, "clip" (PPO) or
    "tanh" (SAC). The parameters are, layer by layer, the weights (n_in, n_out) row by row and then the biases (n_out,).
    """

    n_memory = 0

    def __init__(self, *, hidden: Sequence[int] = (64, 64), inner: str = "tanh", output: str = "clip") -> None:
        if not hidden or not all(isinstance(size, int) and size >= 1 for size in hidden):
            raise InvalidArgument(f"policy: expected a list of hidden >= 1, got {hidden!r}")
        if inner not in INNER or output not in OUTPUT:
            raise InvalidArgument(
                f"policy: expected inner to be {' or '.join(INNER)} and output {' or '.join(OUTPUT)}, "
                f"got {inner!r} and {output!r}"
            )
        self.hidden, self.inner, self.output = tuple(hidden), inner, output

    sizes: tuple[int, ...]

    def bind(self, n_observations: int, n_outputs: int) -> Self:
        bound = copy.copy(self)
        bound.sizes = (n_observations, *self.hidden, n_outputs)
        bound.n_parameters = sum((n_in + 1) * n_out for n_in, n_out in pairwise(bound.sizes))
        return bound

    def layers(self, parameters: Array) -> list[tuple[Array, Array]]:
        """Return weights (P, n_in, n_out) and biases (P, n_out) of every layer."""
        check_shape("parameters", parameters, (None, self.n_parameters))
        found, at = [], 0
        for n_in, n_out in pairwise(self.sizes):
            end = at + n_in * n_out
            found.append((parameters[:, at:end].reshape(-1, n_in, n_out), parameters[:, end : end + n_out]))
            at = end + n_out
        return found

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        y = view.observation
        for layer, (weights, bias) in enumerate(self.layers(parameters)):
            y = y @ weights + bias[:, None]
            y = OUTPUT[self.output](y) if layer == len(self.hidden) else INNER[self.inner](y)
        return y, memory.copy()

    def program(self, parameters: Array) -> Program:
        from sysid_evo.export.program import (
            Binary,
            Program,
            Statement,
            constant,
            dot,
            limited,
            number,
            observation,
            tanh,
        )

        value, statements = observation(self.sizes[0]), []
        for layer, (weights, bias) in enumerate(self.layers(parameters[None]), start=1):
            term = dot(f"W_{layer}", weights[0].T, value) + constant(f"B_{layer}", bias[0])
            if layer > len(self.hidden):
                shown = tanh(term) if self.output == "tanh" else limited(term)
                statements.append(Statement("raw", shown, "outputs in [-1, 1]"))
            else:
                shown = tanh(term) if self.inner == "tanh" else Binary(term.size, "max", term, number(0.0))
                statements.append(Statement(f"hidden_{layer}", shown, f"hidden layer {layer}"))
            value = statements[-1].value
        return Program(tuple(statements), value)
