"""A batch of state spaces, and Levenberg-Marquardt on their simulations from free initial states.

    x' = x + pace (Outer (x, u, 1, units(Inner (x, u, 1)))),  y = the first states

or the flow of dx/dt = pace (...), time in samples, by one step of the classical Runge-Kutta method. The Jacobian is
computed by forward sensitivities: S' = (dx'/dx) S + dx'/dparameters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from model_zoo.state_space.recordings import ShootingWindows
from model_zoo.state_space.shooting_kernel import compiled_run, compiled_sensitivities
from model_zoo.state_space.units import slopes, values
from sysid_evo.models.dynamics import rk4
from sysid_evo.types import Array, BoolArray, IntArray

DIVERGED_DISTANCE = 30.0
"""Distance from the centre, in deviations, at which a simulation has diverged."""
START_PRIOR = 0.05
"""Weight of squared initial states relative to that of residuals in units of the noise."""
LINEAR_PRIOR = 1e-4
MAX_MEMORY = 3.0
"""Largest number of correlated residuals that count as one."""
DAMPING_DECREASE, DAMPING_INCREASE = 0.3, 5.0
STIFFEST = 1e8
MIN_IMPROVEMENT, MAX_FINAL_DAMPING = 1e-5, 1e-2
"""Relative improvement of the objective below which training stops, unless steps are damped more than the second."""


@dataclass(frozen=True)
class StateSpaceBatch:
    """S spaces: ``outer`` (S, n, n + nu + 1 + h), ``inner`` (S, h, n + nu + 1), ``rate_scale`` (n,), ``kinds`` (S, h).

    They are difference equations, or with ``flow`` differential equations.
    """

    outer: Array
    inner: Array
    rate_scale: Array
    kinds: IntArray
    flow: bool = False

    @classmethod
    def linear(cls, outer: Array, pace: Array, *, flow: bool = False) -> Self:
        """Return spaces without units, from ``outer`` (S, n, n + nu + 1)."""
        none = np.empty((len(outer), 0, outer.shape[2]))
        return cls(outer, none, pace, np.empty((len(outer), 0), dtype=np.int64), flow)

    def __len__(self) -> int:
        return len(self.outer)

    def __getitem__(self, rows: Sequence[int] | IntArray) -> StateSpaceBatch:
        chosen = np.asarray(rows, dtype=np.int64)
        return replace(self, outer=self.outer[chosen], inner=self.inner[chosen], kinds=self.kinds[chosen])

    @property
    def n(self) -> int:
        """Number of states."""
        return self.outer.shape[1]

    @property
    def flat(self) -> Array:
        """All parameters, (S, P)."""
        return np.concatenate([self.outer.reshape(len(self), -1), self.inner.reshape(len(self), -1)], axis=1)

    def with_flat(self, flat: Array) -> StateSpaceBatch:
        """Return the spaces with other parameters (S, P)."""
        split = self.outer[0].size
        return replace(
            self, outer=flat[:, :split].reshape(self.outer.shape), inner=flat[:, split:].reshape(self.inner.shape)
        )

    @property
    def prior(self) -> Array:
        """L2 penalty of each parameter, shape (P,); close to zero for the linear part."""
        outer = np.ones(self.outer.shape[1:])
        outer[:, : self.inner.shape[2]] = LINEAR_PRIOR
        return np.concatenate([outer.ravel(), np.ones(self.inner[0].size)])

    @property
    def blind(self) -> BoolArray:
        """Which parameters (S, P) are fixed: those of units without effect."""
        nothing = self.inner == 0.0
        outer = np.zeros(self.outer.shape, dtype=bool)
        outer[..., self.inner.shape[2] :] = nothing.all(axis=2)[:, None, :]
        return np.concatenate([outer.reshape(len(self), -1), nothing.reshape(len(self), -1)], axis=1)

    def step(self, states: Array, controls: Array) -> Array:
        """Return the next states (S, B, n) under ``controls`` (B, nu)."""
        if self.flow:
            return np.asarray(rk4(lambda at: self.rates(at, controls), states, 1.0))
        return states + self.rates(states, controls)

    def rates(self, states: Array, controls: Array) -> Array:
        """Return the change of the states (S, B, n) in one sample; of a flow at its initial rate."""
        regressors = self._regressors(states, controls)
        inside = regressors @ self.inner.swapaxes(1, 2)
        units = np.stack([values(own, s) for own, s in zip(self.kinds, inside, strict=True)])
        return self.rate_scale * (np.concatenate([regressors, units], axis=2) @ self.outer.swapaxes(1, 2))

    def run(self, states: Array, controls: Array) -> Array:
        """Return the states (S, B, H + 1, n) of simulations under ``controls`` (B, H, nu)."""
        out = np.empty((*states.shape[:2], controls.shape[1] + 1, self.n))
        room = np.empty(self._room + 2 * self.n)
        compiled = compiled_run(flow=self.flow)
        for s in range(len(self)):
            own = self._arguments(s, states[s], controls, 0)
            compiled(*own, np.array([DIVERGED_DISTANCE]), out[s].reshape(-1), room)
        return out

    def jacobian(self, states: Array, controls: Array) -> Array:
        """Return dx'/dx (S, B, n, n)."""
        one = np.eye(self.n)
        if not self.flow:
            through, linear = self._slopes(states, controls)
            return np.asarray(through + one + linear)

        def rates(at: Array) -> Array:
            own, (through, linear) = at[..., 0], self._slopes(at[..., 0], controls)
            return np.concatenate([self.rates(own, controls)[..., None], (through + linear) @ at[..., 1:]], axis=3)

        begin = np.concatenate([states[..., None], np.broadcast_to(one, (*states.shape, self.n))], axis=3)
        return np.asarray(rk4(rates, begin, 1.0)[..., 1:])

    def _slopes(self, states: Array, controls: Array) -> tuple[Array, Array]:
        """Return the derivatives of `rates` by the states, through the units (S, B, n, n) and of the linear part."""
        regressors = self._regressors(states, controls)
        inside = regressors @ self.inner.swapaxes(1, 2)
        steep = np.stack([slopes(own, s) for own, s in zip(self.kinds, inside, strict=True)])
        weights = self.rate_scale[:, None] * self.outer[:, None, :, regressors.shape[2] :]
        through = weights @ steep @ self.inner[:, None, :, : self.n]
        return through, self.rate_scale[:, None] * self.outer[:, None, :, : self.n]

    def _regressors(self, states: Array, controls: Array) -> Array:
        shape = *states.shape[:2], controls.shape[1]
        ones = np.ones((*shape[:2], 1))
        return np.concatenate([states, np.broadcast_to(controls, shape), ones], axis=2)

    @property
    def _room(self) -> int:
        return self.outer.shape[2] + 2 * self.inner.shape[1]

    def _arguments(self, s: int, starts: Array, controls: Array, n_outputs: int) -> tuple[Any, ...]:
        """Return the first arguments of the compiled functions, for space ``s`` from ``starts`` (B, n)."""
        pieces, steps, nu = controls.shape
        sizes = np.array([pieces, steps, self.n, nu, self.inner.shape[1], n_outputs])
        numbers = (self.outer[s], self.inner[s], self.kinds[s], self.rate_scale, starts, controls)
        return sizes, *(np.ascontiguousarray(own).reshape(-1) for own in numbers)

    def sensitivities(self, s: int, starts: Array, windows: ShootingWindows) -> tuple[Array, Array]:
        """Return the outputs (B, H + 1, ny) of space ``s`` from ``starts`` (B, n), and their derivatives.

        States are not bounded here, because a bound has no slope. The derivatives are (B, H + 1, ny, P + n), zero for
        samples that do not count; the last n are those by the start.
        """
        ny = windows.outputs.shape[2]
        size = self.outer[s].size + self.inner[s].size + self.n
        states = np.empty((*windows.counts.shape, self.n))
        derivatives = np.empty((*windows.counts.shape, ny, size))
        room = np.empty(self._room + self.n * (self.inner.shape[1] + self.n + 2 + 2 * size * self.flow))
        compiled = compiled_sensitivities(flow=self.flow)
        compiled(
            *self._arguments(s, starts, windows.controls, ny),
            windows.counts.reshape(-1),
            np.array([np.inf]),
            states.reshape(-1),
            derivatives.reshape(-1),
            *np.empty((2, self.n * size)),
            room,
        )
        return states[..., :ny], derivatives


