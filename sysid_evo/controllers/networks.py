"""Neural networks: recurrent, feed-forward, and policies from reinforcement learning."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Self

import numpy as np

from sysid_evo.controllers.controller import Controller, View
from sysid_evo.controllers.program import (
    Binary,
    Program,
    Statement,
    apply,
    constant,
    dot,
    limited,
    number,
    observation,
    remembered,
)
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import (
    LANES,
    QUARTER,
    ControllerKernel,
    KernelSource,
    Layout,
    load,
    load_quarter,
    splat,
    splat_quarter,
    store,
    view,
)
from sysid_evo.registry.registry import register_controller
from sysid_evo.types import Array, check_shape


@register_controller("recurrent")
class RecurrentNetwork(Controller):
    """An Elman network: hidden units get the inputs and all hidden units of the step before.

    ::

        h_t = tanh(W_in o_t + W_h h_{t-1}),    y_t = tanh(W_out h_t)

    The parameters are W_in (n_inputs, hidden), W_h (hidden, hidden), W_out (hidden, n_outputs), row
    by row. There are no biases, because one observation is a constant 1. With 5 inputs, 6 hidden units
    and 2 outputs there are 78 parameters (paper, section 5.2).
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

    def first_steps(self, sizes: Array) -> Array:
        rest = np.ones(self.hidden * (self.hidden + self.n_outputs))
        return 1.0 / np.concatenate([np.repeat(sizes, self.hidden), rest])

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
        sizes = {"N_INPUTS": self.n_inputs, "HIDDEN": self.hidden, "N_OUTPUTS": self.n_outputs}
        return ControllerKernel(KernelSource(recurrent_lanes, sizes), n_scratch=self.hidden, before_tanh=True)

    def program(self, parameters: Array) -> Program:
        w_in, w_hidden, w_out = (weights[0].T for weights in self.weights(parameters[None]))
        seen, before = observation(self.n_inputs), remembered("hidden", self.hidden)
        total = dot("W_IN", w_in, seen) + dot("W_HIDDEN", w_hidden, before)
        units = Statement("units", apply("tanh", total), "hidden units")
        raw = Statement("raw", apply("tanh", dot("W_OUT", w_out, units.value)), "outputs in [-1, 1]")
        return Program((units, raw), raw.value, {"hidden": units.value})


def recurrent_lanes(theta, memory, observation, raw, parameters, scratch):
    """h = tanh(W_in o + W_h h) and W_out h, see `RecurrentNetwork`."""
    for first in range(0, LANES, QUARTER):
        own, seen = view(theta, first), view(observation, first)
        before, after = view(memory, first), view(scratch, first)
        sums(own, seen, before, after, N_INPUTS, HIDDEN)
    for j in range(HIDDEN):
        store(memory, j * LANES, math.tanh(load(scratch, j * LANES)))
    outward = view(theta, (N_INPUTS + HIDDEN) * HIDDEN * LANES)
    for j in range(N_OUTPUTS):
        total = splat(0.0)
        for i in range(HIDDEN):
            total = total + load(outward, (i * N_OUTPUTS + j) * LANES) * load(memory, i * LANES)
        store(raw, j * LANES, total)


