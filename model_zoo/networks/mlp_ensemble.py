"""Family mlp_ensemble: several networks, each trained without other blocks of time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, ClassVar, Literal, Self

import numpy as np

from model_zoo.features import Features
from model_zoo.networks.backpropagation import DifferentiableSimulation
from model_zoo.networks.network import Array32, Network, declared_layers
from model_zoo.networks.training import ResumableTrainings, TrainingSchedule, training_horizon
from model_zoo.scaling import Mirror
from sysid_evo import Dataset, DynamicsModel, register_model
from sysid_evo.models.kernels import Predictor, network_predictor, with_angles
from sysid_evo.models.learned import Declared, Numbers
from sysid_evo.models.parameters import Limit, at_least
from sysid_evo.models.stochastic import StochasticModel
from sysid_evo.progress import Counter, Progress
from sysid_evo.types import Array, IntArray
from sysid_evo.validation.folds import time_fold
from sysid_evo.validation.held_out import best_candidate, count_fits, lag_candidates
from sysid_evo.validation.intervals import (
    HORIZONS,
    MAX_WINDOWS,
    RECENT,
    Case,
    RecentErrors,
    growth_on_unseen_recordings,
    horizon_scales,
    persistent_share,
    rough_fits,
    usable_horizon,
)

HIDDEN = (48, 48)

SEARCH_UPDATES = (600, 120)
"""Most updates on single steps and on simulations while lags are chosen."""

DIVERGED_RATIO = 3.0
"""A member is left out if its error on its held-out blocks exceeds this multiple of the median of all members."""

OFFERED = {"all": ((1, 3), (2, 4)), "few": ((0, 0), (1, 3))}


@register_model("mlp_ensemble")
class MlpEnsemble(StochasticModel):
    """Ensemble of neural networks for the acceleration, trained through simulations; the mean is the prediction.

    Each of the ``members`` is trained without every ``folds``-th block of time (other blocks for each member):
    ``one_step_updates`` updates on single steps, then ``updates`` on simulations of ``horizon`` steps from measured
    states, to which ``input_noise`` is added (in units of the one-step change). It keeps the weights that simulate its
    held-out blocks best over one second; a member whose error there exceeds three times the median of all is left out.
    ``hidden`` lists the widths of the tanh layers (default 48, 48). Lags left at None are chosen on the held-out
    blocks, by ``lag_search="few"`` only between none and (1, 3). Periodic states enter as sine and cosine.

    If a planar body is steered by the controls ``steering``, half of the windows are mirrored left to right, with a
    flag as input, so that both sides share data and may still differ. The flag is fixed after the fit.

    With ``stochastic``, every step adds normal noise: the members' disagreement and the one-step residual, scaled as in
    `StochasticModel`. Such a fit also holds out whole recordings in turn and widens the intervals by the ratio of their
    errors to those on held-out blocks (`growth_on_unseen_recordings`).
    """

    knowledge = "dark grey"
    model_class = "network"
    periodic = True
    resumable = True
    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": {
            "members": 3,
            "hidden": [32, 32],
            "lag_search": "few",
            "one_step_updates": 600,
            "updates": 200,
        },
        "paper": {"members": 10, "one_step_updates": 8000, "updates": 2000},
    }
    limits: ClassVar[dict[str, Limit]] = {
        **{name: at_least(1) for name in ("members", "hidden", "one_step_updates", "updates", "horizon")},
        "input_noise": at_least(0),
        "folds": at_least(2),
    }

    members: int = 6
    hidden: list[int] | None = None
    state_lags: int | None = None
    control_lags: int | None = None
    lag_search: Literal["all", "few"] = "all"
    one_step_updates: int = 4000
    updates: int = 1000
    horizon: int = 20
    input_noise: float = 0.05
    folds: int = 6
    steering: list[str] | None = None
    max_steps: int | None = 100_000

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        final = TrainingSchedule(self.one_step_updates, self.updates, self.horizon, input_noise=self.input_noise)
        one_step_updates, updates = np.minimum(SEARCH_UPDATES, (self.one_step_updates, self.updates)).tolist()
        search = replace(final, one_step_updates=one_step_updates, updates=updates)
        options = lag_candidates(self.state_lags, self.control_lags, OFFERED[self.lag_search])
        rough = rough_fits(dataset) if self.stochastic else 0
        counter = Counter(
            progress, final.total + (count_fits(options) + rough) * search.total + 1
        )  # 1: the calibration

        def trained(
            data: Dataset, lags: tuple[int, int], members: int, plan: TrainingSchedule
        ) -> tuple[Network, Array]:
            """Return members, each trained without its blocks of time, and their errors on these blocks."""
            splits = [time_fold(data, member, self.folds) for member in range(members)]
            hidden, mirror = self.hidden or HIDDEN, Mirror.of(dataset.system, self.steering)
            model = DifferenceNetworks(
                data, lags, hidden=hidden, members=members, further=1, mirror=mirror, rng=trainings.rng
            )
            parameters, errors = model.learn(splits, plan, trainings)
            return model.network(parameters), errors

        def quick_fit(part: Dataset) -> DynamicsModel:
            return self._deterministic(trained(part, lags, min(2, self.members), search)[0])

        with ResumableTrainings.of(self, dataset, rng, counter.advance) as trainings:
            few = min(3, self.members)
            lags = best_candidate(options, lambda option: float(np.mean(trained(dataset, option, few, search)[1])))
            self.record_lags(lags)
            network, errors = trained(dataset, lags, self.members, final)
            kept = held_together(errors)
            self.weights_, self.biases_ = [w[kept] for w in network.weights], [b[kept] for b in network.biases]
            if len(kept) < self.members:
                self.left_out_ = self.members - len(kept)
            parts = [time_fold(dataset, member, self.folds)[0] for member in range(self.members)]
            usable = min(training_horizon(part, self.horizon, self.n_lags) for part in parts)
            if usable < self.horizon:
                self.training_horizon_ = usable
            growth = growth_on_unseen_recordings(quick_fit, dataset) if rough else None
        if self.stochastic:
            self._calibrate_horizons(dataset, kept, growth, rng, lambda: counter.advance(0))
        return self

    def fine_tuned(self, dataset: Dataset, updates: int, *, rng: np.random.Generator) -> Self:
        plan = TrainingSchedule.further(updates, self.horizon, self.input_noise)
        members, hidden = len(self.weights_[0]), [weight.shape[2] for weight in self.weights_[:-1]]
        mirror = Mirror.of(dataset.system, self.steering)
        model = DifferenceNetworks(
            dataset, self.lags, hidden=hidden, members=members, further=1, mirror=mirror, rng=rng
        )
        model.start_from(self.network)
        network = model.network(model.fine_tune(dataset, plan, ResumableTrainings(rng)))
        other = self.variant()
        other.weights_, other.biases_ = list(network.weights), list(network.biases)
        return other

    @property
    def network(self) -> Network:
        """The members: features of (carry, control) to accelerations."""
        return Network(self.weights_, self.biases_)

    @property
    def fit_note(self) -> str:
        steps = getattr(self, "training_horizon_", None)
        short = (
            f"trained on simulations of {steps} steps in place of {self.horizon}, because episodes are short; single "
            "steps of all episodes are used"
        )
        left = getattr(self, "left_out_", None)
        diverged = f"{left} of {self.members} networks are left out, because they diverge on their held-out blocks"
        return "; ".join(filter(None, (super().fit_note, short if steps else "", diverged if left else "")))

    def learned_arrays(self) -> Mapping[str, Declared]:
        seen = Features(self.system, self.lags).n_carry + self.system.nu
        count = Numbers(whole=True, least=1, optional=True)
        return declared_layers(self.weights_, seen, self.system.nx) | {"training_horizon_": count, "left_out_": count}

    def acceleration(self, carry: Array, control: Array) -> Array:
        return self._members(carry, control).mean(axis=0)

    def _with_deviation(self, carry: Array, control: Array) -> tuple[Array, Array]:
        members = self._members(carry, control)
        after = self.system.integrate(carry[:, : self.system.nx], members.mean(axis=0))
        return after, np.sqrt(members.var(axis=0) * self.system.dt**2 + self.residual_**2)

    def _members(self, carry: Array, control: Array) -> Array:
        """Return the accelerations (M, B, nx) of all members."""
        return self.network(Features(self.system, self.lags)(carry, control))

    def predictor(self) -> Predictor | None:
        if self.stochastic:
            return None
        seen = Features(self.system, self.lags).n_carry
        return with_angles(network_predictor(self.network.members(), seen, self.system.nu), self.system, self.lags)

    def _of_member(self, member: int) -> MlpEnsemble:
        own = slice(member, member + 1)
        return self._deterministic(Network([w[own] for w in self.weights_], [b[own] for b in self.biases_]))

    def _deterministic(self, network: Network) -> MlpEnsemble:
        """Return this model without noise and with the members of ``network``."""
        other = self.variant(stochastic=False)
        other.weights_, other.biases_ = list(network.weights), list(network.biases)
        return other

    def _calibrate_horizons(
        self,
        dataset: Dataset,
        kept: IntArray,
        growth: Array | None,
        rng: np.random.Generator,
        heartbeat: Callable[[], None],
    ) -> None:
        """Learn the spread of `StochasticModel` from the errors of each member on its held-out blocks.

        ``kept`` are the numbers of the members among all that were trained, which are those of their blocks. The
        reference is the simulation of the whole ensemble plus the error of each member on its blocks; ``growth``
        (4, nx) multiplies the errors: the ratio of those on unseen recordings after 1, 10, 20, 60 steps.
        """
        held = [time_fold(dataset, member, self.folds)[1] for member in kept.tolist()]
        horizon = usable_horizon(held, self.n_lags)
        steps = np.arange(1, max(horizon, RECENT) + 1)
        factors = np.ones((len(HORIZONS), self.system.nx)) if growth is None else growth
        times = np.stack([np.interp(steps, HORIZONS, factor) for factor in factors.T], axis=1)
        cases, recent, residuals, numbers = [], [], [], []
        together = self._deterministic(self.network)
        for member, part in enumerate(held):
            heartbeat()
            single = self._of_member(member)
            single.residual_ = np.zeros(self.system.nx)
            case = Case.of(self, part, horizon, MAX_WINDOWS // len(kept))
            recent.append(RecentErrors.before(replace(case, model=single), part))
            history = case.windows.past_states, case.windows.past_controls, case.windows.controls
            error = case.windows.states - single.simulate(*history)
            moved = replace(case.windows, states=together.simulate(*history) + times[:horizon] * error)
            cases.append(replace(case, windows=moved))
            each = part.windows(1, history=self.n_lags)
            residuals.append((each.states - single.simulate(each.past_states, each.past_controls, each.controls))[:, 0])
            numbers.append(each.start + 10**6 * (each.episode + 1) + 10**9 * member)
        pooled = np.concatenate(residuals)
        persistent = persistent_share(pooled, np.concatenate(numbers))
        residual = np.sqrt(np.mean(pooled**2, axis=0))
        self.keep_spread(residual, persistent, np.ones_like(factors))
        usual = times[:RECENT] * RecentErrors.usual(recent)
        self.keep_spread(residual, persistent, horizon_scales(cases, persistent, rng, heartbeat=heartbeat), usual)


def held_together(errors: Array) -> IntArray:
    """Return the numbers of the members that do not diverge, from the errors (M,) on their held-out blocks."""
    limit = DIVERGED_RATIO * np.median(errors)
    return np.flatnonzero(errors <= limit) if np.isfinite(limit) else np.arange(len(errors))


class DifferenceNetworks(DifferentiableSimulation):
    """M networks that give the change of the state in one step from (carry, control, flag); -1 for mirrored data."""

    def prepare(self, horizon: int) -> None:
        self.accelerations: Array32 = np.empty((horizon, *self.states.shape[1:]), dtype=np.float32)

    def advance(self, step: int, state: Array32) -> Array32:
        acceleration: Array32 = self.network_output(step, 0, state)
        self.accelerations[step] = acceleration
        return self.system.integrate(state, acceleration)

    def pull_back(self, step: int, gradient: Array32) -> Array32:
        state = self.states[self.layout.n_lags + step]
        moved = self.motion.of_integrate(state, self.accelerations[step], self.system.dt, gradient)
        by_state, by_acceleration = moved
        return by_state + self.backpropagated(step, 0, state, by_acceleration)
