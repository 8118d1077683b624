"""Training of differential equations whose right-hand side holds a network: Runge-Kutta of order 4 at the data's dt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from model_zoo.channels.mirror import Mirror
from model_zoo.networks.layers import Single
from model_zoo.networks.multistep import Plan
from model_zoo.networks.network import Network
from model_zoo.networks.standardised import StandardisedModel
from model_zoo.networks.trainings import Trainings
from sysid_evo.arrays import Array
from sysid_evo.cross_validation import time_blocks
from sysid_evo.data import Dataset

FOLDS = 5
NODES = 0.0, 0.5, 0.5, 1.0
"""Share of dt at which each rate of a step is asked for."""
SHARES = 1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0
"""Share of each of them in the step."""


class Physics(Protocol):
    """A known part of dx/dt with positive parameters (n,), under controls that were given before."""

    def hold(self, controls: Single, parameters: Single) -> None:
        """Expect these ``controls`` (H, ..., nu) in the steps to come."""

    def rate(self, step: int, state: Single) -> Single:
        """Return the known part (..., nx) in one of the steps."""

    def by_state(self, step: int, state: Single, gradient: Single) -> Single:
        """Return the gradient by the state, from that by the rate (..., nx)."""

    def by_parameters(self, states: Single, gradients: Single) -> Single:
        """Return the gradient (n,), from those by the rates of all steps (H, calls, ..., nx)."""


class Flow(StandardisedModel):
    """dx/dt = network(x, lagged samples, control) + physics + rotation of the frame, controls held.

    Of the ``physical`` parameters (n,), all positive, the logarithms are trained, beside the network's.
    """

    calls: ClassVar[int] = len(NODES)
    physics: Physics | None = None

    def know(self, physics: Physics, physical: Array) -> None:
        """Add ``physics``, with parameters that begin at ``physical``."""
        self.physics = physics
        logarithms = np.log(physical).astype(np.float32)
        self.parameters = np.concatenate([self.parameters, logarithms[None]], axis=1)

    @property
    def physical(self) -> Single:
        """The physical parameters (n,) as they are now."""
        return np.asarray(np.exp(self.parameters[0, self.layers.size :]))

    def prepare(self, horizon: int) -> None:
        shape = horizon, self.calls, *self.states.shape[1:]
        self.visited: Single = np.empty(shape, dtype=np.float32)
        self.by_rate: Single = np.empty(shape, dtype=np.float32)
        if self.physics is not None:
            self.physics.hold(self.controls, self.physical)

    def advance(self, step: int, state: Single) -> Single:
        dt, after, rate = self.system.dt, state, state
        for call, (node, share) in enumerate(zip(NODES, SHARES, strict=True)):
            here = state + (node * dt) * rate if node else state
            self.visited[step, call] = here
            rate = self.called(step, call, here)
            if self.system.motion is not None:
                rate += self.system.turning(here)
            if self.physics is not None:
                rate += self.physics.rate(step, here)
            after = after + (share * dt) * rate
        return after

    def pull_back(self, step: int, gradient: Single) -> Single:
        dt, by_state, from_next = self.system.dt, gradient, None
        for call in range(self.calls - 1, -1, -1):
            by_rate = (SHARES[call] * dt) * gradient
            if from_next is not None:
                by_rate += (NODES[call + 1] * dt) * from_next
            self.by_rate[step, call] = by_rate
            here = self.visited[step, call]
            from_next = self.pulled_through(step, call, here, by_rate)
            if self.system.motion is not None:
                from_next = from_next + self.motion.turned(here, by_rate)
            if self.physics is not None:
                from_next = from_next + self.physics.by_state(step, here, by_rate)
            by_state = by_state + from_next
        return by_state

    def gradient(self, by_states: Single) -> Single:
        by_network = super().gradient(by_states)
        if self.physics is None:
            return by_network
        by_logarithms = self.physics.by_parameters(self.visited, self.by_rate) * self.physical
        return np.concatenate([by_network, by_logarithms[None]], axis=1)


@dataclass(frozen=True)
class FittedFlow:
    """The network of features of (carry, control) to rates, the physical parameters, and the validation error."""

    network: Network
    physical: Array
    error: float


def train_flow(
    dataset: Dataset,
    lags: tuple[int, int],
    *,
    hidden: Sequence[int],
    plan: Plan,
    trainings: Trainings,
    physics: Physics | None,
    physical: Array,
) -> FittedFlow:
    """Train one flow on all but the held-out blocks of time, and keep what simulates those best."""
    model = Flow(dataset, lags, hidden=hidden, rng=trainings.rng)
    if physics is not None:
        model.know(physics, physical)
    best, errors = model.learn([time_blocks(dataset, 0, FOLDS)], plan, trainings)
    return FittedFlow(model.network(best), _physical(model, best), float(errors[0]))


def train_flow_further(
    network: Network,
    dataset: Dataset,
    lags: tuple[int, int],
    plan: Plan,
    rng: np.random.Generator,
    *,
    physics: Physics | None,
    physical: Array,
) -> tuple[Network, Array]:
    """Train a ``network`` and ``physical`` parameters, which `train_flow` found, on all of ``dataset``.

    Of a body that is steered the data are seen in the mirror as well: few seconds seldom turn both ways alike.
    """
    hidden, mirror = [weight.shape[2] for weight in network.weights[:-1]], Mirror.of(dataset.system)
    model = Flow(dataset, lags, hidden=hidden, rng=rng, further=0 if mirror is None else 1, mirror=mirror)
    if physics is not None:
        model.know(physics, physical)
    model.begin_with(network)
    found = model.learn_further(dataset, plan, Trainings(rng))
    return model.network(found), _physical(model, found)


def _physical(model: Flow, parameters: Single) -> Array:
    """Return the physical part (n,) of ``parameters`` (1, P)."""
    return np.asarray(np.exp(parameters[0, model.layers.size :].astype(np.float64)))