def sums(weights, seen, before, after, n_inputs, hidden):
    """W_in o + W_h h in sixteen lanes, six units at a time, then two, so that each row is read once for all of them."""
    j = 0
    while j + 6 <= hidden:
        a, b, c = splat_quarter(0.0), splat_quarter(0.0), splat_quarter(0.0)
        d, e, f = splat_quarter(0.0), splat_quarter(0.0), splat_quarter(0.0)
        for i in range(n_inputs + hidden):
            row = load_quarter(seen, i * LANES) if i < n_inputs else load_quarter(before, (i - n_inputs) * LANES)
            own = view(weights, (i * hidden + j) * LANES)
            a = a + load_quarter(own, 0) * row
            b = b + load_quarter(own, LANES) * row
            c = c + load_quarter(own, 2 * LANES) * row
            d = d + load_quarter(own, 3 * LANES) * row
            e = e + load_quarter(own, 4 * LANES) * row
            f = f + load_quarter(own, 5 * LANES) * row
        store(after, j * LANES, a)
        store(after, (j + 1) * LANES, b)
        store(after, (j + 2) * LANES, c)
        store(after, (j + 3) * LANES, d)
        store(after, (j + 4) * LANES, e)
        store(after, (j + 5) * LANES, f)
        j += 6
    while j + 2 <= hidden:
        a, b = splat_quarter(0.0), splat_quarter(0.0)
        for i in range(n_inputs + hidden):
            row = load_quarter(seen, i * LANES) if i < n_inputs else load_quarter(before, (i - n_inputs) * LANES)
            own = view(weights, (i * hidden + j) * LANES)
            a = a + load_quarter(own, 0) * row
            b = b + load_quarter(own, LANES) * row
        store(after, j * LANES, a)
        store(after, (j + 1) * LANES, b)
        j += 2
    if j < hidden:
        a = splat_quarter(0.0)
        for i in range(n_inputs + hidden):
            row = load_quarter(seen, i * LANES) if i < n_inputs else load_quarter(before, (i - n_inputs) * LANES)
            a = a + load_quarter(weights, (i * hidden + j) * LANES) * row
        store(after, j * LANES, a)


INNER: Mapping[str, Callable[[Array], Array]] = {"tanh": np.tanh, "relu": lambda values: np.maximum(values, 0.0)}

OUTPUT: Mapping[str, Callable[[Array], Array]] = {"clip": lambda values: np.clip(values, -1.0, 1.0), "tanh": np.tanh}


class Perceptron(Controller):
    """Base class of `FeedForward` and `Policy`: units of the ``hidden`` layers, f (``inner``) and g (``output``).

    ::

        h_1 = f(W_1 o + b_1),    h_2 = f(W_2 h_1 + b_2),    ...,    y = g(W_n h_(n-1) + b_n)

    The parameters are, layer by layer, the weights (n_in, n_out) row by row and then the biases (n_out,).
    """

    n_memory = 0
    hidden: tuple[int, ...]
    inner = "tanh"
    output = "tanh"
    sizes: tuple[int, ...]

    def bind(self, n_observations: int, n_outputs: int) -> Self:
        bound = copy.copy(self)
        bound.sizes = (n_observations, *self.hidden, n_outputs)
        bound.n_parameters = parameters_of(bound.sizes)
        return bound

    def first_steps(self, sizes: Array) -> Array:
        first = np.repeat(sizes, self.sizes[1])
        return 1.0 / np.concatenate([first, np.ones(self.n_parameters - len(first))])

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        y = view.observation
        for layer, (weights, bias) in enumerate(layers_of(parameters, self.sizes)):
            y = y @ weights + bias
            y = OUTPUT[self.output](y) if layer == len(self.hidden) else INNER[self.inner](y)
        return y, memory.copy()

    def program(self, parameters: Array) -> Program:
        value, statements = observation(self.sizes[0]), []
        for layer, (weights, bias) in enumerate(layers_of(parameters[None], self.sizes), start=1):
            term = dot(f"W_{layer}", weights[0].T, value) + constant(f"B_{layer}", bias[0, 0])
            if layer > len(self.hidden):
                shown = apply("tanh", term) if self.output == "tanh" else limited(term)
                statements.append(Statement("raw", shown, "outputs in [-1, 1]"))
            else:
                relu = Binary(term.size, "max", term, number(0.0))
                shown = apply("tanh", term) if self.inner == "tanh" else relu
                statements.append(Statement(f"hidden_{layer}", shown, f"hidden layer {layer}"))
            value = statements[-1].value
        return Program(tuple(statements), value)


def parameters_of(sizes: Sequence[int]) -> int:
    """Return the number of weights and biases of a network with layers of these ``sizes``, inputs first."""
    return sum((n_in + 1) * n_out for n_in, n_out in pairwise(sizes))


