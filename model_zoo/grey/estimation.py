"""The least squares of a grey box: parameters, hidden starts of all segments and offsets of groups, together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from model_zoo.grey.segments import Segments
from model_zoo.grey.structure import Structure
from sysid_evo.arrays import Array

STEP = 1e-3
"""Of the width of the bounds: the step of a difference quotient, far above the rounding of float32."""
LOOSE = 0.02
"""Weight of the prior of a hidden start, whose deviation is a quarter of its range, against one error."""
VAGUE = 0.5
"""Standard deviation of a guess in the cube: what the data leave open stays near it, and the search converges."""
NOISE = 0.1
"""What an error is taken for until it is known, in spreads of the state."""
WORST = 1e3
"""An error, in spreads of the state, beyond which none counts."""
ROBUST_AT = 1.5
"""Deviations from which on an error counts linearly, in a robust fit (Huber's rule of thumb, rounded up)."""


@dataclass(frozen=True)
class Estimate:
    """Places in the cube of bounds (n,), hidden starts (nh, W), offsets (G, k), weighted errors and their Jacobian.

    ``errors`` (W, m) and ``jacobian`` (W, m, n) are those of the data alone, ``by_hidden`` (W, m, nh) likewise.
    """

    places: Array
    hidden: Array
    offsets: Array
    cost: float
    errors: Array
    jacobian: Array
    by_hidden: Array


@dataclass(frozen=True)
class LeastSquares:
    """Errors of free runs in ``segments`` as a function of everything unknown.

    ``varied`` are the parameters that have an offset in each group, whose standard deviations ``spreads`` (k,) in the
    cube are given. Parameters with a ``spread`` of their own pull to their guess, an error counting as
    ``inflation`` errors would that hang together. ``told`` is called before each evaluation.
    """

    structure: Structure
    segments: Segments
    told: Callable[[], None]
    robust: bool = False
    varied: tuple[int, ...] = ()
    spreads: Array = field(default_factory=lambda: np.empty(0))
    noise: float = NOISE
    inflation: float = 1.0

    @cached_property
    def n(self) -> int:
        """Number of parameters."""
        return len(self.structure.parameters)

    @cached_property
    def n_groups(self) -> int:
        return len(self.segments.groups) if self.varied else 0

    @property
    def _hidden_scale(self) -> tuple[Array, Array]:
        hidden = self.structure.hidden
        return np.array([h.initial for h in hidden]), np.array([0.25 * (h.high - h.low) for h in hidden])

    @cached_property
    def _guesses(self) -> tuple[Array, Array]:
        """Where each parameter is guessed to be in the cube, and the standard deviation of that guess, (n,) each."""
        parameters, box = self.structure.parameters, self.structure.box
        places = box.places(np.array([p.guess for p in parameters]))
        known = np.array([p.spread or np.inf for p in parameters]) / box.slopes(places)
        return places, np.minimum(known, VAGUE)

    def cost(self, places: Array) -> Array:
        """Return the mean square error (P,) at places (P, n), hidden states followed through the history."""
        self.told()
        p = self.structure.box.values(places).T[:, :, None]
        errors = self._bounded(self.segments.errors(self.structure, p, self.segments.followed(self.structure, p)))
        return np.asarray(np.mean(np.minimum(errors**2, 1.0), axis=(1, 2)))

    def solve(self, places: Array, *, evaluations: int, hidden: Array | None = None) -> Estimate:
        """Return the least squares from a start; ``hidden`` (nh, W) are followed through the history unless given."""
        structure, box = self.structure, self.structure.box
        low, width = self._hidden_scale
        if hidden is None:
            p = box.values(places)[:, None, None]
            hidden = np.broadcast_to(
                self.segments.followed(structure, p), (len(structure.hidden), 1, len(self.segments))
            )[:, 0]
        zeta = (hidden - low[:, None]) / width[:, None] if len(structure.hidden) else hidden
        no_offsets = np.zeros(self.n_groups * len(self.varied))
        start = np.concatenate([np.clip(places, 1e-6, 1.0 - 1e-6), no_offsets, zeta.ravel()])
        lower, upper = np.full(len(start), -np.inf), np.full(len(start), np.inf)
        lower[: self.n], upper[: self.n] = 0.0, 1.0
        size = self._typical(start) if self.robust else 1.0
        found = least_squares(
            self._values,
            start,
            jac=self._jacobian,
            bounds=(lower, upper),
            x_scale="jac",
            loss="soft_l1" if self.robust else "linear",
            f_scale=ROBUST_AT * size,
            max_nfev=evaluations,
            xtol=1e-5,
            ftol=1e-5,
            gtol=1e-9,
        )
        errors, jacobian, by_hidden = self._parts(found.x)
        if self.robust:
            weight = (1.0 + (errors / (ROBUST_AT * size)) ** 2) ** -0.25
            errors, jacobian = weight * errors, weight[..., None] * jacobian
            by_hidden = weight[..., None] * by_hidden
        own, offsets, zeta = self._split(found.x)
        return Estimate(
            own, low[:, None] + width[:, None] * zeta, offsets, float(found.cost), errors, jacobian, by_hidden
        )

    def _typical(self, x: Array) -> float:
        """Return the deviation of the errors at ``x`` that outliers do not move: 1.48 median absolute ones."""
        off = np.abs(self._values(x)[: self.segments.windows.states[0].size * len(self.segments)])
        return max(1.4826 * float(np.median(off)), 1e-9)

    def _split(self, x: Array) -> tuple[Array, Array, Array]:
        """Return places (n,), offsets (G, k) and hidden starts (nh, W) in units of their width."""
        n, k = self.n, len(self.varied)
        end = n + self.n_groups * k
        return x[:n], x[n:end].reshape(self.n_groups, k), x[end:].reshape(-1, len(self.segments))

    def _run(self, places: Array, offsets: Array, zeta: Array) -> Array:
        """Return the errors (P, W, m) at places (n, P, 1), offsets (G, k), hidden starts (nh, P, W)."""
        self.told()
        low, width = (side[:, None, None] for side in self._hidden_scale)
        if len(self.varied):
            places = np.repeat(places, len(self.segments), axis=2)
            places[list(self.varied)] += offsets[self.segments.group].T[:, None, :]
        p = np.moveaxis(self.structure.box.values(np.moveaxis(places, 0, -1)), -1, 0)
        return self._bounded(self.segments.errors(self.structure, p, low + width * zeta))

    @staticmethod
    def _bounded(errors: Array) -> Array:
        return np.clip(np.nan_to_num(errors, nan=WORST, posinf=WORST, neginf=-WORST), -WORST, WORST)

    def _values(self, x: Array) -> Array:
        places, offsets, zeta = self._split(x)
        errors = self._run(places[:, None, None], offsets, zeta[:, None])
        return np.concatenate([errors.ravel(), self._priors(x)])

    def _priors(self, x: Array) -> Array:
        """Return what pulls to what was known before: measured parameters, no offsets, hidden states at rest."""
        places, offsets, zeta = self._split(x)
        guesses, spreads = self._guesses
        weight = self.noise * np.sqrt(self.inflation)
        return np.concatenate(
            [
                weight * (places - guesses) / spreads,
                (weight * offsets / np.where(self.spreads > 0.0, self.spreads, 1.0)).ravel(),
                LOOSE * zeta.ravel(),
            ]
        )

    def _parts(self, x: Array) -> tuple[Array, Array, Array]:
        """Return errors (W, m) and their derivatives by places (W, m, n) and by hidden starts (W, m, nh), of the data.

        All differences are one batch: every parameter and every hidden state moves in a copy of all windows.
        """
        places, offsets, zeta = self._split(x)
        n, nh = self.n, len(zeta)
        steps = np.where(places + STEP > 1.0, -STEP, STEP)
        moved = np.tile(places[:, None], (1, 1 + n + nh))
        moved[np.arange(n), 1 + np.arange(n)] += steps
        starts = np.tile(zeta[:, None], (1, 1 + n + nh, 1))
        starts[np.arange(nh), 1 + n + np.arange(nh)] += STEP
        errors = self._run(moved[:, :, None], offsets, starts)
        by = np.moveaxis(errors[1:] - errors[0], 0, -1) / np.concatenate([steps, np.full(nh, STEP)])
        return errors[0], by[..., :n], by[..., n:]

    def _jacobian(self, x: Array) -> Array:
        """Return the Jacobian of `_values`, of the data and of the priors."""
        _, by_places, by_hidden = self._parts(x)
        windows, m, n = by_places.shape
        k, groups, nh = len(self.varied), self.n_groups, by_hidden.shape[2]
        jacobian = np.zeros((windows, m, len(x)))
        jacobian[..., :n] = by_places
        rows = np.arange(windows)
        for i in range(k):
            jacobian[rows, :, n + self.segments.group * k + i] = by_places[..., self.varied[i]] if groups else 0.0
        for i in range(nh):
            jacobian[rows, :, n + groups * k + i * windows + rows] = by_hidden[..., i]
        return np.concatenate([jacobian.reshape(-1, len(x)), self._prior_jacobian(x)])

    def _prior_jacobian(self, x: Array) -> Array:
        _, spreads = self._guesses
        k = self.n_groups * len(self.varied)
        hidden = len(x) - self.n - k
        each = np.where(self.spreads > 0.0, self.spreads, 1.0)
        weight = self.noise * np.sqrt(self.inflation)
        pulls = [weight / spreads, np.tile(weight / each, self.n_groups)[:k], np.full(hidden, LOOSE)]
        return np.diag(np.concatenate(pulls))
