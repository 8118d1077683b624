"""Feed-forward, recurrent, and imported policy networks."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Self

import numpy as np

from sysid_evo.controllers.controller import Controller, View
from sysid_evo.controllers.kernels import HEAD, feed_forward, recurrent
from sysid_evo.controllers.program import (
    Binary,
    Program,
    Statement,
    constant,
    dot,
    limited,
    number,
    observation,
    remembered,
    tanh,
)
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import ControllerKernel, KernelSource
from sysid_evo.registry.registry import register_controller
from sysid_evo.types import Array, check_shape


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
        return feed_forward_kernel(self.sizes)

    def program(self, parameters: Array) -> Program:
        value, statements = observation(self.sizes[0]), []
        layers = self.layers(parameters[None])
        for layer, (weights, bias) in enumerate(layers, start=1):
            name = "raw" if layer == len(layers) else f"hidden_{layer}"
            term = dot(f"W_{layer}", weights[0].T, value) + constant(f"B_{layer}", bias[0, 0])
            remark = "outputs in [-1, 1]" if name == "raw" else f"hidden layer {layer}"
            statements.append(Statement(name, tanh(term), remark))
            value = statements[-1].value
        return Program(tuple(statements), value)


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


@register_controller("recurrent")
class RecurrentNetwork(Controller):
    """An Elman network: hidden units see the inputs and all hidden units one step ago.

    ::

        h_t = tanh(W_in o_t + W_h h_{t-1}),    y_t = tanh(W_out h_t)

    The parameters are W_in (n_inputs, hidden), W_h (hidden, hidden), W_out (hidden, n_outputs), row
    by row; no bias of its own, since the task observes a constant 1. With 5 inputs, 6 hidden units
    and 2 outputs there are 78 (paper, section 5.2).
    """

    def __init__(self, *, hidden: int = 6) -> None:
        if hidden < 1:
            raise InvalidArgument(f"recurrent: expected at least one hidden unit, got {hidden}")
        self.hidden = hidden
        self.n_memory = hidden

    def bind(self, n_observations: int, n_outputs: int) -> Self:
        bound = copy.copy(self)
        bound.n_inputs, bound.n_outputs = n_observations, n_outputs
        bound.n_parameters = self.hidden * (n_observations + self.hidden + n_outputs)
        return bound

    n_inputs: int
    n_outputs: int

    def weights(self, parameters: Array) -> tuple[Array, Array, Array]:
        """Return W_in (P, n_inputs, hidden), W_h (P, hidden, hidden) and W_out (P, hidden, n_outputs)."""
        check_shape("parameters", parameters, (None, self.n_parameters))
        h, i, o = self.hidden, self.n_inputs, self.n_outputs
        w_in = parameters[:, : i * h].reshape(-1, i, h)
        w_hidden = parameters[:, i * h : (i + h) * h].reshape(-1, h, h)
        return w_in, w_hidden, parameters[:, (i + h) * h :].reshape(-1, h, o)

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        w_in, w_hidden, w_out = self.weights(parameters)
        hidden = view.observation @ w_in
        hidden += memory @ w_hidden
        np.tanh(hidden, out=hidden)
        raw = hidden @ w_out
        return np.tanh(raw, out=raw), hidden

    def kernel(self) -> ControllerKernel:
        return recurrent_kernel(self.n_inputs, self.hidden, self.n_outputs)

    def program(self, parameters: Array) -> Program:
        w_in, w_hidden, w_out = (weights[0].T for weights in self.weights(parameters[None]))
        seen, before = observation(self.n_inputs), remembered("hidden", self.hidden)
        units = Statement("units", tanh(dot("W_IN", w_in, seen) + dot("W_HIDDEN", w_hidden, before)), "hidden units")
        raw = Statement("raw", tanh(dot("W_OUT", w_out, units.value)), "outputs in [-1, 1]")
        return Program((units, raw), raw.value, {"hidden": units.value})


def feed_forward_kernel(sizes: tuple[int, ...]) -> ControllerKernel:
    """Return the compiled form of `FeedForward` with layers of these sizes, inputs first."""
    parameters = HEAD.pack(sizes, n_layers=len(sizes) - 1, widest=max(sizes))
    return ControllerKernel(KernelSource(feed_forward), parameters, 2 * max(sizes), before_tanh=True)


def recurrent_kernel(n_inputs: int, hidden: int, n_outputs: int) -> ControllerKernel:
    """Return the compiled form of `RecurrentNetwork`."""
    sizes = {"N_INPUTS": n_inputs, "HIDDEN": hidden, "N_OUTPUTS": n_outputs}
    return ControllerKernel(KernelSource(recurrent, sizes), n_scratch=hidden, before_tanh=True)
