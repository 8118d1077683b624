"""The timing of logged controls: whether a step depends on the control logged before it or after it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain, combinations_with_replacement

import numpy as np

from sysid_evo.data.dataset import Dataset
from sysid_evo.data.preparation import is_filtered
from sysid_evo.data.response import acting_controls, state_terms
from sysid_evo.data.trajectory import Windows, evenly_spaced
from sysid_evo.system import System
from sysid_evo.types import Array, IntArray

CLEAR = 1.05
"""Least ratio of the errors at which a timing is `ControlTiming.simultaneous`.

In `tests.benchmarks.simultaneous` all records of the usual timing have at most 1.01. The others have at least 1.12,
except for two kinds on which the later control hardly acts.
"""

HORIZON = 4
"""Steps of a simulation: a wrong timing shows at once, and later the errors of the polynomials hide it."""
LAGS, DEGREES, NEAR = (1, 8), (1, 2, 3), 2
"""Samples of history and degrees of the polynomials, and the number of latest samples of which products are formed."""
MOST_TERMS, STEPS_PER_TERM = 300, 8
"""Most terms of a polynomial, and least number of steps for each; larger polynomials are left out."""
MOST_STEPS, MOST_STARTS, FEWEST_STARTS = 4000, 1000, 50
"""Most steps to fit to, and number of simulations."""
FOLDS, PARTS = 4, 8
"""Number of folds, and of the consecutive parts of the data that are assigned to them in turn."""
RIDGE = 1e-9
REACH = 2.0
"""Simulated states stay within this many times half their recorded range from its middle."""


@dataclass(frozen=True)
class ControlTiming:
    """Simulation errors on held-out data with the control logged ``before`` each step, and with that ``after`` it.

    They are means over simulations of the root mean square error, in standard deviations of the states, each of the
    best of several polynomials.
    """

    before: float
    after: float

    @property
    def ratio(self) -> float:
        """The error with the control before each step, in units of that with the control after it."""
        return self.before / max(self.after, float(np.finfo(float).tiny))

    @property
    def simultaneous(self) -> bool:
        """Whether the control logged after each step is clearly better."""
        return self.ratio >= CLEAR


def control_timing(dataset: Dataset) -> ControlTiming | None:
    """Return the errors of both timings; None for too few steps, or where the comparison means nothing.

    Polynomials in the latest states and controls are fitted by least squares to three of four folds and simulate the
    other one, for the data set and for `Dataset.advanced`. Not compared are samples that look ahead, because they were
    filtered (`is_filtered`) or are velocities of a body with a pose, which are differentiated positions, and
    recordings of environments, whose timing is known. Feedback from noisy states can look like simultaneous sampling.
    """
    system = dataset.system
    looks_ahead = system.motion is not None or is_filtered(dataset.notes)
    kept = [episode for episode in dataset if len(episode) > 1 and episode.rewards is None]
    if not system.nu or system.advance or looks_ahead or len(kept) < len(dataset):
        return None
    before = _simulation_error(dataset.with_episodes([episode[:-1] for episode in kept]))
    after = _simulation_error(dataset.advanced())
    return None if before is None or after is None else ControlTiming(before, after)


def _simulation_error(dataset: Dataset) -> float | None:
    """Return the lowest error of the polynomials over `HORIZON` steps, None for too few steps."""
    places = dataset.find_windows(HORIZON, history=max(LAGS) - 1)
    if len(places) < FEWEST_STARTS:
        return None
    parts = PARTS * np.stack([places.place, places.place + HORIZON - 1]) // (places.place[-1] + HORIZON)
    whole = np.flatnonzero(parts[0] == parts[1])
    steps = whole[evenly_spaced(len(whole), MOST_STEPS)]
    moving = np.flatnonzero(np.concatenate(dataset.moving)[places.place[steps]])
    starts = moving[evenly_spaced(len(moving), MOST_STARTS)]
    if len(starts) < FEWEST_STARTS:
        return None
    windows, folds = places[steps], parts[0][steps] % FOLDS
    polynomials = [_Polynomial(dataset.system, lags, degree) for lags in LAGS for degree in DEGREES]
    errors = [one.held_out_error(windows, folds, starts) for one in polynomials if one.is_small(windows)]
    return min(errors, default=None)


@dataclass(frozen=True)
class _Polynomial:
    """A polynomial for the change of the states, linear in ``lags`` samples and of ``degree`` in the latest two."""

    system: System
    lags: int
    degree: int

    def is_small(self, windows: Windows) -> bool:
        """Return whether it has few terms for the number of ``windows``."""
        terms = self.terms(windows.past_states[:1], windows.past_controls[:1], windows.controls[:1, 0]).shape[1]
        return terms <= min(MOST_TERMS, len(windows) // STEPS_PER_TERM)

    def terms(self, states: Array, past_controls: Array, control: Array) -> Array:
        """Return the terms (N, any) of a step under ``control`` (N, nu), after ``states`` and ``past_controls``."""
        latest = [states[:, -1 - age] for age in range(self.lags)]
        controls = [control, *(past_controls[:, -age] for age in range(1, self.lags))]
        columns = [state_terms(self.system, state) for state in latest]
        bases = np.concatenate([*columns[:NEAR], *controls[:NEAR]], axis=1)
        columns += [acting_controls(self.system, states[:, -1], one) for one in controls]
        orders = (combinations_with_replacement(range(bases.shape[1]), n) for n in range(2, self.degree + 1))
        products = [np.prod(bases[:, list(factors)], axis=1)[:, None] for factors in chain.from_iterable(orders)]
        return np.concatenate([np.ones((len(states), 1)), *columns, *products], axis=1)

    def held_out_error(self, windows: Windows, folds: IntArray, starts: IntArray) -> float:
        """Return the error of simulations of the windows ``starts``, each by a fit without its fold."""
        system = self.system
        terms = self.terms(windows.past_states, windows.past_controls, windows.controls[:, 0])
        size = np.sqrt(np.mean(terms**2, axis=0))
        size = np.where(size > 0.0, size, 1.0)
        terms = terms / size
        changes = system.acceleration(windows.start_states, windows.states[:, 0])
        total = 0.0
        for fold in range(FOLDS):
            others, held = folds != fold, starts[folds[starts] == fold]
            square = terms[others].T @ terms[others] + RIDGE * len(terms) * np.eye(terms.shape[1])
            weights = np.linalg.solve(square, terms[others].T @ changes[others]) / size[:, None]
            total += float(np.sum(self._errors(windows[held], weights, windows)))
        return total / len(starts)

    def _errors(self, held: Windows, weights: Array, recorded: Windows) -> Array:
        """Return the error of each simulated window (N,), in standard deviations of the ``recorded`` states."""
        system = self.system
        deviation = system.spread(recorded.start_states)
        low, high = recorded.start_states.min(axis=0), recorded.start_states.max(axis=0)
        middle, reach = 0.5 * (low + high), REACH * 0.5 * (high - low)
        for i in system.periods:
            reach[i] = np.inf
        states, past_controls, squares = held.past_states, held.past_controls, np.zeros(len(held))
        for step in range(HORIZON):
            control = held.controls[:, step]
            after = system.integrate(states[:, -1], self.terms(states, past_controls, control) @ weights)
            after = np.clip(after, middle - reach, middle + reach)
            off = system.difference(after, held.states[:, step]) / np.where(deviation > 0.0, deviation, 1.0)
            squares += np.sum(off**2, axis=1)
            states = np.concatenate([states[:, 1:], after[:, None]], axis=1)
            past_controls = np.concatenate([past_controls[:, 1:], control[:, None]], axis=1)
        return np.asarray(np.sqrt(squares / (HORIZON * system.nx)))
