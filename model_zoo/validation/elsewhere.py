"""The spread of a model in another condition, from the parts of its recording that it did not learn from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from model_zoo.validation.horizons import MOST_WINDOWS, Case, horizon_scales, persistent_share, usable_horizon
from model_zoo.validation.uncertain import Uncertain
from sysid_evo.adaptation import Learned, Terms
from sysid_evo.arrays import Array
from sysid_evo.system import System

APART = 10
"""Steps between two recordings when samples are numbered, more than noise is remembered."""


@dataclass(frozen=True)
class CorrectedSteps:
    """The disturbed steps of ``base`` with a correction, which sees what the disturbance makes of them."""

    base: Uncertain
    terms: Terms
    coefficients: Array

    @property
    def n_lags(self) -> int:
        return self.base.n_lags

    @property
    def system(self) -> System:
        return self.base.system

    @property
    def envelope(self) -> Array | None:
        return self.base.envelope

    def lagged(self, states: Array, controls: Array) -> Array:
        return self.base.lagged(states, controls)

    def disturbed(self, carry: Array, control: Array, disturbance: Array) -> Array:
        after, nx = self.base.disturbed(carry, control, disturbance), self.system.nx
        moved = self.terms.corrected(carry[:, :nx], control, after[:, :nx], self.coefficients)
        return np.concatenate([moved, after[:, nx:]], axis=1)


def calibrated_elsewhere(base: Uncertain, apart: Sequence[Learned], rng: np.random.Generator) -> Uncertain:
    """Return ``base`` with the spread that models have which were made ``apart``, each on what it was ``held`` from.

    The error of one step, its lasting share, and the scales of `horizon_scales`; beyond the longest free run that the
    held parts have room for the last scale holds.
    """
    pairs = [
        (CorrectedSteps(one.model.variant(), one.terms, one.coefficients), one.held)
        for one in apart
        if isinstance(one.model, Uncertain) and one.held is not None
    ]
    errors, numbers, begin = [], [], 0
    for steps, held in pairs:
        windows = held.windows(1, history=steps.n_lags)
        carry = steps.lagged(windows.past_states, windows.past_controls)
        after = steps.disturbed(carry, windows.controls[:, 0], np.zeros_like(windows.states[:, 0]))
        errors.append(base.system.difference(windows.states[:, 0], after[:, : base.system.nx]))
        longest = max(len(episode) for episode in held) + APART
        numbers.append(begin + windows.start + windows.episode * longest)
        begin += longest * len(held)
    pooled = np.concatenate(errors)
    residual, persistent = np.sqrt(np.mean(pooled**2, axis=0)), persistent_share(pooled, np.concatenate(numbers))
    horizon = usable_horizon([held for _, held in pairs], base.n_lags)
    for steps, _ in pairs:
        steps.base.residual_ = residual
    cases = [Case.of(steps, held, horizon, MOST_WINDOWS // len(pairs)) for steps, held in pairs]
    other = base.variant()
    other.keep_spread(residual, persistent, horizon_scales(cases, persistent, rng))
    return other
