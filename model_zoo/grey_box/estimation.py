"""Least squares of simulations in windows, from several starts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from model_zoo.grey_box.equation import GreyBoxEquation, kernel_parameters, propagate_hidden, structure_kernel
from model_zoo.grey_box.parameters import Parameter, ParameterBounds, parameter_covariance
from model_zoo.scaling import positive
from sysid_evo.data import Dataset, Windows
from sysid_evo.engine.compiled.open_loop import free_runs
from sysid_evo.errors import InvalidData
from sysid_evo.models.dynamics import enough
from sysid_evo.processors import resolve
from sysid_evo.types import Array, IntArray

STEP = 1e-3
"""Step of a difference quotient, as a share of the bounds: far above the rounding of float32."""
INITIAL_STATE_WEIGHT = 0.02
"""Weight of the prior of a hidden initial state, whose deviation is a quarter of its range, against one error."""
GUESS_STD = 0.5
"""Standard deviation of a guess in the cube: undetermined parameters stay near it, and the search converges."""
NOISE = 0.1
"""Assumed error, in spreads of the state, before it is estimated."""
MAX_ERROR = 1e3
"""Errors are limited to this many spreads of the state."""
HUBER_ERROR = 1.5
"""In a robust fit, errors above this many deviations count linearly (Huber's rule of thumb, rounded up)."""


@dataclass(frozen=True)
class LeastSquaresFit:
    """Points in the cube of bounds (n,), hidden initial states (nh, W), weighted errors, Jacobian.

    ``errors`` (W, m), ``jacobian`` (W, m, n) and ``by_hidden`` (W, m, nh) are those of the data, without priors.
    """

    places: Array
    hidden: Array
    cost: float
    errors: Array
    jacobian: Array
    by_hidden: Array


@dataclass(frozen=True)
class LeastSquares:
    """Simulation errors in ``windows`` as a function of all unknowns.

    Parameters with a ``spread`` have a prior at their guess; ``inflation`` correlated errors count as one. ``report``
    is called before each evaluation.
    """

    structure: GreyBoxEquation
    windows: FitWindows
    report: Callable[[], None]
    robust: bool = False
    noise: float = NOISE
    inflation: float = 1.0

    @cached_property
    def n(self) -> int:
        """Number of parameters."""
        return len(self.structure.parameters)

    @property
    def _hidden_scale(self) -> tuple[Array, Array]:
        hidden = self.structure.hidden
        return np.array([h.initial for h in hidden]), np.array([0.25 * (h.high - h.low) for h in hidden])

    @cached_property
    def _guesses(self) -> tuple[Array, Array]:
        """Guess of each parameter in the cube, and its standard deviation, (n,) each."""
        parameters, box = self.structure.parameters, self.structure.box
        places = box.places(np.array([p.guess for p in parameters]))
        known = np.array([p.spread or np.inf for p in parameters]) / box.slopes(places)
        return places, np.minimum(known, GUESS_STD)

    def cost(self, places: Array) -> Array:
        """Return the mean square error (P,) at points (P, n), with hidden states propagated through the history."""
        self.report()
        p = self.structure.box.values(places).T[:, :, None]
        errors = self._bounded(
            self.windows.errors(self.structure, p, self.windows.hidden_from_history(self.structure, p))
        )
        return np.asarray(np.mean(np.minimum(errors**2, 1.0), axis=(1, 2)))

    def solve(self, places: Array, *, evaluations: int) -> LeastSquaresFit:
        """Return the least squares from a start, with hidden states propagated through the history."""
        structure, box = self.structure, self.structure.box
        low, width = self._hidden_scale
        p = box.values(places)[:, None, None]
        hidden = np.broadcast_to(
            self.windows.hidden_from_history(structure, p), (len(structure.hidden), 1, len(self.windows))
        )[:, 0]
        zeta = (hidden - low[:, None]) / width[:, None] if len(structure.hidden) else hidden
        start = np.concatenate([np.clip(places, 1e-6, 1.0 - 1e-6), zeta.ravel()])
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
            f_scale=HUBER_ERROR * size,
            max_nfev=evaluations,
            xtol=1e-5,
            ftol=1e-5,
            gtol=1e-9,
        )
        errors, jacobian, by_hidden = self._parts(found.x)
        if self.robust:
            weight = (1.0 + (errors / (HUBER_ERROR * size)) ** 2) ** -0.25
            errors, jacobian = weight * errors, weight[..., None] * jacobian
            by_hidden = weight[..., None] * by_hidden
        own, zeta = self._split(found.x)
        return LeastSquaresFit(
            own, low[:, None] + width[:, None] * zeta, float(found.cost), errors, jacobian, by_hidden
        )

    def _typical(self, x: Array) -> float:
        """Return the deviation of the errors at ``x``, robust to outliers: 1.48 median absolute errors."""
        off = np.abs(self._values(x)[: self.windows.cut.states[0].size * len(self.windows)])
        return max(1.4826 * float(np.median(off)), 1e-9)

    def _split(self, x: Array) -> tuple[Array, Array]:
        """Return points (n,) and hidden initial states (nh, W) in units of their width."""
        return x[: self.n], x[self.n :].reshape(-1, len(self.windows))

    def _run(self, places: Array, zeta: Array) -> Array:
        """Return the errors (P, W, m) at points (n, P, 1) and hidden initial states (nh, P, W)."""
        self.report()
        low, width = (side[:, None, None] for side in self._hidden_scale)
        p = np.moveaxis(self.structure.box.values(np.moveaxis(places, 0, -1)), -1, 0)
        return self._bounded(self.windows.errors(self.structure, p, low + width * zeta))

    @staticmethod
    def _bounded(errors: Array) -> Array:
        return np.clip(np.nan_to_num(errors, nan=MAX_ERROR, posinf=MAX_ERROR, neginf=-MAX_ERROR), -MAX_ERROR, MAX_ERROR)

    def _values(self, x: Array) -> Array:
        places, zeta = self._split(x)
        errors = self._run(places[:, None, None], zeta[:, None])
        return np.concatenate([errors.ravel(), self._priors(x)])

    def _priors(self, x: Array) -> Array:
        """Return the residuals of the priors: known parameters, hidden states at rest."""
        places, zeta = self._split(x)
        guesses, spreads = self._guesses
        weight = self.noise * np.sqrt(self.inflation)
        return np.concatenate([weight * (places - guesses) / spreads, INITIAL_STATE_WEIGHT * zeta.ravel()])

    def _parts(self, x: Array) -> tuple[Array, Array, Array]:
        """Return errors (W, m) and their derivatives by points (W, m, n) and by hidden initial states (W, m, nh).

        All differences are one batch: every parameter and hidden state is varied in a copy of all windows.
        """
        places, zeta = self._split(x)
        n, nh = self.n, len(zeta)
        steps = np.where(places + STEP > 1.0, -STEP, STEP)
        moved = np.tile(places[:, None], (1, 1 + n + nh))
        moved[np.arange(n), 1 + np.arange(n)] += steps
        starts = np.tile(zeta[:, None], (1, 1 + n + nh, 1))
        starts[np.arange(nh), 1 + n + np.arange(nh)] += STEP
        errors = self._run(moved[:, :, None], starts)
        by = np.moveaxis(errors[1:] - errors[0], 0, -1) / np.concatenate([steps, np.full(nh, STEP)])
        return errors[0], by[..., :n], by[..., n:]

    def _jacobian(self, x: Array) -> Array:
        """Return the Jacobian of `_values`, for data and priors."""
        _, by_places, by_hidden = self._parts(x)
        windows, m, n = by_places.shape
        nh = by_hidden.shape[2]
        jacobian = np.zeros((windows, m, len(x)))
        jacobian[..., :n] = by_places
        rows = np.arange(windows)
        for i in range(nh):
            jacobian[rows, :, n + i * windows + rows] = by_hidden[..., i]
        return np.concatenate([jacobian.reshape(-1, len(x)), self._prior_jacobian(x)])

    def _prior_jacobian(self, x: Array) -> Array:
        _, spreads = self._guesses
        weight = self.noise * np.sqrt(self.inflation)
        return np.diag(np.concatenate([weight / spreads, np.full(len(x) - self.n, INITIAL_STATE_WEIGHT)]))


