"""Multilayer perceptrons with tanh layers as plain arrays: several members side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sysid_evo.arrays import Array


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

    @property
    def n_parameters(self) -> int:
        """Number of weights and biases of all members."""
        return sum(array.size for array in (*self.weights, *self.biases))

    def folded(self, centre: Array, scale: Array, output_scale: Array) -> Network:
        """Return networks of raw inputs and outputs.

        This one sees (input - ``centre``) / ``scale`` and gives outputs in units of
        ``output_scale``; each is (n,) or (M, n).
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


def random_network(sizes: Sequence[int], members: int, rng: np.random.Generator, *, last: float = 0.1) -> Network:
    """Return networks with normal weights of deviation 1 / sqrt(n_in), times ``last`` in the last layer."""
    weights, biases = [], []
    for layer, (n_in, n_out) in enumerate(pairwise(sizes)):
        gain = last if layer == len(sizes) - 2 else 1.0
        weights.append(gain / np.sqrt(n_in) * rng.standard_normal((members, n_in, n_out)))
        biases.append(np.zeros((members, n_out)))
    return Network(weights, biases)