@dataclass(frozen=True)
class Trained:
    """Spaces after training, the initial states (S, B, n) of the windows, and the mean square residual (S,)."""

    spaces: StateSpaceBatch
    starts: Array
    error: Array

    def __getitem__(self, rows: IntArray) -> Trained:
        return Trained(self.spaces[rows], self.starts[rows], self.error[rows])


@dataclass
class _Objective:
    """The objective: residuals in units of the noise, priors on parameters and initial states."""

    windows: ShootingWindows
    prior: Array

    def residuals(self, outputs: Array) -> Array:
        return (outputs - self.windows.outputs) * self.windows.counts[:, :, None]

    def error(self, residuals: Array) -> Array:
        count = self.windows.counts.sum() * residuals.shape[3]
        return np.asarray((residuals**2).sum(axis=(1, 2, 3)) / count)

    def scale(self, residuals: Array) -> Array:
        """Return the weight of a squared residual, (S,): smaller if residuals are correlated."""
        power = (residuals**2).sum(axis=(1, 2, 3))
        autocorrelation = (residuals[:, :, 1:] * residuals[:, :, :-1]).sum(axis=(1, 2, 3)) / np.maximum(power, 1e-300)
        memory = np.clip((1.0 + autocorrelation) / np.maximum(1.0 - autocorrelation, 1e-3), 1.0, MAX_MEMORY)
        return np.asarray(1.0 / (np.maximum(self.error(residuals), 1e-12) * memory))

    def value(self, residuals: Array, scale: Array, flat: Array, starts: Array) -> Array:
        with np.errstate(all="ignore"):
            total = scale * (residuals**2).sum(axis=(1, 2, 3)) + (self.prior * flat**2).sum(axis=1)
            total = total + START_PRIOR * (starts**2).sum(axis=(1, 2))
        return np.where(np.isfinite(total), total, np.inf)


