"""Steps of a model outside its training data, counted in its carry, in NumPy and compiled."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from sysid_evo.carry import recent
from sysid_evo.data.support import Support, split_pairs
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import (
    CACHE_LINE,
    LANES,
    DynamicsKernel,
    KernelSource,
    Layout,
    lanes_at_most,
    load,
    splat,
    store,
    view,
    where_at_most,
)
from sysid_evo.models.dynamics import Dynamics, PlainDynamics
from sysid_evo.models.kernels.neighbours import neighbour_predictor
from sysid_evo.types import Array

CHECKED_EVERY = 10
"""Steps between two comparisons with the training data."""


class OutsideCounter(PlainDynamics):
    """``model`` with a count of its steps outside the training data.

    Every ``every``-th step is compared with the training data and represents the others: 0 within the limit of
    `Support`, 1 beyond twice the limit, linear in between. By default ``support`` is made from the
    ``training_sample_`` of the model. The carry is that of ``model``, the count, and the steps to the next comparison.
    """

    def __init__(self, model: Dynamics, *, support: Support | None = None, every: int = CHECKED_EVERY) -> None:
        if every < 1:
            raise InvalidArgument(f"steps outside the data: expected every >= 1 step, got {every}")
        if model.observed_at != 0:
            raise InvalidArgument("steps outside the data: the model has delayed observations; delay this one instead")
        self.model, self.every = model, every
        self.system, self.n_lags = model.system, model.n_lags
        self.n_noise, self.n_draws = model.n_noise, model.n_draws
        self.outside_at: int = model.n_carry
        self.n_carry = self.outside_at + 2
        self.training_sample_: Array | None = getattr(model, "training_sample_", None)
        data = self._recorded() if support is None else support
        smallest = float(np.finfo(np.float32).tiny)  # the limit is 0 if all recorded pairs are equal
        self.support = replace(data, limit=max(data.limit, smallest))

    @property
    def state_bounds(self) -> Array | None:
        return self.model.state_bounds

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        carry = self.model.start(*recent(states, controls, self.n_lags), draws)
        return np.concatenate([carry, np.zeros((len(states), 2))], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        state, inner = carry[:, : self.system.nx], carry[:, : self.outside_at]
        outside, clock = carry[:, self.outside_at :].T.copy()
        due = clock == 0.0
        if due.any():
            beyond = self.support.distances(state[due], control[due]) / self.support.limit - 1.0
            outside[due] += self.every * np.clip(beyond, 0.0, 1.0)
        clock = np.where(due, self.every, clock) - 1.0
        after = self.model.step(inner, control, noise)
        return np.concatenate([after, np.stack([outside, clock], axis=1)], axis=1)

    def kernel(self) -> DynamicsKernel | None:
        return self._compiled

    @cached_property
    def _compiled(self) -> DynamicsKernel | None:
        inner = self.model.kernel()
        if inner is None or self.system.periods:
            return None
        support, (nx, nu) = self.support, (self.system.nx, self.system.nu)
        found = neighbour_predictor([(support.points, support.points)], np.zeros(1, dtype=np.int64), [], range(nu), nx)
        parameters = HEAD.pack(
            1.0 / support.scale, nx=nx, nu=nu, outside_at=self.outside_at, per_limit=1.0 / support.limit,
            every=self.every, table=found.parameters, own=inner.parameters,
        )  # fmt: skip
        source = KernelSource(counted, {
            "inner": inner.source, "look": KernelSource(look, {"nearest_pair": found.function}),
        })  # fmt: skip
        room = max(2 * (nx + nu) + found.n_scratch, inner.n_scratch)
        return DynamicsKernel(source, parameters, room, inner.precision)

    def _recorded(self) -> Support:
        """Return the support of the training data."""
        if self.training_sample_ is None:
            raise InvalidArgument("steps outside the data: the model has no sample of its training data; give support=")
        return Support.of(self.system, *split_pairs(self.system, self.training_sample_))


HEAD = Layout("nx", "nu", "outside_at", "per_limit", "every", "table", "own", align=CACHE_LINE)


def counted(carry, control, noise, parameters, scratch):
    """Count the step if it is outside the data, and step the model."""
    every, outside = parameters[HEAD.every], view(carry, int(parameters[HEAD.outside_at]) * LANES)
    clock = load(outside, LANES)
    if lanes_at_most(clock, splat(0.0)) != 0:
        look(carry, control, outside, parameters, scratch)
    store(outside, LANES, where_at_most(clock, 0.0, every, clock) - 1.0)
    inner(carry, control, noise, view(parameters, int(parameters[HEAD.own])), scratch)


def look(carry, control, outside, parameters, scratch):
    """Add to the count of the lanes that are due."""
    nx, nu, scales = int(parameters[HEAD.nx]), int(parameters[HEAD.nu]), view(parameters, HEAD.size)
    here, commanded, found = scratch, view(scratch, nx * LANES), view(scratch, (nx + nu) * LANES)
    for row in range(nx):
        store(here, row * LANES, load(carry, row * LANES) * scales[row])
    for row in range(nu):
        store(commanded, row * LANES, load(control, row * LANES) * scales[nx + row])
    table = view(parameters, int(parameters[HEAD.table]))
    nearest_pair(here, commanded, table, found, view(found, (nx + nu) * LANES))
    square = splat(0.0)
    for row in range(nx + nu):
        off = load(here, row * LANES) - load(found, row * LANES)
        square = square + off * off
    beyond = min(max(math.sqrt(square) * parameters[HEAD.per_limit] - 1.0, 0.0), 1.0)
    counted_now = where_at_most(load(outside, LANES), 0.0, parameters[HEAD.every] * beyond, 0.0)
    store(outside, 0, load(outside, 0) + counted_now)
