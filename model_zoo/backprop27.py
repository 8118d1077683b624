"""Family backprop27 (paper, section 4.1): one network for each command and state."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar, Literal, Self

import numpy as np

from model_zoo.control_grid import ControlGrid
from model_zoo.features import Features, integrals, next_state, next_state_predictor
from model_zoo.networks.network import random_network
from model_zoo.scaling import deviation
from sysid_evo import Dataset, DynamicsModel, System, register_model
from sysid_evo.models.kernels import Predictor, command_network_predictor, with_angles
from sysid_evo.models.kernels.neighbours import EXACT_INTEGERS
from sysid_evo.models.learned import Declared, Numbers
from sysid_evo.models.parameters import Limit, above, at_least
from sysid_evo.progress import Counter, Progress
from sysid_evo.types import Array, IntArray

REPORT_EVERY = 50
"""Epochs between two reports of progress."""


@register_model("backprop27")
class Backprop27(DynamicsModel):
    """One small network per command and state for the next state (9 x 3 = 27 for the car of the paper).

    Each network has one layer of ``hidden`` tanh units and the state as input. It is trained on all data of its command
    in one batch, for ``epochs`` epochs with ``learning_rate``, by Adam or by the paper's plain gradient descent
    (``optimiser="gradient"``). Inputs and outputs are standardised over all data. A continuous control is rounded to
    the nearest of ``levels`` steps of its range and is also an input; a command that was never recorded uses the
    networks of the nearest recorded one. ``hidden`` and ``learning_rate`` are not stated in the paper.

    ``state_lags`` and ``control_lags`` add earlier samples to the inputs. Periodic states enter as sine and cosine; for
    them and for integrals of other states (see `integrals`) the networks predict the change.
    """

    knowledge = "black"
    model_class = "network"
    typical_fit_seconds = 2.0
    periodic = True
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"epochs": 300}}
    limits: ClassVar[dict[str, Limit]] = {
        "hidden": at_least(1),
        "epochs": at_least(1),
        "learning_rate": above(0),
        "levels": at_least(2),
    }

    hidden: int = 8
    epochs: int = 1000
    optimiser: Literal["adam", "gradient"] = "adam"
    learning_rate: float = 0.02
    levels: int = 3
    state_lags: int = 0
    control_lags: int = 0
    max_steps: int | None = 100_000

    def check_system(self, system: System) -> None:
        ControlGrid.of(system, self.levels)

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        cells = ControlGrid.of(dataset.system, self.levels)
        data = dataset.transitions(state_lags=self.lags[0], control_lags=self.lags[1])
        cell = cells.index(data.control)
        self.filled_ = np.unique(cell)
        inputs = Features(dataset.system, self.lags)(data.carry, data.control[:, cells.exact])
        centre, scale = inputs.mean(axis=0), deviation(inputs)
        self.added_ = integrals(dataset).astype(np.float64)
        wanted = data.after - np.where(self.added_ > 0.0, data.state, 0.0)
        target_centre, target_scale = wanted.mean(axis=0), deviation(wanted)
        standard, targets = (inputs - centre) / scale, (wanted - target_centre) / target_scale
        trained = []
        counter = Counter(progress, len(self.filled_) * self.epochs)
        for command in self.filled_:
            rows = np.flatnonzero(cell == command)
            trained.append(self._trained(standard[rows], targets[rows], rng, counter))
        first, first_bias, last, last_bias = (np.stack(part) for part in zip(*trained, strict=True))
        self.first_ = first / scale[:, None]
        self.first_bias_ = first_bias - np.einsum("i,cih->ch", centre / scale, first)
        self.last_ = last * target_scale[:, None]
        self.last_bias_ = last_bias * target_scale + target_centre
        return self

    def learned_arrays(self) -> Mapping[str, Declared]:
        cells, nx = ControlGrid.of(self.system, self.levels), self.system.nx
        seen = Features(self.system, self.lags).n_carry + len(cells.exact)
        return {
            "filled_": Numbers("commands", whole=True, least=0, most=cells.count - 1, rising=True),
            "first_": ("commands", seen, nx * self.hidden),
            "first_bias_": ("commands", nx * self.hidden),
            "last_": ("commands", nx, self.hidden),
            "last_bias_": ("commands", nx),
            "added_": (nx,),
        }

    def next_state(self, carry: Array, control: Array) -> Array:
        cells, serving = self._serving
        number = serving[cells.index(control)]
        inputs = Features(self.system, self.lags)(carry, control[:, cells.exact])
        after = np.empty((len(carry), self.last_.shape[1]))
        for command in np.unique(number):
            rows = np.flatnonzero(number == command)
            hidden = np.tanh(inputs[rows] @ self.first_[command] + self.first_bias_[command])
            by_state = hidden.reshape(len(rows), *self.last_.shape[1:])
            after[rows] = np.einsum("bsh,sh->bs", by_state, self.last_[command]) + self.last_bias_[command]
        return next_state(self.added_, carry[:, : self.system.nx], after)

    def predictor(self) -> Predictor | None:
        """None if there are too many commands for a compiled form; the model then runs in NumPy."""
        cells, serving = self._serving
        commands, n_in, units = self.first_.shape
        if len(serving) * units * (n_in + 2) >= EXACT_INTEGERS:
            return None
        shape = self.last_.shape[1:]
        networks = command_network_predictor(
            self.first_.reshape(commands, n_in, *shape).transpose(0, 2, 1, 3),
            self.first_bias_.reshape(commands, *shape),
            self.last_,
            self.last_bias_,
            serving,
            cells.midpoints,
            cells.exact,
            Features(self.system, self.lags).n_carry,
        )
        return next_state_predictor(self.added_, with_angles(networks, self.system, self.lags))

    @cached_property
    def _serving(self) -> tuple[ControlGrid, IntArray]:
        """The cells, and for each the number of the networks used there."""
        cells = ControlGrid.of(self.system, self.levels)
        return cells, np.searchsorted(self.filled_, cells.fallback(self.filled_))

    def _trained(
        self, inputs: Array, targets: Array, rng: np.random.Generator, counter: Counter
    ) -> tuple[Array, Array, Array, Array]:
        """Train the nx networks of one command together, (N, n) -> (N, nx)."""
        n, nx = len(inputs), targets.shape[1]
        start = random_network([inputs.shape[1], nx * self.hidden], 1, rng, last=1.0)
        values = [
            start.weights[0][0],
            np.zeros(nx * self.hidden),
            rng.standard_normal((nx, self.hidden)) / np.sqrt(self.hidden),
            np.zeros(nx),
        ]
        mean, square = [np.zeros_like(v) for v in values], [np.zeros_like(v) for v in values]
        for epoch in range(1, self.epochs + 1):
            if epoch % REPORT_EVERY == 0 or epoch == self.epochs:
                counter.advance(REPORT_EVERY if epoch % REPORT_EVERY == 0 else epoch % REPORT_EVERY)
            first, first_bias, last, last_bias = values
            hidden = np.tanh(inputs @ first + first_bias).reshape(n, nx, self.hidden)
            error = 2.0 / n * (np.einsum("nsh,sh->ns", hidden, last) + last_bias - targets)
            inner = ((1.0 - hidden**2) * last * error[:, :, None]).reshape(n, nx * self.hidden)
            gradients = [inputs.T @ inner, inner.sum(axis=0), np.einsum("ns,nsh->sh", error, hidden), error.sum(axis=0)]
            if self.optimiser == "gradient":
                values = [v - self.learning_rate * g for v, g in zip(values, gradients, strict=True)]
                continue
            mean = [0.9 * m + 0.1 * g for m, g in zip(mean, gradients, strict=True)]
            square = [0.999 * s + 0.001 * g**2 for s, g in zip(square, gradients, strict=True)]
            rate = self.learning_rate * np.sqrt(1.0 - 0.999**epoch) / (1.0 - 0.9**epoch)
            values = [v - rate * m / (np.sqrt(s) + 1e-8) for v, m, s in zip(values, mean, square, strict=True)]
        return values[0], values[1], values[2], values[3]