def layers_of(parameters: Array, sizes: Sequence[int]) -> list[tuple[Array, Array]]:
    """Return weights (P, n_in, n_out) and biases (P, 1, n_out) of every layer, which ``parameters`` holds in order.

    Raises `ShapeError`.
    """
    check_shape("parameters", parameters, (None, parameters_of(sizes)))
    found, at = [], 0
    for n_in, n_out in pairwise(sizes):
        end = at + n_in * n_out
        found.append((parameters[:, at:end].reshape(-1, n_in, n_out), parameters[:, None, end : end + n_out]))
        at = end + n_out
    return found


@register_controller("feed_forward")
class FeedForward(Perceptron):
    """A multi-layer perceptron; ``hidden`` is the number of units of its hidden layer, or of each of several.

    ::

        h_1 = tanh(W_1 o + b_1),    h_2 = tanh(W_2 h_1 + b_2),    ...,    y = tanh(W_n h_(n-1) + b_n)

    The parameters are, layer by layer, the weights (n_in, n_out) row by row and then the biases (n_out,).
    """

    def __init__(self, *, hidden: int | Sequence[int] = 8) -> None:
        self.hidden = (hidden,) if isinstance(hidden, int) else tuple(hidden)
        if not self.hidden or not all(isinstance(size, int) and size >= 1 for size in self.hidden):
            raise InvalidArgument(f"feed_forward: expected hidden >= 1, or a list of such numbers, got {hidden}")

    def kernel(self) -> ControllerKernel:
        parameters = HEAD.pack(self.sizes, n_layers=len(self.sizes) - 1, widest=max(self.sizes))
        return ControllerKernel(KernelSource(feed_forward_lanes), parameters, 2 * max(self.sizes), before_tanh=True)


HEAD = Layout("n_layers", "widest")


def feed_forward_lanes(theta, memory, observation, raw, parameters, scratch):
    """W h + b, layer after layer, with tanh in between, see `FeedForward`."""
    n_layers, even = int(parameters[HEAD.n_layers]), view(scratch, 0)
    odd = view(scratch, int(parameters[HEAD.widest]) * LANES)
    weights = view(theta, 0)
    for layer in range(n_layers):
        n_in, n_out = int(parameters[HEAD.size + layer]), int(parameters[HEAD.size + layer + 1])
        source = observation if layer == 0 else (even if layer % 2 == 1 else odd)
        target = raw if layer == n_layers - 1 else (even if layer % 2 == 0 else odd)
        for j in range(n_out):
            total = load(weights, (n_in * n_out + j) * LANES)
            for i in range(n_in):
                total = total + load(weights, (i * n_out + j) * LANES) * load(source, i * LANES)
            store(target, j * LANES, total)
        if layer < n_layers - 1:
            for i in range(n_out * LANES):
                target[i] = math.tanh(target[i])
        weights = view(weights, (n_in + 1) * n_out * LANES)


@register_controller("policy")
class Policy(Perceptron):
    """The mean of a policy: a multi-layer perceptron with a linear last layer, limited to [-1, 1].

    ::

        h_1 = f(W_1 o + b_1),    ...,    y = g(W_n h_(n-1) + b_n)

    ``hidden`` lists the units of the inner layers, ``inner`` is f, "tanh" or "relu", ``output`` is g, "clip" (PPO) or
    "tanh" (SAC). The parameters are, layer by layer, the weights (n_in, n_out) row by row and then the biases (n_out,).
    """

    def __init__(self, *, hidden: Sequence[int] = (64, 64), inner: str = "tanh", output: str = "clip") -> None:
        if not hidden or not all(isinstance(size, int) and size >= 1 for size in hidden):
            raise InvalidArgument(f"policy: expected a list of hidden >= 1, got {hidden!r}")
        if inner not in INNER or output not in OUTPUT:
            raise InvalidArgument(
                f"policy: expected inner to be {' or '.join(INNER)} and output {' or '.join(OUTPUT)}, "
                f"got {inner!r} and {output!r}"
            )
        self.hidden, self.inner, self.output = tuple(hidden), inner, output
