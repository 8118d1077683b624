"""The base class of state-space families: an observer in the carry, the step, its compiled form."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from model_zoo.state_space.estimation import StateObserver
from model_zoo.state_space.recordings import Scales
from model_zoo.state_space.shooting import DIVERGED_DISTANCE, StateSpaceBatch
from model_zoo.state_space.units import BOUND, SHARP_WIDTH, UNITS, values
from sysid_evo.errors import ShapeError
from sysid_evo.kernels import (
    CACHE_LINE,
    LANES,
    DynamicsKernel,
    KernelSource,
    Layout,
    load,
    padded,
    splat,
    store,
    view,
)
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import MOST_LAGS
from sysid_evo.models.dynamics import rk4
from sysid_evo.models.kernels.stepping import copy
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
        self._set_rest()

    def _set_rest(self) -> None:
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
        system, blocks, at = self.system, list[Array](), 0
        for outer, inner, kinds in zip(self.outer_, self.inner_, self.kinds_, strict=True):
            n, count = len(outer), len(inner)
            numbers = padded(np.concatenate([kinds, inner.ravel(), outer.ravel(), self.gain_[at : at + n].ravel()]))
            blocks.append(MEMBER.pack(numbers, n=n, units=count, next=MEMBER.size + len(numbers)))
            at += n
        parts = [
            padded(np.concatenate([self.offset_, self.output_.ravel()])),
            padded(np.ravel(system.limits) if system.limited else np.empty(0)),
        ]
        places = np.cumsum([HEAD.size, *(len(part) for part in parts)])
        parameters = HEAD.pack(
            *parts,
            *blocks,
            ny=system.nx,
            nu=system.nu,
            n=at,
            members=len(self.outer_),
            far=DIVERGED_DISTANCE,
            limited=system.limited,
            output=places[0],
            limits=places[1],
            own=places[2],
        )
        room = system.nx + at + max((len(one) for one in self.inner_), default=0)
        if self.flows:
            return DynamicsKernel(KernelSource(flow_step), parameters, room + system.nx + 2 * at)
        return DynamicsKernel(KernelSource(step), parameters, room)

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


HEAD = Layout("ny", "nu", "n", "members", "far", "limited", "output", "limits", "own", align=CACHE_LINE)
MEMBER = Layout("n", "units", "next", align=CACHE_LINE)

UNBOUNDED = 1e30
"""Larger than any rate."""


def flow_step(carry, control, noise, parameters, scratch):
    """Step every member by a Runge-Kutta step, correct by the output error, and write the output."""
    ny, nu, n = int(parameters[HEAD.ny]), int(parameters[HEAD.nu]), int(parameters[HEAD.n])
    states, fresh = view(carry, ny * LANES), view(scratch, ny * LANES)
    none, trial, slope = view(fresh, n * LANES), view(fresh, (n + ny) * LANES), view(fresh, (2 * n + ny) * LANES)
    room, output = view(fresh, (3 * n + ny) * LANES), view(parameters, int(parameters[HEAD.output]))
    off_by(carry, output, ny, n, scratch)
    for row in range(ny):
        store(none, row * LANES, splat(0.0))
    at, place, far = 0, int(parameters[HEAD.own]), parameters[HEAD.far]
    for _ in range(int(parameters[HEAD.members])):
        own = view(parameters, place)
        begin, after, count = view(states, at * LANES), view(fresh, at * LANES), int(own[MEMBER.n])
        copy(begin, trial, count * LANES)
        copy(begin, after, count * LANES)
        for stage in range(4):
            advance(trial, control, none, own, ny, nu, UNBOUNDED, slope, room)
            weight = 1.0 / 6.0 if stage == 0 or stage == 3 else 1.0 / 3.0
            ahead = 1.0 if stage == 2 else 0.5
            for row in range(count):
                rate = load(slope, row * LANES)
                store(after, row * LANES, load(after, row * LANES) + splat(weight) * rate)
                store(trial, row * LANES, load(begin, row * LANES) + splat(ahead) * rate)
        correct(after, scratch, own, ny, nu, far)
        at += count
        place += int(own[MEMBER.next])
    conclude(carry, parameters, ny, n, scratch)


def step(carry, control, noise, parameters, scratch):
    """Correct by the output error, step every member, and write the output."""
    ny, nu, n = int(parameters[HEAD.ny]), int(parameters[HEAD.nu]), int(parameters[HEAD.n])
    states, fresh = view(carry, ny * LANES), view(scratch, ny * LANES)
    room, output = view(scratch, (ny + n) * LANES), view(parameters, int(parameters[HEAD.output]))
    off_by(carry, output, ny, n, scratch)
    at, place, far = 0, int(parameters[HEAD.own]), parameters[HEAD.far]
    for _ in range(int(parameters[HEAD.members])):
        own = view(parameters, place)
        advance(view(states, at * LANES), control, scratch, own, ny, nu, far, view(fresh, at * LANES), room)
        at += int(own[MEMBER.n])
        place += int(own[MEMBER.next])
    conclude(carry, parameters, ny, n, scratch)


def off_by(carry, output, ny, n, off):
    """Write the differences between the outputs and those of the hidden states."""
    observe(view(carry, ny * LANES), output, ny, n, off)
    for row in range(ny):
        store(off, row * LANES, load(carry, row * LANES) - load(off, row * LANES))


def conclude(carry, parameters, ny, n, scratch):
    """Write the carry from the next hidden states, which follow the outputs in scratch."""
    observe(view(scratch, ny * LANES), view(parameters, int(parameters[HEAD.output])), ny, n, scratch)
    if parameters[HEAD.limited] > 0.0:
        limits = view(parameters, int(parameters[HEAD.limits]))
        for row in range(ny):
            there = load(scratch, row * LANES)
            store(scratch, row * LANES, min(max(there, limits[row]), limits[ny + row]))
    copy(scratch, carry, (ny + n) * LANES)


def observe(states, p, ny, n, y):
    """Write the outputs of all states; p: offsets, then one row of weights for each output."""
    for row in range(ny):
        out = splat(p[row])
        weights = view(p, ny + row * n)
        for i in range(n):
            out = out + weights[i] * load(states, i * LANES)
        store(y, row * LANES, out)


def advance(x, u, off, p, ny, nu, far, after, room):
    """Write the next states of one member, corrected by ``off``."""
    n, count = int(p[MEMBER.n]), int(p[MEMBER.units])
    seen = n + nu + 1
    width = seen + count
    first = MEMBER.size + count
    for j in range(count):
        weights = view(p, first + j * seen)
        inside = splat(weights[seen - 1])
        for i in range(n):
            inside = inside + weights[i] * load(x, i * LANES)
        for i in range(nu):
            inside = inside + weights[n + i] * load(u, i * LANES)
        kind = p[MEMBER.size + j]
        if kind == 0.0:
            store(room, j * LANES, math.tanh(inside))
        elif kind < 3.0:
            wide = 1.0 if kind == 1.0 else SHARP_WIDTH
            store(room, j * LANES, 0.5 * (math.sqrt(inside * inside + wide * wide) - wide))
        elif kind == 3.0:
            inside = min(max(inside, -BOUND), BOUND)
            store(room, j * LANES, inside * inside * inside * (1.0 / 3.0))
        else:
            store(room, j * LANES, min(max(inside, -BOUND), BOUND) * load(room, (j - 1) * LANES))
    outer, gain = view(p, first + count * seen), view(p, first + count * seen + n * width)
    for row in range(n):
        weights = view(outer, row * width)
        value = splat(weights[seen - 1])
        for i in range(n):
            value = value + weights[i] * load(x, i * LANES)
        for i in range(nu):
            value = value + weights[n + i] * load(u, i * LANES)
        for j in range(count):
            value = value + weights[seen + j] * load(room, j * LANES)
        for i in range(ny):
            value = value + gain[row * ny + i] * load(off, i * LANES)
        store(after, row * LANES, min(max(value, -far), far))


def correct(after, off, p, ny, nu, far):
    """Add the correction ``off`` to the next states of one member, and clip them to ``far``."""
    n, count = int(p[MEMBER.n]), int(p[MEMBER.units])
    seen = n + nu + 1
    gain = view(p, MEMBER.size + count + count * seen + n * (seen + count))
    for row in range(n):
        value = load(after, row * LANES)
        for i in range(ny):
            value = value + gain[row * ny + i] * load(off, i * LANES)
        store(after, row * LANES, min(max(value, -far), far))
