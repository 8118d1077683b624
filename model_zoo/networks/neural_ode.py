"""Family neural_ode, and the training of differential equations that contain a network."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Literal, Protocol, Self

import numpy as np

from model_zoo.features import Features
from model_zoo.networks.backpropagation import DifferentiableSimulation
from model_zoo.networks.network import Array32, Network, declared_layers
from model_zoo.networks.training import ResumableTrainings, TrainingSchedule
from model_zoo.scaling import Mirror
from sysid_evo import register_model
from sysid_evo.carry import CarryLayout
from sysid_evo.data import Dataset
from sysid_evo.models.dynamics import rk4
from sysid_evo.models.kernels import (
    Predictor,
    added,
    network_predictor,
    runge_kutta_predictor,
    turning_frame,
    with_angles,
)
from sysid_evo.models.learned import Declared
from sysid_evo.models.parameters import Limit, above, at_least
from sysid_evo.models.stochastic import StochasticModel
from sysid_evo.progress import Counter, Progress
from sysid_evo.system import System
from sysid_evo.types import Array
from sysid_evo.validation.folds import time_fold
from sysid_evo.validation.held_out import best_candidate, count_fits, lag_candidates

SEARCH_SHARE = 0.15

HIDDEN = (32, 32)

QUICK = {"hidden": [24], "one_step_updates": 500, "updates": 150, "horizon": 10}

LAGS: dict[str | None, tuple[tuple[int, int], ...]] = {None: ((0, 0),), "all": ((0, 2), (0, 3), (1, 3))}
"""Lags of states and controls that are tried, by `NeuralOde.lag_search`."""


@register_model("neural_ode")
class NeuralOde(StochasticModel):
    """Neural ODE: a network for dx/dt, trained through simulations and integrated by Runge-Kutta.

    dx/dt = network(x, u, earlier states and controls) + w(x), with w the rotation of a planar body's frame (Chen et al.
    2018). Periodic states enter as sine and cosine. ``state_lags`` and ``control_lags`` add earlier samples (none by
    default), held over a step; ``lag_search="all"`` chooses their numbers by the simulation error on held-out blocks of
    time.

    Training: ``one_step_updates`` on single steps, then ``updates`` on simulations of ``horizon`` steps from measured
    states (multiple shooting), to which ``input_noise`` is added (in units of the one-step change). The weights that
    simulate held-out blocks best over one second are kept (early stopping). ``hidden`` lists the widths of the tanh
    layers, ``learning_rate`` is that of Adam. The integrator is the classical fourth-order method with held controls.
    A derived family may add a `known_rate`, whose ``initial`` physical parameters are trained with the network.
    """

    knowledge = "dark grey"
    model_class = "network"
    periodic = True
    resumable = True
    limits: ClassVar[dict[str, Limit]] = {
        **{name: at_least(1) for name in ("hidden", "one_step_updates", "updates", "horizon")},
        "learning_rate": above(0),
        "input_noise": at_least(0),
    }
    initial: ClassVar[Array] = np.empty(0)
    _calibration_folds: ClassVar[int] = 2
    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": QUICK,
        "paper": {"one_step_updates": 3000, "updates": 1500},
    }

    hidden: list[int] | None = None
    state_lags: int | None = None
    control_lags: int | None = None
    lag_search: Literal["all"] | None = None
    one_step_updates: int = 1000
    updates: int = 500
    horizon: int = 20
    learning_rate: float = 6e-3
    input_noise: float = 0.05
    max_steps: int | None = 100_000

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        plan = TrainingSchedule(
            self.one_step_updates,
            self.updates,
            self.horizon,
            learning_rate=self.learning_rate,
            input_noise=self.input_noise,
        )
        final = replace(plan, check_every=50)
        one_step_updates, updates = (max(1, round(SEARCH_SHARE * n)) for n in (plan.one_step_updates, plan.updates))
        search = replace(plan, one_step_updates=one_step_updates, updates=updates)
        options = lag_candidates(self.state_lags, self.control_lags, LAGS[self.lag_search])
        counter = Counter(progress, final.total + count_fits(options) * search.total)

        def trained(lags: tuple[int, int], plan: TrainingSchedule) -> tuple[Network, Array, float]:
            """Return network and physical parameters that simulate held-out blocks best, and their error there."""
            flow = self._flow(dataset, lags, self.hidden or HIDDEN, self.initial, trainings.rng)
            found, errors = flow.learn([time_fold(dataset, 0, FOLDS)], plan, trainings)
            return flow.network(found), flow.physical_of(found), float(errors[0])

        with ResumableTrainings.of(self, dataset, rng, counter.advance) as trainings:
            lags = best_candidate(options, lambda lags: trained(lags, search)[2])
            network, physical, _ = trained(lags, final)
        self.record_lags(lags)
        self.weights_, self.biases_ = list(network.weights), list(network.biases)
        if len(self.initial):
            self.physical_ = physical
        self.calibrate(dataset, rng, lambda: counter.advance(0))
        return self

    def fine_tuned(self, dataset: Dataset, updates: int, *, rng: np.random.Generator) -> Self:
        plan = TrainingSchedule.further(updates, self.horizon, self.input_noise)
        hidden = [weight.shape[2] for weight in self.weights_[:-1]]
        physical = self.physical_ if len(self.initial) else self.initial
        mirror = Mirror.of(dataset.system)  # a few seconds rarely contain left and right turns equally
        flow = self._flow(dataset, self.lags, hidden, physical, rng, mirror)
        flow.start_from(self.network)
        found = flow.fine_tune(dataset, plan, ResumableTrainings(rng))
        network, physical = flow.network(found), flow.physical_of(found)
        other = self.variant()
        other.weights_, other.biases_ = list(network.weights), list(network.biases)
        if len(self.initial):
            other.physical_ = physical
        return other

    def _flow(
        self,
        dataset: Dataset,
        lags: tuple[int, int],
        hidden: Sequence[int],
        physical: Array,
        rng: np.random.Generator,
        mirror: Mirror | None = None,
    ) -> OdeSimulation:
        """Return the simulation to be trained, with the ``physical`` parameters if there are any."""
        flow = OdeSimulation(dataset, lags, hidden=hidden, rng=rng, further=0 if mirror is None else 1, mirror=mirror)
        if (physics := self.physics()) is not None:
            flow.know(physics, physical)
        return flow

    def known_rate(self, state: Array, control: Array) -> Array | None:
        """Return the part of dx/dt (B, nx) outside the network, or None."""
        return None

    def physics(self) -> KnownRate | None:
        """Return `known_rate` in the form used in training, for a family with ``initial`` physical parameters."""
        return None

    @property
    def network(self) -> Network:
        """Features of (carry, control) to the learned part of dx/dt."""
        return Network(self.weights_, self.biases_)

    def learned_arrays(self) -> Mapping[str, Declared]:
        seen = Features(self.system, self.lags).n_carry + self.system.nu
        found = declared_layers(self.weights_, seen, self.system.nx, members=1)
        return {**found, "physical_": (len(self.initial),)} if len(self.initial) else found

    def _known_predictor(self) -> Predictor | None:
        """Return `known_rate` as a predictor of the fast engine, if there is one."""
        return None

    def predictor(self) -> Predictor | None:
        return flow_predictor(self.network, self.system, self.lags, self._known_predictor())

    def next_state(self, carry: Array, control: Array) -> Array:
        return flow_step(self.network, self.system, self.lags, carry, control, self.known_rate)


def flow_step(
    network: Network,
    system: System,
    lags: tuple[int, int],
    carry: Array,
    control: Array,
    known_rate: Callable[[Array, Array], Array | None] | None = None,
) -> Array:
    """Return the state (B, nx) after dt of dx/dt = network + ``known_rate`` + rotation of the frame.

    The network sees `Features` of (carry, control); earlier samples and controls are held.
    """
    features, held = Features(system, lags), carry[:, system.nx :]

    def rate(state: Array) -> Array:
        seen = features(np.concatenate([state, held], axis=1), control)
        learned = network(seen)[0] + system.frame_rotation(state)
        known = None if known_rate is None else known_rate(state, control)
        return learned if known is None else learned + known

    return rk4(rate, carry[:, : system.nx], system.dt)


def flow_predictor(
    network: Network, system: System, lags: tuple[int, int], known: Predictor | None = None
) -> Predictor | None:
    """Return the compiled form of `flow_step`, with a ``known`` rate if there is one; None if the motion has none."""
    seen = Features(system, lags).n_carry
    learned = with_angles(network_predictor(network.members()[:1], seen, system.nu), system, lags)
    rate = turning_frame(learned if known is None else added(learned, known, system.nx), system)
    n_carry = CarryLayout(system.nx, system.nu, *lags).size
    return None if rate is None else runge_kutta_predictor(rate, system, n_carry=n_carry)


FOLDS = 5
"""Every fifth block of time is held out for early stopping."""

NODES = 0.0, 0.5, 0.5, 1.0
"""Times at which the rates of a step are evaluated, as shares of dt."""

SHARES = 1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0
"""Weights of these rates in the step."""


class OdeSimulation(DifferentiableSimulation):
    """dx/dt = network(x, lagged samples, control) + physics + rotation of the frame, controls held.

    Trained are the network and the logarithms of the ``physical`` parameters (n,), which are all positive.
    """

    calls: ClassVar[int] = len(NODES)
    physics: KnownRate | None = None

    def know(self, physics: KnownRate, physical: Array) -> None:
        """Add ``physics`` with the initial parameters ``physical``."""
        self.physics = physics
        logarithms = np.log(physical).astype(np.float32)
        self.parameters = np.concatenate([self.parameters, logarithms[None]], axis=1)

    @property
    def physical(self) -> Array32:
        """The physical parameters (n,) as they are now."""
        return np.asarray(np.exp(self.parameters[0, self.layers.size :]))

    def physical_of(self, parameters: Array32) -> Array:
        """Return the physical part (n,) of trained ``parameters`` (1, P)."""
        return np.asarray(np.exp(parameters[0, self.layers.size :].astype(np.float64)))

    def prepare(self, horizon: int) -> None:
        shape = horizon, self.calls, *self.states.shape[1:]
        self.visited: Array32 = np.empty(shape, dtype=np.float32)
        self.by_rate: Array32 = np.empty(shape, dtype=np.float32)
        if self.physics is not None:
            self.physics.hold(self.controls, self.physical)

    def advance(self, step: int, state: Array32) -> Array32:
        dt, after, rate = self.system.dt, state, state
        for call, (node, share) in enumerate(zip(NODES, SHARES, strict=True)):
            here = state + (node * dt) * rate if node else state
            self.visited[step, call] = here
            rate = self.network_output(step, call, here)
            if self.system.motion is not None:
                rate += self.system.frame_rotation(here)
            if self.physics is not None:
                rate += self.physics.rate(step, here)
            after = after + (share * dt) * rate
        return after

    def pull_back(self, step: int, gradient: Array32) -> Array32:
        dt, by_state, from_next = self.system.dt, gradient, None
        for call in range(self.calls - 1, -1, -1):
            by_rate = (SHARES[call] * dt) * gradient
            if from_next is not None:
                by_rate += (NODES[call + 1] * dt) * from_next
            self.by_rate[step, call] = by_rate
            here = self.visited[step, call]
            from_next = self.backpropagated(step, call, here, by_rate)
            if self.system.motion is not None:
                from_next = from_next + self.motion.of_frame_rotation(here, by_rate)
            if self.physics is not None:
                from_next = from_next + self.physics.by_state(step, here, by_rate)
            by_state = by_state + from_next
        return by_state

    def gradient(self, by_states: Array32) -> Array32:
        by_network = super().gradient(by_states)
        if self.physics is None:
            return by_network
        by_logarithms = self.physics.by_parameters(self.visited, self.by_rate) * self.physical
        return np.concatenate([by_network, by_logarithms[None]], axis=1)


class KnownRate(Protocol):
    """A known part of dx/dt with positive parameters (n,), for controls given in advance."""

    def hold(self, controls: Array32, parameters: Array32) -> None:
        """Set the ``controls`` (H, ..., nu) of the following steps."""

    def rate(self, step: int, state: Array32) -> Array32:
        """Return the known part (..., nx) in one of the steps."""

    def by_state(self, step: int, state: Array32, gradient: Array32) -> Array32:
        """Return the gradient by the state, from that by the rate (..., nx)."""

    def by_parameters(self, states: Array32, gradients: Array32) -> Array32:
        """Return the gradient (n,), from those by the rates of all steps (H, calls, ..., nx)."""
