"""A correction that goes on learning: recursive least squares over free runs, with forgetting and a gate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from sysid_evo.adaptation.pieces import FARTHEST, run_beside
from sysid_evo.adaptation.terms import Terms, foreseen, state_scale
from sysid_evo.arrays import Array, BoolArray
from sysid_evo.data.support import split_pairs
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.dynamics.stepping import Dynamics
from sysid_evo.errors import InvalidArgument

STEP = 1e-4
TOLERATED = 1.5
"""Standard deviations beyond which an error counts in proportion and no longer in square (Huber)."""
STILL = 0.2
"""Standard deviations within which all states of a run stay that says nothing: the body stands."""


@dataclass(frozen=True)
class SelfCorrection:
    """What ``model`` lacks, learned sample by sample from what it did not foresee; all that is known is a memory.

    At every sample the last ``horizon`` steps are run freely from where they began, and the coefficients C of the
    ``terms`` minimise over all such runs

        sum exp(-age / forgetting) dt mean(error + J (C - C_then))^2 + ridge |C|^2

    with errors in standard deviations and their slopes J, both at the coefficients of that sample. The ridge bounds
    the covariance where nothing excites it. The same sum without gains and products has a simple minimum beside it.
    The gate compares runs with the coefficients that were known where they began, of either kind, and without: only
    while the better kind was lower by the share ``better``, over about the last ``judged`` s and for at least
    ``patience`` s, do `coefficients` give any. A sample costs ``horizon`` steps of size nx + 4 rows and one solution of
    size nx equations, however long it has gone on.

    Source: Ljung and Soderstrom, "Theory and Practice of Recursive Identification" (1983), Gauss-Newton algorithm.
    """

    model: Dynamics
    terms: Terms
    scale: Array
    horizon: int = 20
    forgetting: float = 120.0
    ridge: float = 0.3
    better: float = 0.05
    judged: float = 30.0
    patience: float = 5.0

    @classmethod
    def of(cls, model: Dynamics, *, products: bool = False, gains: bool = True, **settings: Any) -> Self:
        """Make one whose terms cover what a fitted ``model`` learned from. Raises `InvalidArgument` without that."""
        pairs: Array | None = getattr(model, "pairs_", None)
        if pairs is None:
            raise InvalidArgument("self-correction: expected a fitted model, which knows what data it learned from")
        states, controls = split_pairs(model.system, pairs)
        lags = model.n_lags
        pushes = None
        if gains:
            history = np.repeat(states[:, None], lags + 1, axis=1), np.repeat(controls[:, None], lags, axis=1)
            pushes = foreseen(model, *history, controls)
        terms = widened(Terms.of_pairs(model.system, states, controls, products=products, pushes=pushes))
        return cls(model, terms, state_scale(model.system, states), **settings)

    @cached_property
    def places(self) -> dict[str, slice]:
        """Where everything stands in the memory."""
        system, lags = self.model.system, self.model.n_lags
        n = self.terms.size * system.nx
        sizes = {
            "count": 1,
            "states": (self.horizon + lags + 1) * system.nx,
            "controls": (self.horizon + lags) * system.nu,
            "normal": n * n,
            "right": n,
            "now": n,
            "pending": n,
            "known": n,
            "simple_now": n,
            "simple_pending": n,
            "simple_known": n,
            "plain": 1,
            "corrected": 1,
            "simple": 1,
            "weight": 1,
        }
        ends = np.cumsum(list(sizes.values()))
        return {name: slice(int(end - size), int(end)) for (name, size), end in zip(sizes.items(), ends, strict=True)}

    @property
    def n_memory(self) -> int:
        """Numbers of memory; all are zero at first."""
        return self.places["weight"].stop

    def observed(self, memory: Array, state: Array, control: Array) -> Array:
        """Return the memory (B, n_memory) after ``state`` (B, nx), to which the last ``control`` (B, nu) has led."""
        system, places = self.model.system, self.places
        batch, lags = len(memory), self.model.n_lags
        after = memory.copy()
        states = np.concatenate([memory[:, places["states"]][:, system.nx :], state], axis=1)
        controls = np.concatenate([memory[:, places["controls"]][:, system.nu :], control], axis=1)
        after[:, places["states"]], after[:, places["controls"]] = states, controls
        count = memory[:, places["count"]] + 1.0
        after[:, places["count"]] = count
        x, u = states.reshape(batch, -1, system.nx), controls.reshape(batch, -1, system.nu)
        moves = (np.abs(system.difference(x, x[:, -1:])).max(axis=1) > STILL * self.scale).any(axis=1)
        told = moves & (count[:, 0] > self.horizon + lags)
        if told.any():
            after[told] = self._learned(after[told], x[told], u[told])
        return after

    def coefficients(self, memory: Array) -> Array:
        """Return what is to be added, (B, size, nx): the present coefficients where the gate is open, else zero."""
        now, simple = (memory[:, self.places[name]] for name in ("now", "simple_now"))
        corrected, simply = (memory[:, self.places[name]] for name in ("corrected", "simple"))
        better = np.where(simply <= corrected, simple, now).reshape(-1, *self.terms.shape)
        return np.where(self.open(memory)[:, None, None], better, 0.0)

    def open(self, memory: Array) -> BoolArray:
        """Whether recent runs with the coefficients that were known before were better than without, (B,)."""
        plain, corrected, simple, weight = (
            memory[:, self.places[name]][:, 0] for name in ("plain", "corrected", "simple", "weight")
        )
        dt = self.model.system.dt
        return (weight * dt >= self.patience) & (np.minimum(corrected, simple) <= (1.0 - self.better) ** 2 * plain)

    def along(self, episode: Trajectory) -> Iterator[Array]:
        """Yield the memory (1, n_memory) at every sample of a recorded episode, from what was before it alone."""
        memory = np.zeros((1, self.n_memory))
        before = np.concatenate([self.model.system.neutral_control[None], episode.controls])
        for state, control in zip(episode.states, before, strict=True):
            memory = self.observed(memory, state[None], control[None])
            yield memory

    def _learned(self, memory: Array, states: Array, controls: Array) -> Array:
        """Return the memory after the last run, from states (B, L + H + 1, nx) and controls (B, L + H, nu)."""
        places, lags, nx = self.places, self.model.n_lags, self.model.system.nx
        dt, batch, n = self.model.system.dt, len(memory), self.terms.size * self.model.system.nx
        draws = np.zeros((batch, self.model.n_draws))
        start = self.model.start(states[:, : lags + 1], controls[:, :lags], draws)
        now = memory[:, places["now"]]
        known = [np.zeros_like(now), memory[:, places["known"]], memory[:, places["simple_known"]]]
        tried = np.concatenate([*(one[None] for one in (*known, now)), now + STEP * np.eye(n)[:, None]])
        runs = run_beside(
            self.model,
            self.terms,
            tried.reshape(len(tried), batch, *self.terms.shape),
            start,
            controls[:, lags:],
            self.model.envelope,
        )
        wrong = self.model.system.difference(runs, np.broadcast_to(states[:, lags + 1 :], runs.shape)) / self.scale
        wrong = np.where(np.isfinite(wrong), np.clip(wrong, -FARTHEST, FARTHEST), FARTHEST)
        errors = wrong.reshape(len(tried), batch, -1)
        after = memory.copy()
        keep = np.exp(-dt / self.judged)
        for row, name in enumerate(("plain", "corrected", "simple")):
            after[:, places[name]] = keep * memory[:, places[name]] + np.mean(errors[row] ** 2, axis=1)[:, None]
        after[:, places["weight"]] += 1.0
        here, slopes = errors[3], (errors[4:] - errors[3]) / STEP
        share = dt / (self.horizon * nx) * np.minimum(1.0, TOLERATED / np.maximum(np.abs(here), 1e-12))
        weighed = np.einsum("nbe,be->bne", slopes, share)
        fade = np.exp(-dt / self.forgetting)
        normal = fade * memory[:, places["normal"]].reshape(batch, n, n) + np.einsum("bne,mbe->bnm", weighed, slopes)
        aim = np.einsum("nbe,bn->be", slopes, now) - here
        right = fade * memory[:, places["right"]] + np.einsum("bne,be->bn", weighed, aim)
        after[:, places["normal"]], after[:, places["right"]] = normal.reshape(batch, -1), right
        bounded, own = normal + self.ridge * np.diag(self.terms.weight.ravel()), (1 + self.terms.n_inputs) * nx
        simple = np.zeros_like(now)
        simple[:, :own] = np.linalg.solve(bounded[:, :own, :own], right[:, :own, None])[:, :, 0]
        turn = memory[:, places["weight"]] % self.horizon == 0
        for kind, found in (("", np.linalg.solve(bounded, right[:, :, None])[:, :, 0]), ("simple_", simple)):
            last, pending, used = (places[kind + name] for name in ("now", "pending", "known"))
            after[:, last] = found
            after[:, used] = np.where(turn, memory[:, pending], memory[:, used])
            after[:, pending] = np.where(turn, found, memory[:, pending])
        return after


WIDER = 2.0
"""How much further than the recorded range the terms of a correction reach that is to meet other states."""


def widened(terms: Terms) -> Terms:
    """Return ``terms`` that are kept within twice the range of the recording."""
    out = []
    for low, high in ((terms.low, terms.high), (terms.least, terms.most), (terms.weakest, terms.strongest)):
        middle, half = 0.5 * (low + high), 0.5 * WIDER * (high - low)
        out += [middle - half, middle + half]
    return replace(terms, low=out[0], high=out[1], least=out[2], most=out[3], weakest=out[4], strongest=out[5])
