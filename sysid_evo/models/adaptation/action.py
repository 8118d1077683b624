"""Corrections of the action: gain and offset of every control, and a common delay, fitted by simulation."""

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
"""Step of a difference quotient of gains, offsets in standard deviations of the control, and delays in units."""
DELAY_UNIT = 3.0
"""Samples of delay that have the ridge penalty of a gain of 2."""


@dataclass(frozen=True)
class ActionCorrection:
    """The control gain * v + offset, ``gain`` and ``offset`` (nu,), that a model gets instead of u.

    v = (1 - delay) u[k] + delay u[k - 1], with a ``delay`` of 0 to 1 sample. A weak battery, motor or rudder acts like
    a smaller command, a bent linkage like another one, a slower link or servo like a later one. History and control are
    corrected in the same way. Limits do not apply, because a stronger motor acts like a command beyond them.
    """

    gain: Array
    offset: Array
    delay: float = 0.0

    @classmethod
    def none(cls, system: System) -> Self:
        """Return the correction that changes nothing."""
        return cls(np.ones(system.nu), np.zeros(system.nu))

    @property
    def changes(self) -> bool:
        """Whether it changes a control."""
        return bool(np.any(self.gain != 1.0) or np.any(self.offset) or self.delay)

    @property
    def memory(self) -> int:
        """Number of earlier controls that the carry of a corrected model contains: 1 with a delay."""
        return int(self.delay > 0.0)

    def __call__(self, controls: Array) -> Array:
        """Return the corrected ``controls`` (..., T, nu), one after another; the first repeats with a delay."""
        if not self.delay:
            return self.gain * controls + self.offset
        return self.of(controls, np.concatenate([controls[..., :1, :], controls[..., :-1, :]], axis=-2))

    def of(self, control: Array, before: Array) -> Array:
        """Return the corrected ``control`` (..., nu) after the one ``before``."""
        return self.gain * ((1.0 - self.delay) * control + self.delay * before) + self.offset

    def history(self, states: Array, controls: Array) -> tuple[Array, Array]:
        """Return the history with corrected ``controls`` (B, L, nu), `memory` samples shorter."""
        return states[:, self.memory :], self(controls)[:, self.memory :]

    def split(self, carry: Array, control: Array) -> tuple[Array, Array]:
        """Return the carry of the uncorrected model, and the corrected ``control`` (B, nu)."""
        if not self.memory:
            return carry, self(control)
        nu = control.shape[1]
        return carry[:, :-nu], self.of(control, carry[:, -nu:])

    def joined(self, carry: Array, controls: Array) -> Array:
        """Return the ``carry`` of the uncorrected model with the last of ``controls`` (B, T, nu), if it is needed."""
        return np.concatenate([carry, controls[:, -1]], axis=1) if self.memory else carry

    def recorded(self, dataset: Dataset) -> Dataset:
        """Return ``dataset`` with corrected controls."""
        return dataset.with_episodes([replace(one, controls=self(one.controls)) for one in dataset])

    def applied(self, model: Dynamics, windows: AdaptationWindows) -> AdaptationWindows:
        """Return ``windows`` that ``model`` simulates under corrected controls."""
        if not self.changes:
            return windows
        draws = np.zeros((len(windows), model.n_draws))
        controls = self(np.concatenate([windows.past_controls, windows.controls], axis=1))
        past = windows.past_controls.shape[1]
        carry = model.start(windows.past_states, controls[:, 1:past], draws)
        return replace(windows, carry=carry, controls=controls[:, past:])


def action_corrections(
    model: Dynamics,
    terms: CorrectionTerms,
    windows: AdaptationWindows,
    ridges: Sequence[float],
    seconds: float,
    *,
    delayed: bool = False,
) -> Iterator[ActionCorrection]:
    """Yield the correction of the action for each of ``ridges``, which begin with the strongest.

    It minimises the same loss as `sysid_evo.models.adaptation.correction.corrections`; the ridge penalises the squares
    of gain - 1, of the offset in standard deviations of the control and, if the action may be ``delayed``, of the delay
    in units of `DELAY_UNIT`. ``terms`` are those of the recording.
    """
    nu = model.system.nu
    none = np.zeros((1, *terms.shape))
    scale, found = terms.scale[-nu:], np.zeros(2 * nu + delayed)

    def correction(numbers: Array) -> ActionCorrection:
        gain, offset = numbers[: 2 * nu].reshape(2, nu)
        delay = float(np.clip(DELAY_UNIT * numbers[2 * nu], 0.0, 1.0)) if delayed else 0.0
        return ActionCorrection(1.0 + gain, offset * scale - gain * model.system.neutral_control, delay)

    def errors_of(candidates: Array) -> Array:
        moved = (correction(one).applied(model, windows) for one in candidates)
        return np.concatenate([one.errors(simulate_corrections(model, terms, none, one)) for one in moved])

    for ridge in ridges:
        for _ in range(ROUNDS):
            here, *others = errors_of(np.concatenate([found[None], found + STEP * np.eye(len(found))]))
            slopes = (np.stack(others) - here).reshape(len(found), -1) / STEP
            found, moved = damped_step(found, here.ravel(), slopes, errors_of, np.full(found.shape, ridge), seconds)
            if not moved:
                break
        yield correction(found)