FEWEST = 60
"""Number of windows of a short recording, which then overlap."""


@dataclass(frozen=True)
class FitWindows:
    """W windows of H steps with their measurements.

    Errors are in units of ``scale`` (nx,), the spread of every state; simulations are clipped to ``limits`` (2, nx);
    ``order`` (W,) is the start of each window in steps since the first episode began.
    """

    cut: Windows
    scale: Array
    limits: Array
    order: IntArray

    @classmethod
    def of(cls, dataset: Dataset, horizon: int, *, history: int, most: int, limits: Array) -> FitWindows:
        """Cut up to ``most`` windows, evenly over the moving parts of the recording; they overlap if there are few."""
        longest = max(len(episode) for episode in dataset.episodes) - history
        if longest < 1:
            raise InvalidData(f"data set: expected an episode longer than the history of {history} steps, got none")
        horizon = min(horizon, longest)
        room = sum(max(0, len(episode) - history - horizon + 1) for episode in dataset.episodes)
        stride = max(1, min(horizon, room // FEWEST))
        places = dataset.find_windows(horizon, stride=stride, history=history, moving=True)
        if len(places) < FEWEST // 2:
            places = dataset.find_windows(horizon, stride=stride, history=history)
        rows = np.unique(np.linspace(0, len(places) - 1, min(most, len(places))).round().astype(np.int64))
        windows = places[rows]
        begins = np.cumsum([0, *(len(episode) for episode in dataset.episodes)])[:-1]
        scale = positive(dataset.system.spread(np.concatenate([episode.states for episode in dataset.episodes])))
        return cls(windows, scale, limits, begins[windows.episode] + windows.start)

    def __len__(self) -> int:
        return len(self.cut)

    def runs(self, structure: GreyBoxEquation, p: Array, hidden: Array) -> Array:
        """Return simulations (P, W, H, nx) with parameters (n, P, 1), from ``hidden`` states (n, P or 1, W).

        They are compiled if the motion has a compiled form, unless `SYSID_EVO_ENGINE` selects the reference.
        """
        w = self.cut
        with np.errstate(all="ignore"):
            carry = structure.start(p, w.past_states, w.past_controls, hidden)
            carry = np.broadcast_to(carry, (len(carry), *np.broadcast_shapes(p.shape[1:], carry.shape[1:])))
            guess = np.array([parameter.guess for parameter in structure.parameters])
            kernel = None if resolve() == "reference" else structure_kernel(structure, guess)
            if kernel is None:
                return self._stepped(structure, p, carry)
        own = kernel_parameters(structure, p[:, :, 0].T)
        start = np.moveaxis(carry, 0, -1)
        return free_runs(
            kernel.source,
            kernel.n_scratch,
            kernel.of_candidates(own),
            start,
            w.controls,
            self.limits,
            precision=enough(kernel.precision, self.limits),
        )

    def _stepped(self, structure: GreyBoxEquation, p: Array, carry: Array) -> Array:
        """Return the simulations in NumPy, from carries (n_carry, P, W)."""
        controls, nx = self.cut.controls, structure.system.nx
        low, high = (side.reshape(-1, 1, 1) for side in self.limits)
        out = np.empty((*carry.shape[1:], controls.shape[1], nx))
        for k in range(controls.shape[1]):
            after, past = structure.step(p, carry, controls[:, k].T[:, None])
            after[:nx] = np.fmin(np.fmax(after[:nx], low), high)
            after[nx:] = np.nan_to_num(after[nx:])
            carry, out[:, :, k] = np.concatenate([after, past]), np.moveaxis(after[:nx], 0, -1)
        return out

    def errors(self, structure: GreyBoxEquation, p: Array, hidden: Array) -> Array:
        """Return the errors (P, W, H * nx) of these runs in units of ``scale``, of angles the shortest way round."""
        off = structure.system.difference(self.runs(structure, p, hidden), self.cut.states) / self.scale
        return off.reshape(*off.shape[:2], -1)

    def hidden_from_history(self, structure: GreyBoxEquation, p: Array) -> Array:
        """Return the hidden states (n, P, W) at the start of the windows, propagated through the history from rest."""
        w, rows = self.cut, structure.hidden_rows
        rest = np.array([hidden.initial for hidden in structure.hidden])[:, None, None]
        with np.errstate(all="ignore"):
            found = propagate_hidden(structure, p, w.past_states, w.past_controls, rest)
        low, high = structure.extended.limits[:, rows, None, None]
        return np.clip(np.nan_to_num(found), low, high)


SCREENED = 48
"""Random points of the cube that are evaluated; the best are starts."""
FIRST_EVALUATIONS, LAST_EVALUATIONS = 40, 100
FINAL_STARTS = 2
"""Starts of the last fit: the best results of the first one."""


def starts_of(first: LeastSquares, count: int, rng: np.random.Generator) -> list[Array]:
    """Return the guess and the best of many random points of the cube, ``count`` in all."""
    box = first.structure.box
    guess = box.places(np.array([parameter.guess for parameter in first.structure.parameters]))
    drawn = rng.uniform(size=(SCREENED, len(guess)))
    costs = np.concatenate([first.cost(part) for part in np.array_split(drawn, SCREENED // 8)])
    return [guess, *drawn[np.argsort(costs, kind="stable")[: count - 1]]]


def best_of(last: LeastSquares, results: Sequence[Array]) -> LeastSquaresFit:
    """Return the best least squares from the best of these results of the first fit."""
    costs = [float(last.cost(place[None])[0]) for place in results]
    found: list[LeastSquaresFit] = []
    for i in np.argsort(costs, kind="stable"):
        if all(np.abs(results[i] - one.places).max() > 1e-3 for one in found) and len(found) < FINAL_STARTS:
            found.append(last.solve(results[i], evaluations=LAST_EVALUATIONS))
    return min(found, key=lambda one: one.cost)


def covariance_of(problem: LeastSquares, best: LeastSquaresFit) -> tuple[Array, float, float]:
    """Return the `parameter_covariance` at the end of a fit."""
    known = prior_variances(problem.structure.parameters, best.places)
    return parameter_covariance(best.errors, best.jacobian, best.by_hidden, problem.windows.order, known=known)


def prior_variances(parameters: Sequence[Parameter], places: Array) -> Array:
    """Return the variance (n,) of each parameter in the cube without data: of its prior, or of its bounds alone."""
    slopes = ParameterBounds(parameters).slopes(places)
    spreads = np.array([math.inf if p.spread is None else p.spread for p in parameters]) / slopes
    return np.minimum(spreads**2, 1.0 / 12.0)
