"""The base class of state-space families: an observer in the carry, the step."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from model_zoo.state_space.estimation import StateObserver
from model_zoo.state_space.kernel import state_space_kernel
from model_zoo.state_space.recordings import Scales
from model_zoo.state_space.shooting import DIVERGED_DISTANCE, StateSpaceBatch
from model_zoo.state_space.units import UNITS, values
from sysid_evo.errors import ShapeError
from sysid_evo.kernels import DynamicsKernel
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import MOST_LAGS
from sysid_evo.models.dynamics import rk4
from sysid_evo.models.learned import Declared, Numbers
from sysid_evo.models.parameters import Limit, at_least
from sysid_evo.types import Array

SETTLING = 300
"""Steps after which a body without commands is at rest."""


class StateSpaceModel(DynamicsModel):
    """A family with unmeasured states; the carry is (outputs y, hidden states x of all members).

        x' = outer (x, u, 1, units(inner (x, u, 1))) + gain (y - output x - offset),  y' = output x' + offset

    For a flow the first term is dx/dt, time in samples, and x' is one Runge-Kutta step of it plus the correction. Each
    member has its own states; the output is their weighted mean. In a simulation y is the model's own output, and the
    correction is zero. If y is replaced, by a measurement, a limit or another model, it corrects the hidden states.
    `start` runs this observer over the last ``n_lags_`` samples, except copies of the first state under neutral
    controls; there each member is corrected by the error of its own output, so that members with different errors all
    reach the measured one.
    """

    knowledge = "black"
    model_class = "state space"
    limits: ClassVar[dict[str, Limit]] = {"order": at_least(1), "iterations": at_least(1), "horizon": at_least(2)}

    @property
    def n_lags(self) -> int:
        return int(getattr(self, "n_lags_", 0))

    @property
    def n_carry(self) -> int:
        return self.system.nx + len(self.rest_)

    @property
    def flows(self) -> bool:
        """Whether the model is a differential equation."""
        return bool(getattr(self, "flow_", False))

    def set_learned(
        self, scales: Scales, members: list[StateSpaceBatch], observers: list[StateObserver], weights: Array
    ) -> None:
        """Store the ``members``, each one space, in raw units; the output is their mean with ``weights``."""
        ny = len(scales.output_scale)
        if members[0].flow:
            self.flow_ = True
        self.outer_, self.inner_, self.kinds_ = [], [], [member.kinds[0] for member in members]
        outputs = []
        for member, weight in zip(members, weights, strict=True):
            outer = member.rate_scale[:, None] * member.outer[0]
            if not member.flow:
                outer[:, : member.n] += np.eye(member.n)
            self.outer_.append(_of_raw_controls(outer, member.n, scales))
            self.inner_.append(_of_raw_controls(member.inner[0].copy(), member.n, scales))
            outputs.append(weight * np.diag(scales.output_scale) @ np.eye(ny, member.n))
        self.output_, self.offset_ = np.concatenate(outputs, axis=1), scales.output_centre.copy()
        self.gain_ = np.concatenate([one.gain / scales.output_scale for one in observers])
        first = np.concatenate([one.first for one in observers])
        slope = first[:, :ny] / scales.output_scale
        self.first_ = np.concatenate([slope, (first[:, ny] - slope @ scales.output_centre)[:, None]], axis=1)
        self.n_lags_ = max(one.history for one in observers)
        self.set_rest()

    def set_rest(self) -> None:
        """Store the hidden states after a long time with neutral outputs under neutral controls."""
        neutral, idle = self.system.neutral_state[None], self.system.neutral_control[None]
        hidden = neutral @ self.first_[:, :-1].T + self.first_[:, -1]
        for _ in range(SETTLING):
            hidden = self._observed(neutral, hidden, idle)
        self.rest_ = np.asarray(hidden[0])

    def learned_arrays(self) -> Mapping[str, Declared]:
        ny, nu, n = self.system.nx, self.system.nu, sum(len(outer) for outer in self.outer_)
        sizes = [(len(outer), len(inner)) for outer, inner in zip(self.outer_, self.inner_, strict=True)]
        if any(kinds[:1] == UNITS.index("gate") for kinds in self.kinds_ if len(kinds)):
            raise ShapeError("kinds_: expected no gate first, because a gate multiplies the unit before it")
        return {
            "outer_": [(order, order + nu + 1 + units) for order, units in sizes],
            "inner_": [(units, order + nu + 1) for order, units in sizes],
            "kinds_": [Numbers(units, whole=True, least=0, most=len(UNITS) - 1) for _, units in sizes],
            "output_": (ny, n),
            "offset_": (ny,),
            "gain_": (n, ny),
            "first_": (n, ny + 1),
            "rest_": (n,),
            "n_lags_": Numbers(whole=True, least=0, most=MOST_LAGS),
        }

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        neutral, idle = self.system.neutral_state, self.system.neutral_control
        hidden = states[:, 0] @ self.first_[:, :-1].T + self.first_[:, -1]
        resting = (states[:, 0] == neutral).all(axis=1)
        hidden = np.where(resting[:, None], self.rest_, hidden)
        repeated = np.ones(len(states), dtype=bool)
        for k in range(controls.shape[1]):
            repeated &= (states[:, k] == states[:, 0]).all(axis=1) & (controls[:, k] == idle).all(axis=1)
            after = self._observed(states[:, k], hidden, controls[:, k])
            hidden = np.where(repeated[:, None], hidden, after)
        return np.concatenate([states[:, -1], hidden], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        ny, system = self.system.nx, self.system
        off = carry[:, :ny] - carry[:, ny:] @ self.output_.T - self.offset_
        hidden = self._corrected(carry[:, ny:], control, off @ self.gain_.T)
        after = hidden @ self.output_.T + self.offset_
        if system.limited:
            after = np.clip(after, *system.limits)
        return np.concatenate([after, hidden], axis=1)

    def kernel(self) -> DynamicsKernel | None:
        return self._observing_kernel

    @functools.cached_property
    def _observing_kernel(self) -> DynamicsKernel:
        return state_space_kernel(
            self.system,
            self.outer_,
            self.inner_,
            self.kinds_,
            output=self.output_,
            offset=self.offset_,
            gain=self.gain_,
            far=DIVERGED_DISTANCE,
            flow=self.flows,
        )

    def _corrected(self, hidden: Array, control: Array, correction: Array) -> Array:
        """Return the next hidden states (B, n) after adding the ``correction`` (B, n)."""
        after = rk4(lambda at: self._rates(at, control), hidden, 1.0) if self.flows else self._rates(hidden, control)
        return np.clip(after + correction, -DIVERGED_DISTANCE, DIVERGED_DISTANCE)

    def _observed(self, measured: Array, hidden: Array, control: Array) -> Array:
        """Return the next hidden states (B, n), each member corrected by the error of its own output (B, ny)."""
        if len(self.outer_) == 1:
            return self._corrected(hidden, control, (measured - hidden @ self.output_.T - self.offset_) @ self.gain_.T)
        ends, ny = np.cumsum([len(outer) for outer in self.outer_]), self.system.nx
        firsts = [slice(end - len(outer), end - len(outer) + ny) for end, outer in zip(ends, self.outer_, strict=True)]
        # a member's block in output_ is the map that all have in common, times its weight; weights have sum 1
        output = np.sum([self.output_[:, first] for first in firsts], axis=0)
        errors = [measured - hidden[:, first] @ output.T - self.offset_ for first in firsts]
        gains = np.split(self.gain_, ends[:-1])
        return self._corrected(
            hidden, control, np.concatenate([off @ gain.T for off, gain in zip(errors, gains, strict=True)], axis=1)
        )

    def _rates(self, hidden: Array, control: Array) -> Array:
        """Return the next states (B, n) before any correction, or the rates of a flow."""
        parts, at, ones = [], 0, np.ones((len(hidden), 1))
        for outer, inner, kinds in zip(self.outer_, self.inner_, self.kinds_, strict=True):
            seen = np.concatenate([hidden[:, at : at + len(outer)], control, ones], axis=1)
            units = values(kinds, seen @ inner.T)
            parts.append(np.concatenate([seen, units], axis=1) @ outer.T)
            at += len(outer)
        return np.concatenate(parts, axis=1)


def _of_raw_controls(weights: Array, n: int, scales: Scales) -> Array:
    """Return weights (r, n + nu + 1 + ...) of (x, u, 1, ...) for controls in raw units."""
    nu = len(scales.control_scale)
    weights[:, n : n + nu] /= scales.control_scale
    weights[:, n + nu] -= weights[:, n : n + nu] @ scales.control_centre
    return weights
