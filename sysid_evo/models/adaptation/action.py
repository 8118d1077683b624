"""Corrections of the action: gain and offset of every control, fitted by simulation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sysid_evo.data.dataset import Dataset
from sysid_evo.models.adaptation.correction import (
    ROUNDS,
    AdaptationWindows,
    CorrectionTerms,
    damped_step,
    simulate_corrections,
)
from sysid_evo.models.dynamics import Dynamics
from sysid_evo.system import System
from sysid_evo.types import Array

STEP = 1e-3
"""Step of a difference quotient of gains and of offsets in standard deviations of the control."""


@dataclass(frozen=True)
class ActionCorrection:
    """The control gain * u + offset, ``gain`` and ``offset`` (nu,), that a model gets instead of u.

    A weak battery, motor or rudder acts like a smaller command, a bent linkage like another one. History and control
    are corrected in the same way. Limits do not apply, because a stronger motor acts like a command beyond them.
    """

    gain: Array
    offset: Array

    @classmethod
    def none(cls, system: System) -> Self:
        """Return the correction that changes nothing."""
        return cls(np.ones(system.nu), np.zeros(system.nu))

    @property
    def changes(self) -> bool:
        """Whether it changes a control."""
        return bool(np.any(self.gain != 1.0) or np.any(self.offset))

    def __call__(self, controls: Array) -> Array:
        """Return the corrected ``controls`` (..., nu)."""
        return self.gain * controls + self.offset

    def recorded(self, dataset: Dataset) -> Dataset:
        """Return ``dataset`` with corrected controls."""
        return dataset.with_episodes([replace(one, controls=self(one.controls)) for one in dataset])

    def applied(self, model: Dynamics, windows: AdaptationWindows) -> AdaptationWindows:
        """Return ``windows`` that ``model`` simulates under corrected controls."""
        if not self.changes:
            return windows
        draws = np.zeros((len(windows), model.n_draws))
        carry = model.start(windows.past_states, self(windows.past_controls), draws)
        return replace(windows, carry=carry, controls=self(windows.controls))


def action_corrections(
    model: Dynamics,
    terms: CorrectionTerms,
    windows: AdaptationWindows,
    ridges: Sequence[float],
    seconds: float,
) -> Iterator[ActionCorrection]:
    """Yield the correction of the action for each of ``ridges``, which begin with the strongest.

    It minimises the same loss as `sysid_evo.models.adaptation.correction.corrections`; the ridge penalises the squares
    of gain - 1 and of the offset in standard deviations of the control. ``terms`` are those of the recording.
    """
    nu = model.system.nu
    none = np.zeros((1, *terms.shape))
    unit, scale = np.eye(2 * nu).reshape(-1, 2, nu), terms.scale[-nu:]

    def correction(number: Array) -> ActionCorrection:
        return ActionCorrection(1.0 + number[0], number[1] * scale - number[0] * model.system.neutral_control)

    def errors_of(candidates: Array) -> Array:
        moved = (correction(one).applied(model, windows) for one in candidates)
        return np.concatenate([one.errors(simulate_corrections(model, terms, none, one)) for one in moved])

    found = np.zeros((2, nu))
    for ridge in ridges:
        for _ in range(ROUNDS):
            here, *others = errors_of(np.concatenate([found[None], found + STEP * unit])).reshape(1 + 2 * nu, -1)
            slopes = (np.stack(others) - here) / STEP
            found, moved = damped_step(found, here, slopes, errors_of, np.full(found.shape, ridge), seconds)
            if not moved:
                break
        yield correction(found)
