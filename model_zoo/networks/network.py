"""Tanh networks as arrays, and their gradient."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from sysid_evo.models.learned import Declared, Length
from sysid_evo.types import Array


@dataclass(frozen=True)
class Network:
    """M networks of one shape: tanh in every layer but the last, which is linear.

    Layer l has ``weights[l]`` (M, n_in, n_out) and ``biases[l]`` (M, n_out): h' = tanh(h W + b).
    """

    weights: Sequence[Array]
    biases: Sequence[Array]

    def __call__(self, inputs: Array) -> Array:
        """Return the outputs (M, B, n_out) of all members for the same ``inputs`` (B, n_in)."""
        values = inputs[None]
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            values = values @ weight + bias[:, None]
            if layer < len(self.weights) - 1:
                values = np.tanh(values)
        return values

    def members(self) -> list[list[tuple[Array, Array]]]:
        """Return every network as its layers: weights (n_in, n_out) and bias (n_out,)."""
        return [
            [(weight[m], bias[m]) for weight, bias in zip(self.weights, self.biases, strict=True)]
            for m in range(len(self.weights[0]))
        ]

    def folded(self, centre: Array, scale: Array, output_scale: Array) -> Network:
        """Return the equivalent networks of raw inputs and outputs.

        This one takes (input - ``centre``) / ``scale`` and gives outputs in units of ``output_scale``; each is (n,) or
        (M, n).
        """
        weights, biases = list(self.weights), list(self.biases)
        centre, scale, output_scale = (np.atleast_2d(value) for value in (centre, scale, output_scale))
        weights[0] = weights[0] / scale[:, :, None]
        biases[0] = biases[0] - np.einsum("mi,mio->mo", np.broadcast_to(centre, weights[0].shape[:2]), weights[0])
        weights[-1] = weights[-1] * output_scale[:, None]
        biases[-1] = biases[-1] * output_scale
        return Network(weights, biases)

    def unfolded(self, centre: Array, scale: Array, output_scale: Array) -> Network:
        """Undo `folded` with the same numbers, (n,) each."""
        weights, biases = list(self.weights), list(self.biases)
        biases[0] = biases[0] + centre @ weights[0]
        weights[0] = weights[0] * scale[:, None]
        weights[-1], biases[-1] = weights[-1] / output_scale, biases[-1] / output_scale
        return Network(weights, biases)


def declared_layers(weights: Sequence[Any], n_in: int, n_out: int, members: Length = "members") -> dict[str, Declared]:
    """Declare ``weights_`` and ``biases_`` of M networks, as `Network` has them, with as many layers as ``weights``."""
    sizes: list[Length] = [n_in, *(f"hidden {layer}" for layer in range(1, len(weights))), n_out]
    return {
        "weights_": [(members, before, after) for before, after in pairwise(sizes)],
        "biases_": [(members, after) for after in sizes[1:]],
    }


def random_network(sizes: Sequence[int], members: int, rng: np.random.Generator, *, last: float = 0.1) -> Network:
    """Return networks with normal weights of deviation 1 / sqrt(n_in), times ``last`` in the last layer."""
    weights, biases = [], []
    for layer, (n_in, n_out) in enumerate(pairwise(sizes)):
        gain = last if layer == len(sizes) - 2 else 1.0
        weights.append(gain / np.sqrt(n_in) * rng.standard_normal((members, n_in, n_out)))
        biases.append(np.zeros((members, n_out)))
    return Network(weights, biases)


Array32: TypeAlias = npt.NDArray[Any]
"""Single-precision array; training uses no other."""


class Layers:
    """M networks as in `Network`, evaluated call by call, then differentiated backwards.

    The parameters are rows (M, P): weights (n_in, n_out) and bias (n_out,) of each layer, first to last, of a network
    of (input - ``centre``) / ``scale`` that gives outputs in units of ``output_scale``. `take` folds the scales into
    the weights, so that inputs and outputs are raw. `reserve` sets the number of calls and returns the array for their
    inputs.
    """

    def __init__(self, sizes: Sequence[int], members: int, *, centre: Array, scale: Array, output_scale: Array) -> None:
        self.sizes, self.members = tuple(sizes), members
        self.output_scale: Array32 = output_scale.astype(np.float32)
        self.per_scale: Array32 = (1.0 / scale[:, None]).astype(np.float32)
        self.offset: Array32 = (centre / scale).astype(np.float32)
        self.size = sum((n_in + 1) * n_out for n_in, n_out in pairwise(sizes))
        self._traces: dict[tuple[int, int], tuple[list[Array32], list[Array32], list[Array32]]] = {}

    def flat(self, network: Network) -> Array32:
        """Return the parameters (M, P) of a network of this shape."""
        parts = [
            part.reshape(self.members, -1)
            for weight, bias in zip(network.weights, network.biases, strict=True)
            for part in (weight, bias)
        ]
        return np.concatenate(parts, axis=1).astype(np.float32)

    def network(self, parameters: Array32) -> Network:
        """Undo `flat`."""
        weights, biases = self._cut(parameters.astype(np.float64))
        return Network(weights, biases)

    def take(self, parameters: Array32) -> None:
        """Use these ``parameters`` (M, P) from now on."""
        weights, biases = self._cut(parameters)
        biases[0] = biases[0] - self.offset @ weights[0]
        weights[0] = weights[0] * self.per_scale
        weights[-1], biases[-1] = weights[-1] * self.output_scale, biases[-1] * self.output_scale
        self.weights, self.biases = weights, [bias[:, None] for bias in biases]

    def reserve(self, calls: int, batch: int) -> Array32:
        """Allocate memory for ``calls`` calls with ``batch`` rows; return the inputs (C, M, B, n_in), to be filled."""
        if (calls, batch) not in self._traces:
            inner, outer = (
                [np.empty((calls, self.members, batch, size), dtype=np.float32) for size in sizes]
                for sizes in (self.sizes[:-1], self.sizes[1:])
            )
            spare = [np.empty((self.members, batch, size), dtype=np.float32) for size in self.sizes]
            self._traces[calls, batch] = inner, outer, spare
        # inputs and hidden values of all calls, the gradients of every layer, and room for one call
        self.values, self.slopes, self.spare = self._traces[calls, batch]
        return self.values[0]

    def forward(self, call: int) -> Array32:
        """Return the outputs (M, B, n_out) for the inputs of ``call``."""
        values, last = self.values, len(self.weights) - 1
        for layer in range(last):
            after = values[layer + 1][call]
            np.matmul(values[layer][call], self.weights[layer], out=after)
            after += self.biases[layer]
            np.tanh(after, out=after)
        found: Array32 = np.matmul(values[last][call], self.weights[last])
        found += self.biases[last]
        return found

    def backward(self, call: int, gradient: Array32, inputs: int) -> Array32:
        """Return the gradient (M, B, ``inputs``) by the first inputs, from that by the outputs (M, B, n_out)."""
        values, slopes, last = self.values, self.slopes, len(self.weights) - 1
        slopes[last][call] = gradient
        for layer in range(last, 0, -1):
            before, spare = slopes[layer - 1][call], self.spare[layer]
            np.matmul(slopes[layer][call], np.swapaxes(self.weights[layer], 1, 2), out=before)
            np.multiply(values[layer][call], values[layer][call], out=spare)
            np.subtract(1.0, spare, out=spare)
            before *= spare
        return np.matmul(slopes[0][call], np.swapaxes(self.weights[0][:, :inputs], 1, 2))

    def gradient(self) -> Array32:
        """Return the gradient (M, P) by the parameters, over all calls."""
        parts, ones = [], np.ones((1, self.spare[0].shape[1]), dtype=np.float32)
        last = len(self.weights) - 1
        for layer, (value, slope) in enumerate(zip(self.values, self.slopes, strict=True)):
            by_weight = np.matmul(np.swapaxes(value, 2, 3), slope).sum(axis=0)
            by_bias = np.matmul(ones, slope).sum(axis=0)
            if layer == last:
                by_weight, by_bias = by_weight * self.output_scale, by_bias * self.output_scale
            if layer == 0:
                by_weight = by_weight * self.per_scale - self.offset[:, None] * by_bias
            parts += [by_weight.reshape(self.members, -1), by_bias[:, 0]]
        return np.concatenate(parts, axis=1)

    def _cut(self, parameters: Array32) -> tuple[list[Array32], list[Array32]]:
        weights, biases, at = [], [], 0
        for n_in, n_out in pairwise(self.sizes):
            weights.append(parameters[:, at : at + n_in * n_out].reshape(len(parameters), n_in, n_out))
            at += n_in * n_out
            biases.append(parameters[:, at : at + n_out])
            at += n_out
        return weights, biases