@np.errstate(over="ignore", invalid="ignore")  # a space that diverges counts as the worst
def train(
    spaces: StateSpaceBatch,
    windows: ShootingWindows,
    starts: Array,
    iterations: int,
    report: Callable[[], None] = lambda: None,
) -> Trained:
    """Fit all parameters and the initial states ``starts`` (S, B, n) by Levenberg-Marquardt, each space independently.

    ``report`` is called after each iteration, always ``iterations`` times.
    """
    objective, ny = _Objective(windows, spaces.prior), windows.outputs.shape[2]
    damping, improving = np.full(len(spaces), 1e-2), np.ones(len(spaces), dtype=bool)
    starts = starts.copy()
    for _ in range(iterations):
        rows = np.flatnonzero(improving).astype(np.int64)
        if len(rows):
            own = spaces[rows]
            flat = spaces.flat
            flat[rows], starts[rows], damping[rows], improving[rows] = _improve(
                own, starts[rows], damping[rows], objective, ny
            )
            spaces = spaces.with_flat(flat)
        report()
    outputs = spaces.run(starts, windows.controls)[..., :ny]
    return Trained(spaces, starts, objective.error(objective.residuals(outputs)))


MAX_DAMPINGS = 6
"""Dampings that are tried in one iteration."""


def _improve(
    spaces: StateSpaceBatch, starts: Array, damping: Array, objective: _Objective, ny: int
) -> tuple[Array, Array, Array, BoolArray]:
    """Return parameters (S, P), initial states, damping after one iteration, and which spaces still improve."""
    flat, damping = spaces.flat.copy(), damping.copy()
    starts = starts.copy()
    outputs = np.empty((len(spaces), *objective.windows.outputs.shape))
    tangents = []
    for member, blind in enumerate(spaces.blind):
        outputs[member], derivatives = spaces.sensitivities(member, starts[member], objective.windows)
        derivatives[..., np.flatnonzero(blind)] = 0.0
        tangents.append(derivatives)
    residuals = objective.residuals(outputs)
    scale = objective.scale(residuals)
    value = objective.value(residuals, scale, flat, starts)
    systems = [
        _Normal.of(*own, objective.prior, flat[member], starts[member])
        for member, own in enumerate(zip(tangents, residuals, scale, strict=True))
    ]
    left, improving = np.ones(len(spaces), dtype=bool), np.ones(len(spaces), dtype=bool)
    for _ in range(MAX_DAMPINGS):
        rows = np.flatnonzero(left).astype(np.int64)
        if not len(rows):
            break
        moved = [systems[s].solve(damping[s]) for s in rows]
        new_flat = flat[rows] - np.stack([step for step, _ in moved])
        new_starts = starts[rows] - np.stack([step for _, step in moved])
        with np.errstate(all="ignore"):
            run = spaces[rows].with_flat(new_flat).run(new_starts, objective.windows.controls)
        tried = objective.value(objective.residuals(run[..., :ny]), scale[rows], new_flat, new_starts)
        for i, s in enumerate(rows):
            if tried[i] < value[s]:
                flat[s], starts[s] = new_flat[i], new_starts[i]
                improving[s] = value[s] - tried[i] > MIN_IMPROVEMENT * value[s] or damping[s] > MAX_FINAL_DAMPING
                damping[s] *= DAMPING_DECREASE
                left[s] = False
            else:
                damping[s] *= DAMPING_INCREASE
    return flat, starts, damping, improving & (damping < STIFFEST)


