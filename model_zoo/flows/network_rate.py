"""What the neural differential equations share: lags chosen by simulation, stepped in NumPy by Runge-Kutta."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from model_zoo.flows.stepping import flow_predictor, flow_step
from model_zoo.networks.network import Network
from model_zoo.validation.held_out import best, lag_candidates, trials
from model_zoo.validation.uncertain import Uncertain
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.hyperparameters import Limit, above, at_least
from sysid_evo.progress import Counter, Progress
from sysid_evo.searched import OneOf, Searched, Within

if TYPE_CHECKING:
    from model_zoo.flows.training import Physics
    from sysid_evo.engine.kernels import Predictor

SEARCH_SHARE = 0.15
HIDDEN = (32, 32)
QUICK = {"hidden": [24], "one_step_updates": 500, "updates": 150, "horizon": 10}


class NetworkRate(Uncertain):
    """A family with dx/dt = network(carry, control) + `known_rate` + rotation of the frame.

    Of a periodic state the network sees sine and cosine.

    ``updates`` on free runs of ``horizon`` steps follow ``one_step_updates`` on single steps, from
    measured states (multiple shooting) with ``input_noise`` (in units of the one-step change); the weights that
    simulate held-out blocks of time best over one second are kept (early stopping). ``initial`` physical parameters of
    the known part are trained with them. Stepped with the fourth-order Runge-Kutta method at dt, controls held.
    """

    knowledge = "dark grey"
    structure = "network"
    periodic = True
    resumable = True
    searched: ClassVar[dict[str, Searched]] = {
        "input_noise": Within(0.02, 4.0, log=True),
        "hidden": OneOf((None, [24], [64, 64])),
        "horizon": Within(5, 40, log=True),
        "learning_rate": Within(2e-3, 2e-2, log=True),
    }
    limits: ClassVar[dict[str, Limit]] = {
        **{name: at_least(1) for name in ("hidden", "one_step_updates", "updates", "horizon")},
        "learning_rate": above(0),
        "input_noise": at_least(0),
    }
    offered_lags: ClassVar[tuple[tuple[int, int], ...]] = ((0, 2), (0, 3), (1, 3))
    initial: ClassVar[Array] = np.empty(0)
    spread_groups: ClassVar[int] = 2
    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": {**QUICK, "state_lags": 0, "control_lags": 2},
        "paper": {"one_step_updates": 3000, "updates": 1500},
    }

    hidden: list[int] | None = None
    state_lags: int | None = None
    control_lags: int | None = None
    one_step_updates: int = 1000
    updates: int = 500
    horizon: int = 20
    learning_rate: float = 6e-3
    input_noise: float = 0.05
    rest_hold: bool = False
    most_steps: int | None = 100_000

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        from model_zoo.flows.training import FittedFlow, train_flow
        from model_zoo.networks.multistep import Plan
        from model_zoo.networks.trainings import Trainings

        plan = Plan(
            self.one_step_updates,
            self.updates,
            self.horizon,
            learning_rate=self.learning_rate,
            input_noise=self.input_noise,
        )
        final = replace(plan, check_every=50)
        one_step_updates, updates = (max(1, round(SEARCH_SHARE * n)) for n in (plan.one_step_updates, plan.updates))
        search = replace(plan, one_step_updates=one_step_updates, updates=updates)
        options = lag_candidates(self.state_lags, self.control_lags, self.offered_lags)
        counter = Counter(progress, final.total + trials(options) * search.total)

        def trained(lags: tuple[int, int], plan: Plan) -> FittedFlow:
            return train_flow(
                dataset,
                lags,
                hidden=self.hidden or HIDDEN,
                plan=plan,
                trainings=trainings,
                physics=self.physics(),
                physical=self.initial,
            )

        with Trainings.of(self, dataset, rng, counter.advance) as trainings:
            lags = best(options, lambda lags: trained(lags, search).error)
            fitted = trained(lags, final)
        self.keep_lags(lags)
        self.weights_, self.biases_ = list(fitted.network.weights), list(fitted.network.biases)
        if len(self.initial):
            self.physical_ = fitted.physical
        self.calibrate(dataset, rng, lambda: counter.advance(0))
        return self

    def trained_further(self, dataset: Dataset, updates: int, *, rng: np.random.Generator) -> Self:
        from model_zoo.flows.training import train_flow_further
        from model_zoo.networks.multistep import Plan

        plan = Plan.further(updates, self.horizon, self.input_noise)
        physics, physical = self.physics(), self.physical_ if len(self.initial) else self.initial
        network, physical = train_flow_further(
            self.network, dataset, self.lags, plan, rng, physics=physics, physical=physical
        )
        other = self.variant()
        other.weights_, other.biases_ = list(network.weights), list(network.biases)
        if len(self.initial):
            other.physical_ = physical
        return other

    def known_rate(self, state: Array, control: Array) -> Array | None:
        """Return the part of dx/dt (B, nx) that is not the network's, if there is one."""
        return None

    def physics(self) -> Physics | None:
        """Return `known_rate` as it is trained, in a family with ``initial`` physical parameters."""
        return None

    @property
    def network(self) -> Network:
        """Features of (carry, control) to the learned part of dx/dt."""
        return Network(self.weights_, self.biases_)

    def known_predictor(self) -> Predictor | None:
        """Return `known_rate` as a predictor of the fast engine, if there is one."""
        return None

    def predictor(self) -> Predictor | None:
        return flow_predictor(self.network, self.system, self.lags, self.known_predictor())

    def next_state(self, carry: Array, control: Array) -> Array:
        return flow_step(self.network, self.system, self.lags, carry, control, self.known_rate)
