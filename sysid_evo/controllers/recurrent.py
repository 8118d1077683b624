"""The recurrent network of the paper: five inputs, six hidden units, two outputs (section 5.2)."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Self

import numpy as np

from sysid_evo.arrays import Array, check_shape
from sysid_evo.controllers.controller import Controller, View
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import register_controller

if TYPE_CHECKING:
    from sysid_evo.export.program import Program
    from sysid_evo.kernels import ControllerKernel


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
        from sysid_evo.engine.kernels.recurrent import recurrent_kernel

        return recurrent_kernel(self.n_inputs, self.hidden, self.n_outputs)

    def program(self, parameters: Array) -> Program:
        from sysid_evo.export.program import Program, Statement, dot, observation, remembered, tanh

        w_in, w_hidden, w_out = (weights[0].T for weights in self.weights(parameters[None]))
        seen, before = observation(self.n_inputs), remembered("hidden", self.hidden)
        units = Statement("units", tanh(dot("W_IN", w_in, seen) + dot("W_HIDDEN", w_hidden, before)), "hidden units")
        raw = Statement("raw", tanh(dot("W_OUT", w_out, units.value)), "outputs in [-1, 1]")
        return Program((units, raw), raw.value, {"hidden": units.value})
