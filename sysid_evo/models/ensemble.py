"""Several models as one: their joint carry, and their mean, in NumPy and compiled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import groupby
from typing import Self

import numpy as np

from sysid_evo.carry import recent
from sysid_evo.data.dataset import Dataset
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.kernels import (
    CACHE_LINE,
    LANES,
    DynamicsKernel,
    KernelSource,
    Layout,
    Precision,
    load,
    padded,
    splat,
    store,
    view,
)
from sysid_evo.models.base import DynamicsModel
from sysid_evo.models.dynamics import Dynamics
from sysid_evo.models.kernels.stepping import copy
from sysid_evo.models.learned import Declared
from sysid_evo.models.stochastic import StochasticModel
from sysid_evo.types import Array


class Members:
    """``models`` of one system, with the positions of their concatenated carries (n_carry) and noise."""

    def __init__(self, models: Sequence[Dynamics]) -> None:
        self.models = tuple(models)
        self.system = self.models[0].system
        for model in self.models:
            differences = self.system.differences(model.system)
            if differences:
                raise IncompatibleSystem(f"several models: their systems differ: {'; '.join(differences)}")
            if model.observed_at != 0:
                raise InvalidArgument(
                    "several models: one of them has delayed observations; delay the ensemble instead"
                )
        self.n_lags = max(model.n_lags for model in self.models)
        self.places = _places([model.n_carry for model in self.models])
        self.noise_places = _places([model.n_noise for model in self.models])
        self.draw_places = _places([model.n_draws for model in self.models])
        self.n_carry, self.n_noise, self.n_draws = (
            sum(getattr(model, name) for model in self.models) for name in ("n_carry", "n_noise", "n_draws")
        )

    def start(self, states: Array, controls: Array, draws: Array) -> Array:
        """Return the carries (B, n_carry) after a history, with ``draws`` (B, n_draws)."""
        carries = []
        for model, at in zip(self.models, self.draw_places, strict=True):
            carries.append(model.start(*recent(states, controls, model.n_lags), draws[:, at : at + model.n_draws]))
        return np.concatenate(carries, axis=1)

    def step(self, state: Array, carries: Array, control: Array, noise: Array | None) -> tuple[Array, list[Array]]:
        """Return the prediction of each member from ``state`` (M, B, nx), and the rest of its carry."""
        nx = self.system.nx
        predicted, rests = [], []
        for model, at, drawn in zip(self.models, self.places, self.noise_places, strict=True):
            given = noise[:, drawn : drawn + model.n_noise] if noise is not None and model.n_noise else None
            after = model.step(
                np.concatenate([state, carries[:, at + nx : at + model.n_carry]], axis=1), control, given
            )
            predicted.append(after[:, :nx])
            rests.append(after[:, nx:])
        return np.stack(predicted), rests

    def joined(self, state: Array, rests: list[Array]) -> Array:
        """Return the concatenated carries (B, n_carry), each with the same ``state`` (B, nx)."""
        return np.concatenate([part for rest in rests for part in (state, rest)], axis=1)


def _places(sizes: list[int]) -> list[int]:
    """Return the start of each of several concatenated parts of these ``sizes``."""
    return [sum(sizes[:i]) for i in range(len(sizes))]


class MeanModel(StochasticModel):
    """A family that learns fitted models ``members_`` and their ``weights_`` (M,), whose sum is 1.

    The next state is the weighted mean of theirs. The carry is the state, then the members' carries, each of which
    begins with the same state. With ``stochastic``, members draw no noise of their own, and the deviation of a step is
    the root of the members' variance plus the squared held-out one-step error.
    """

    def become(self, models: Sequence[DynamicsModel], weights: Array) -> None:
        """Make this model the mean of fitted ``models`` with ``weights`` (M,)."""
        self.members_, self.weights_ = list(models), weights

    def learned_arrays(self) -> Mapping[str, Declared]:
        Members([self, *self.members_])  # raises if their systems differ
        return {**super().learned_arrays(), "weights_": (len(self.members_),)}

    def of(self, models: Sequence[DynamicsModel], weights: Array) -> Self:
        """Return the mean of ``models``, fitted to the same data, as a model without noise."""
        other = self.variant(stochastic=False)
        other.become(models, weights)
        return other

    @cached_property
    def _together(self) -> Members:
        return Members(self.members_)

    @property
    def lags(self) -> tuple[int, int]:
        """The largest numbers of earlier states and earlier controls of a member (0 before `fit`)."""
        members = getattr(self, "members_", [])
        states, controls = ([model.lags[i] for model in members] for i in (0, 1))
        return max(states, default=0), max(controls, default=0)

    @property
    def n_lags(self) -> int:
        return self._together.n_lags if hasattr(self, "members_") else 0

    @property
    def _n_plain(self) -> int:
        return self.system.nx + self._together.n_carry

    @property
    def n_noise(self) -> int:
        return super().n_noise if self.timed else self._together.n_noise

    @property
    def n_draws(self) -> int:
        return super().n_draws if self.timed else self._together.n_draws

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return super().start(states, controls, draws) if self.timed else self._started(states, controls, draws)

    def initial_carry(self, states: Array, controls: Array) -> Array:
        return self._started(states, controls, None)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        return super().step(carry, control, noise) if self.timed else self._advanced(carry, control, noise)

    def _undisturbed(self, carry: Array, control: Array) -> Array:
        return self._advanced(carry, control, None)

    def disturbed(self, carry: Array, control: Array, disturbance: Array) -> Array:
        return self._advanced(carry, control, None, disturbance)

    def next_state(self, carry: Array, control: Array) -> Array:
        return self._undisturbed(carry, control)[:, : self.system.nx]

    def _started(self, states: Array, controls: Array, draws: Array | None) -> Array:
        draws = np.zeros((len(states), self._together.n_draws)) if draws is None else draws
        return np.concatenate([states[:, -1], self._together.start(states, controls, draws)], axis=1)

    def _advanced(self, carry: Array, control: Array, noise: Array | None, disturbance: Array | None = None) -> Array:
        """Return the next carry without the rows of the noise; ``disturbance`` (B, nx) is in deviations."""
        nx, together = self.system.nx, self._together
        predicted, rests = together.step(carry[:, :nx], carry[:, nx:], control, noise)
        weights = self.weights_[:, None, None]
        after = (weights * predicted).sum(axis=0)
        if disturbance is not None:
            variance = (weights * (predicted - after) ** 2).sum(axis=0)
            after = after + np.sqrt(variance + self.residual_**2) * disturbance
        after = self.apply_limits(after)
        return np.concatenate([after, together.joined(after, rests)], axis=1)

    def kernel(self) -> DynamicsKernel | None:
        return self._compiled

    @cached_property
    def _compiled(self) -> DynamicsKernel | None:
        kernels = [model.kernel() for model in self.members_]
        members = [kernel for kernel in kernels if kernel is not None]
        if self.stochastic or len(members) < len(kernels):
            return None
        nx, together = self.system.nx, self._together
        places = [nx + place for place in together.places]
        chain = chained(members, nx, places, together.noise_places)
        parameters = MEAN.pack(self.weights_, places, nx=nx, count=len(members), chain=chain.parameters)
        source = KernelSource(averaged, {"step_all": chain.source})
        return DynamicsKernel(source, parameters, chain.n_scratch, chain.precision)

    def without_noise(self) -> Self:
        quiet = [model.without_noise() for model in self.members_]
        if not self.stochastic and all(one is model for one, model in zip(quiet, self.members_, strict=True)):
            return self
        return self.of(quiet, self.weights_)

    def fine_tuned(self, dataset: Dataset, updates: int, *, rng: np.random.Generator) -> Self | None:
        """Return the mean with all members fine-tuned that can be; None if none can."""
        further = [model.fine_tuned(dataset, updates, rng=rng) for model in self.members_]
        if all(model is None for model in further):
            return None
        other = self.variant()
        other.become([new or old for new, old in zip(further, self.members_, strict=True)], self.weights_)
        return other


MEAN = Layout("nx", "count", "chain", align=CACHE_LINE)


def averaged(carry, control, noise, parameters, scratch):
    """Step all members and set their states to the mean."""
    nx, count = int(parameters[MEAN.nx]), int(parameters[MEAN.count])
    weights, places = view(parameters, MEAN.size), view(parameters, MEAN.size + count)
    step_all(carry, control, noise, view(parameters, int(parameters[MEAN.chain])), scratch)
    for row in range(nx):
        total = splat(0.0)
        for member in range(count):
            total = total + weights[member] * load(carry, (int(places[member]) + row) * LANES)
        store(carry, row * LANES, total)
    for member in range(count):
        copy(carry, view(carry, int(places[member]) * LANES), nx * LANES)


GROUP, MEMBER = Layout("nx", "count", "next"), Layout("at", "noise_at", "own")


def chained(
    members: Sequence[DynamicsKernel], nx: int, places: Sequence[int], noise_places: Sequence[int]
) -> DynamicsKernel:
    """Return a kernel that copies the state at the head of the carry into each member's carry, and steps them all.

    Members with the same code are in one loop, so that it is compiled once.
    """
    source, parameters = KernelSource(nothing_to_step), np.zeros(1)
    groups = [list(group) for _, group in groupby(range(len(members)), key=lambda i: members[i].source)]
    for group in reversed(groups):
        begin = -(-(GROUP.size + MEMBER.size * len(group)) // CACHE_LINE) * CACHE_LINE
        heads, blocks = [], []
        for i in group:
            heads.append(MEMBER.pack(at=places[i], noise_at=noise_places[i], own=begin))
            blocks.append(padded(members[i].parameters))
            begin += len(blocks[-1])
        head = padded(GROUP.pack(*heads, nx=nx, count=len(group), next=begin))
        parameters = np.concatenate([head, *blocks, parameters])
        source = KernelSource(step_group, {"one": members[group[0]].source, "others": source})
    precision: Precision = "float64" if any(member.precision == "float64" for member in members) else "float32"
    return DynamicsKernel(source, parameters, max((member.n_scratch for member in members), default=0), precision)


def step_group(carry, control, noise, parameters, scratch):
    """Step the members of one code, then the others."""
    rows = int(parameters[GROUP.nx]) * LANES
    for number in range(int(parameters[GROUP.count])):
        head = view(parameters, GROUP.size + number * MEMBER.size)
        own = view(carry, int(head[MEMBER.at]) * LANES)
        copy(carry, own, rows)
        drawn = view(noise, int(head[MEMBER.noise_at]) * LANES)
        one(own, control, drawn, view(parameters, int(head[MEMBER.own])), scratch)
    others(carry, control, noise, view(parameters, int(parameters[GROUP.next])), scratch)


def nothing_to_step(carry, control, noise, parameters, scratch):
    """Change nothing."""
    return
