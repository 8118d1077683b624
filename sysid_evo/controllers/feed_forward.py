"""A network without memory: what it does depends on what it sees now."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Self

import numpy as np

from sysid_evo.arrays import Array, check_shape
from sysid_evo.controllers.controller import Controller, View
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import register_controller

if TYPE_CHECKING:
    from sysid_evo.export.program import Program
    from sysid_evo.kernels import ControllerKernel


@register_controller("feed_forward")
class FeedForward(Controller):
    """A multi-layer perceptron; ``hidden`` is the number of units of its hidden layer, or of each of several.

    ::

        h_1 = tanh(W_1 o + b_1),    h_2 = tanh(W_2 h_1 + b_2),    ...,    y = tanh(W_n h_(n-1) + b_n)

    The parameters are, layer by layer, the weights (n_in, n_out) row by row and then the biases (n_out,).
    """

    n_memory = 0

    def __init__(self, *, hidden: int | Sequence[int] = 8) -> None:
        sizes = (hidden,) if isinstance(hidden, int) else tuple(hidden)
        if not sizes or not all(isinstance(size, int) and size >= 1 for size in sizes):
            raise InvalidArgument(f"feed_forward: expected hidden >= 1, or a list of such numbers, got {hidden}")
        self.hidden = hidden

    def bind(self, n_observations: int, n_outputs: int) -> Self:
        bound = copy.copy(self)
        inner = (self.hidden,) if isinstance(self.hidden, int) else tuple(self.hidden)
        bound.sizes = (n_observations, *inner, n_outputs)
        bound.n_parameters = sum((n_in + 1) * n_out for n_in, n_out in pairwise(bound.sizes))
        return bound

    sizes: tuple[int, ...]

    def layers(self, parameters: Array) -> list[tuple[Array, Array]]:
        """Return the weights (P, n_in, n_out) and the biases (P, 1, n_out) of every layer."""
        check_shape("parameters", parameters, (None, self.n_parameters))
        found, at = [], 0
        for n_in, n_out in pairwise(self.sizes):
            weights = parameters[:, at : at + n_in * n_out].reshape(-1, n_in, n_out)
            bias = parameters[:, at + n_in * n_out : at + (n_in + 1) * n_out]
            found.append((weights, bias[:, None]))
            at += (n_in + 1) * n_out
        return found

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        y = view.observation
        for weights, bias in self.layers(parameters):
            y = np.tanh(y @ weights + bias)
        return y, memory.copy()

    def kernel(self) -> ControllerKernel:
        from sysid_evo.engine.kernels.feed_forward import feed_forward_kernel

        return feed_forward_kernel(self.sizes)

    def program(self, parameters: Array) -> Program:
        from sysid_evo.export.program import Program, Statement, constant, dot, observation, tanh

        value, statements = observation(self.sizes[0]), []
        layers = self.layers(parameters[None])
        for number, (weights, bias) in enumerate(layers, start=1):
            name = "raw" if number == len(layers) else f"hidden_{number}"
            term = dot(f"W_{number}", weights[0].T, value) + constant(f"B_{number}", bias[0, 0])
            remark = "outputs in [-1, 1]" if name == "raw" else f"hidden layer {number}"
            statements.append(Statement(name, tanh(term), remark))
            value = statements[-1].value
        return Program(tuple(statements), value)
