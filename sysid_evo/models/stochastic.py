"""Prediction intervals for any family: white and persistent process noise, calibrated on held-out simulations."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

import numpy as np

from sysid_evo.carry import recent
from sysid_evo.data.dataset import Dataset
from sysid_evo.kernels import DynamicsKernel
from sysid_evo.models.base import DynamicsModel
from sysid_evo.models.kernels.stepping import StepNoise
from sysid_evo.models.learned import Declared, Numbers
from sysid_evo.types import Array
from sysid_evo.validation.folds import recording_or_time_folds
from sysid_evo.validation.intervals import (
    HORIZONS,
    MAX_WINDOWS,
    RECENT,
    Case,
    RecentErrors,
    horizon_scales,
    step_spread,
    usable_horizon,
)


class StochasticModel(DynamicsModel):
    """A family with process noise if it is fitted with ``stochastic``.

    Every step adds normal noise to the state: sigma_k (sqrt(1 - p) w + sqrt(p) b) times a deviation, with w new in
    every step and b drawn once for a run, because model errors persist. sigma_k has one value for the first step, which
    includes the noise of the measured start, and one each up to 10, 20 and 60 steps, so that 90 % intervals contain
    90 % of the targets at all four. It is calibrated on simulations of held-out data: recordings in turn,
    or blocks of time of a single recording (`horizon_scales`). The deviation is the one-step error by default
    (`_with_deviation`).

    All noise of a run is multiplied by the error of a simulation of the last 20 measured steps, in units of the usual
    one on held-out data, if that is above 1 (`RecentErrors`): in another condition intervals are wider. `start` uses
    ``n_recent`` more samples for it. There, errors keep growing where those of the held-out data do not: with a factor
    f, sigma_k is larger by (1 - 1 / f)^2 of what it lacks to its largest value since the second step.
    """

    _calibration_folds: ClassVar[int] = 4
    """Number of parts that are held out in turn to calibrate the noise; each takes another fit."""
    stochastic: bool = False

    @property
    def timed(self) -> bool:
        """Whether there is noise that depends on the time since the start, which the carry then counts."""
        return self.stochastic and hasattr(self, "horizon_scales_")

    @property
    def n_recent(self) -> int:
        return RECENT if self.timed and hasattr(self, "usual_errors_") else 0

    @property
    def _n_plain(self) -> int:
        """Length of the carry without the rows of the noise."""
        return self.layout.size

    @property
    def n_noise(self) -> int:
        return self.system.nx if self.timed else 0

    @property
    def n_draws(self) -> int:
        return self.system.nx if self.timed else 0

    @property
    def n_carry(self) -> int:
        return self._n_plain + (self.system.nx + 2 if self.timed else 0)

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        carry = self.initial_carry(*recent(states, controls, self.n_lags))
        if not self.timed:
            return carry
        lasting = np.zeros((len(carry), self.system.nx)) if draws is None else draws
        count, factor = np.zeros((len(carry), 1)), np.ones((len(carry), 1))
        if self.n_recent and controls.shape[1] > self.n_lags:
            factor = RecentErrors.of(self, states, controls).factor(self.usual_errors_)
        return np.concatenate([carry, lasting, count, factor], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        if not self.timed:
            return self._undisturbed(carry, control)
        size, nx = self._n_plain, self.system.nx
        plain, lasting, count, factor = np.split(carry, [size, size + nx, size + nx + 1], axis=1)
        if noise is None:
            after = self._undisturbed(plain, control)
        else:
            span = np.searchsorted(HORIZONS[:-1], count[:, 0], side="right")
            scale = self.horizon_scales_[span] * (1.0 + self._growth[span] * (1.0 - 1.0 / np.maximum(factor, 1.0)) ** 2)
            mixed = np.sqrt(1.0 - self.persistent_) * noise + np.sqrt(self.persistent_) * lasting
            after = self.disturbed(plain, control, factor * scale * mixed)
        return np.concatenate([after, lasting, count + 1.0, factor], axis=1)

    @property
    def _growth(self) -> Array:
        """The share (4, nx) by which noise can grow in another condition, beyond the factor of the run."""
        later = self.horizon_scales_[1:]
        growth = np.maximum.accumulate(later, axis=0) / np.maximum(later, np.finfo(float).tiny) - 1.0
        return np.concatenate([np.zeros((1, self.system.nx)), growth])

    def learned_arrays(self) -> Mapping[str, Declared]:
        nx, timed = self.system.nx, hasattr(self, "horizon_scales_")
        return {
            "residual_": Numbers(nx, optional=not timed),
            "persistent_": Numbers(nx, least=0, most=1, optional=not timed),
            "horizon_scales_": Numbers(len(HORIZONS), nx, optional=True),
            "usual_errors_": Numbers(RECENT, nx, least=0, optional=True),
        }

    def keep_spread(self, residual: Array, persistent: Array, scales: Array, usual: Array | None = None) -> None:
        """Record the error of one step (nx,), the persistent share (nx,), and the scales of `horizon_scales`.

        ``usual`` (20, nx) are the errors of `RecentErrors.usual`; by default the noise has no factor.
        """
        self.residual_: Array = residual
        self.persistent_: Array = persistent
        self.horizon_scales_: Array = scales
        self.__dict__.pop("usual_errors_", None)
        if usual is not None:
            self.usual_errors_: Array = usual

    def record(self, dataset: Dataset) -> None:
        super().record(dataset)
        for name in ("horizon_scales_", "persistent_", "residual_", "usual_errors_"):
            self.__dict__.pop(name, None)

    def _with_deviation(self, carry: Array, control: Array) -> tuple[Array, Array]:
        """Return the next state (B, nx), and the unit of its noise, (nx,) or (B, nx)."""
        return self.next_state(carry, control), self.residual_

    def _undisturbed(self, carry: Array, control: Array) -> Array:
        """Return the next carry without noise and without its rows."""
        return super().step(carry, control)

    def disturbed(self, carry: Array, control: Array, disturbance: Array) -> Array:
        """Return the next lagged carry, with ``disturbance`` (B, nx), in deviations, added to the state."""
        after, deviation = self._with_deviation(carry, control)
        after = self.apply_limits(after + deviation * disturbance)
        return self.shift_lags(carry, control, after)

    def calibrate(
        self, dataset: Dataset, rng: np.random.Generator, heartbeat: Callable[[], None] = lambda: None
    ) -> None:
        """Calibrate the noise at the end of `fit`, if ``stochastic``; each part that is held out takes another fit."""
        if not self.stochastic:
            return
        models = []
        for seen, unseen in recording_or_time_folds(dataset)[: self._calibration_folds]:
            models.append((self._settled().fit(seen, rng=rng, progress=lambda *_: heartbeat()), unseen))
        self._spread_on(models, rng, heartbeat)

    def _settled(self) -> StochasticModel:
        """Return an unfitted model of this family with the hyper-parameters that `fit` chose, without noise."""
        parameters = self.get_params(deep=False)
        chosen = {
            name: getattr(self, f"{name}_")
            for name, value in parameters.items()
            if value is None and hasattr(self, f"{name}_")
        }
        found: StochasticModel = self.clone_unfitted().set_params(**{**chosen, "stochastic": False})
        return found

    def _spread_on(
        self,
        models: Sequence[tuple[StochasticModel, Dataset]],
        rng: np.random.Generator,
        heartbeat: Callable[[], None],
        *,
        own_deviation: bool = False,
    ) -> None:
        """Set residual, persistent share and scales from ``models``, each with its held-out data.

        The errors are theirs, but the noise is that of this model, since noise may grow differently in each. With
        ``own_deviation`` it is theirs, too: a deviation that depends on the state is smaller where a model was fitted.
        """
        residual, persistent = step_spread(models, lambda model, carry, control: model.next_state(carry, control))
        horizon = usable_horizon([part for _, part in models], self.n_lags)
        noisy = None if own_deviation else self
        for model in [] if own_deviation else [self, *(model for model, _ in models)]:
            model.residual_ = residual
        cases = [Case.of(model, part, horizon, MAX_WINDOWS // len(models), noisy=noisy) for model, part in models]
        usual = RecentErrors.usual(
            [RecentErrors.before(case, part) for case, (_, part) in zip(cases, models, strict=True)]
        )
        scales = horizon_scales(cases, persistent, rng, heartbeat=heartbeat)
        self.keep_spread(residual, persistent, scales, usual)

    @functools.cached_property
    def _stepping_kernel(self) -> DynamicsKernel | None:
        if not self.timed:
            return super()._stepping_kernel
        if type(self)._with_deviation is not StochasticModel._with_deviation:
            return None  # the unit of the noise differs from state to state
        predictor = self.variant(stochastic=False).predictor()  # without the rows after the lags
        if predictor is None:
            return None
        size, share = self.horizon_scales_ * self.residual_, self.persistent_
        white, lasting = size * np.sqrt(1.0 - share), size * np.sqrt(share)
        return self.stepping(predictor, StepNoise(HORIZONS[:-1], white, lasting, self._growth))