@dataclass(frozen=True)
class _Normal:
    """The normal equations of one space: parameters (P), and B eliminated initial states (n)."""

    square: Array
    gradient: Array
    cross: Array
    own: Array
    own_gradient: Array

    @classmethod
    def of(
        cls, derivatives: Array, residuals: Array, scale: float, prior: Array, flat: Array, starts: Array
    ) -> _Normal:
        pieces, size = len(starts), len(flat)
        jacobian = derivatives.reshape(pieces, -1, derivatives.shape[3])
        off = residuals.reshape(pieces, -1)
        by_parameters, by_start = jacobian[..., :size], jacobian[..., size:]
        whole = by_parameters.reshape(-1, size)
        return cls(
            scale * (whole.T @ whole) + np.diag(prior),
            scale * (whole.T @ off.ravel()) + prior * flat,
            scale * (by_parameters.swapaxes(1, 2) @ by_start),
            scale * (by_start.swapaxes(1, 2) @ by_start) + START_PRIOR * np.eye(starts.shape[1]),
            scale * (by_start.swapaxes(1, 2) @ off[..., None])[..., 0] + START_PRIOR * starts,
        )

    def solve(self, damping: float) -> tuple[Array, Array]:
        """Return the steps of parameters (P,) and initial states (B, n), to be subtracted."""
        square = self.square + damping * np.diag(np.diag(self.square))
        own = self.own * (1.0 + damping * np.eye(self.own.shape[1]))
        inverse = np.linalg.inv(own)
        through = self.cross @ inverse
        reduced = square - (through @ self.cross.swapaxes(1, 2)).sum(axis=0)
        gradient = self.gradient - (through @ self.own_gradient[..., None])[..., 0].sum(axis=0)
        try:
            step = np.linalg.solve(reduced, gradient)
        except np.linalg.LinAlgError:
            step = np.linalg.lstsq(reduced, gradient, rcond=None)[0]
        rest = self.own_gradient - self.cross.swapaxes(1, 2) @ step
        return step, (inverse @ rest[..., None])[..., 0]
