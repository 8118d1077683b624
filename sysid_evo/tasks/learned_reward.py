# mypy: disable-error-code="no-untyped-def, no-untyped-call"
"""Reward and end of an episode as functions of state, control and next state; their reference and compiled forms."""

from __future__ import annotations

import base64
import binascii
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError
from safetensors.numpy import load, save

from sysid_evo.angles import TURN
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import LANES, Layout, nearest, view
from sysid_evo.system import System
from sysid_evo.types import Array, BoolArray


@dataclass(frozen=True)
class LearnedReward:
    """The reward of a step, the end of the episode, and the reward of the step that ends it.

    The features (m,) of a step are the next state (sine and cosine of a periodic one), r of them, then the controls,
    then the change of each state, all minus ``centre`` and divided by ``scale`` (m,). Polynomials of degree 2 have the
    coefficients of 1, of the features, and of the products i <= j:

    - ``step`` of all features: the reward of a step that does not end the episode. ``distances`` (d, 4) add to it, see
      `distance_values`, and a network with ``inner`` (h, 1 + m) and ``outer`` (h,) weights adds
      outer @ tanh(inner @ [1, features]); d and h may be 0;
    - ``end``, of the first r: the episode ends where it is positive, after ``trees`` (t, 22) are added, see
      `tree_values`, and where one of the ``limits`` (k, 3) is passed: sign * (feature - value) > 0, with the columns
      feature, sign, value;
    - ``last``, of the first r, or of all: the reward of the step that ends it. With two ``levels`` (2,) it is the
      second of these where the polynomial is positive, else the first.

    ``range`` (4,) are the lowest and highest reward of a step and of the last one. ``late`` is the reward of the step
    at the time limit if it is another one.
    """

    centre: Array
    scale: Array
    step: Array
    distances: Array
    inner: Array
    outer: Array
    end: Array
    trees: Array
    last: Array
    limits: Array
    levels: Array
    range: Array
    late: LearnedReward | None = None

    @property
    def n_reached(self) -> int:
        """The number r of features of the next state."""
        return _features_in(len(self.end))

    @property
    def least(self) -> float:
        """The lowest reward."""
        own = float(min(self.range[0], self.range[2]))
        return own if self.late is None else min(own, self.late.least)

    def judge(self, system: System, before: Array, control: Array, after: Array) -> tuple[Array, BoolArray]:
        """Return the rewards (B,) of steps, and whether each ended its episode (B,)."""
        features = (raw_features(system, before, control, after) - self.centre) / self.scale
        reached = features[:, : self.n_reached]
        over = is_over(self.end, self.trees, self.limits, reached)
        last = polynomial(self.last, features[:, : _features_in(len(self.last))])
        if len(self.levels):
            last = np.where(last > 0.0, self.levels[1], self.levels[0])
        step = polynomial(self.step, features) + network(self.inner, self.outer, features)
        if len(self.distances):
            step += distance_values(self.distances, system, before, control, after) @ self.distances[:, 0]
        return np.where(over, last.clip(*self.range[2:]), step.clip(*self.range[:2])), over

    def parameters(self, system: System) -> Array:
        """Return the parameters of `judge_lanes`, flat."""
        m, r = len(self.centre), self.n_reached
        periods = [system.periods.get(i, 0.0) for i in range(system.nx)]
        tables: list[npt.ArrayLike] = [
            periods, self.centre, 1.0 / self.scale, self.step, self.inner, self.outer, self.end, self.last, self.limits,
            self.distances, self.trees, [*system.neutral_state, *system.neutral_control],
        ]  # fmt: skip
        levels = self.levels if len(self.levels) else (0.0, 0.0)
        return HEAD.pack(
            **{"nx": system.nx, "nu": system.nu, "m": m, "r": r, "limits": len(self.limits)},
            **{"n_last": _features_in(len(self.last)), "hidden": len(self.outer)},
            **{"n_distances": len(self.distances), "n_trees": len(self.trees)},
            **dict(zip(OFFSETS, tables, strict=True)),
            **{"two": float(len(self.levels) > 0), "first": levels[0], "second": levels[1]},
            **dict(zip(("low", "high", "last_low", "last_high"), self.range, strict=True)),
        )

    def to_text(self) -> str:
        """Return all arrays as text, for the spec of a task."""
        arrays = {name: np.ascontiguousarray(getattr(self, name), dtype=np.float32) for name in ARRAYS}
        own = base64.b64encode(save(arrays)).decode()
        return own if self.late is None else f"{own}.{self.late.to_text()}"

    @classmethod
    def from_text(cls, text: str) -> LearnedReward:
        """Inverse of `to_text`. Raises `InvalidArgument`."""
        own, _, late = text.partition(".")
        try:
            arrays: dict[str, Any] = load(base64.b64decode(own, validate=True))
            found = cls(**{name: arrays[name].astype(np.float64) for name in ARRAYS})
        except (binascii.Error, SafetensorError, KeyError, ValueError) as error:
            raise InvalidArgument(f"learned reward: expected the text that was stored with it: {error}") from error
        m, r = len(found.centre), found.n_reached
        shapes = [getattr(found, name).shape for name in ARRAYS]
        last = (n_terms(m if len(found.last) == n_terms(m) else r),)
        h, inside = len(found.outer), (len(found.distances), 4)
        wanted = [(m,), (m,), (n_terms(m),), inside, (h, 1 + m), (h,), (n_terms(r),), (len(found.trees), TREE), last,
                  (len(found.limits), 3), None, (4,)]  # fmt: skip
        if any(b is not None and a != b for a, b in zip(shapes, wanted, strict=True)) or r > m:
            raise InvalidArgument(f"learned reward: its arrays do not fit each other: {shapes}")
        if not all(np.isfinite(getattr(found, name)).all() for name in ARRAYS):
            raise InvalidArgument("learned reward: expected finite numbers")
        for places, count in ((found.distances[:, 1:3], m - r), (found.trees[:, :NODES], r)):
            if (places < 0).any() or (places >= count).any():
                raise InvalidArgument("learned reward: a distance or a tree is of a feature that does not exist")
        if not late:
            return found
        at_limit = cls.from_text(late)
        if [at_limit.n_reached, len(at_limit.centre)] != [r, m]:
            raise InvalidArgument("learned reward: the one at the time limit has other features")
        return replace(found, late=at_limit)

    def fits(self, system: System) -> bool:
        """Return whether it was learned on a system with as many states, controls and periodic states."""
        r = system.nx + len(system.periods)
        return self.n_reached == r and len(self.centre) == r + system.nu + system.nx


LARGE, FEW_FOUND = 0.2, 0.6
"""A reward is badly known from this held-out error on, or if fewer of the ends are found."""


@dataclass(frozen=True)
class RewardQuality:
    """Held-out errors of a learned reward.

    ``error``, ``last_error`` and ``late_error`` are root mean squares, of rewards of steps, of those that ended an
    episode (nan without ends) and of those at the time limit (nan if they are as others), over their standard
    deviation, the latter two over that of all rewards if it is larger; ``found`` is the share of recorded ends that
    were predicted, nan without ends, ``wrong`` the number of wrong ends in 1,000 steps. ``forms`` name what was fitted,
    the last one at the time limit, "" if it is as others.
    """

    steps: int
    episodes: int
    ends: int
    error: float
    last_error: float
    late_error: float
    found: float
    wrong: float
    forms: tuple[str, str, str, str]

    @property
    def warning(self) -> str:
        """Why the reward is badly known, in a sentence; empty if it is not."""
        reasons = []
        if self.error > LARGE:
            error, most = 100.0 * self.error, 100.0 * LARGE
            reasons.append(f"held-out error {error:.2g} % of its standard deviation, at most {most:.2g} % is reliable")
        if self.late_error > LARGE:
            reasons.append(f"held-out error {100.0 * self.late_error:.2g} % in the step at the time limit")
        if self.found < FEW_FOUND:
            found, least = 100.0 * self.found, 100.0 * FEW_FOUND
            reasons.append(f"{found:.0f} % of the ends of episodes are found, {least:.0f} % are needed")
        return f"The learned reward is badly known: {'; '.join(reasons)}." if reasons else ""

    @property
    def sentences(self) -> tuple[str, ...]:
        """The errors in words."""
        step, end, last, late = self.forms
        wording = [
            f"Learned reward: {step} of state, control and next state; held-out error {100.0 * self.error:.2g} % of "
            f"its standard deviation ({self.steps:,} steps of {self.episodes:,} episodes)."
        ]
        if late:
            wording.append(
                f"Reward at the time limit, which differs: {late} of the state reached; held-out error "
                f"{100.0 * self.late_error:.2g} %. It is paid in the last step of simulated trials."
            )
        if not self.ends:
            return (*wording, "Learned end: none; no recorded episode was terminated.")
        wording.append(
            f"Learned end: {end}, from {self.ends} recorded ends; held out, {100.0 * self.found:.0f} % of the ends are "
            f"found, with {self.wrong:.2g} wrong ones in 1,000 steps."
        )
        wording.append(f"Reward of the last step: {last}; held-out error {100.0 * self.last_error:.2g} %.")
        return tuple(wording)


ARRAYS = (
    "centre", "scale", "step", "distances", "inner", "outer", "end", "trees", "last", "limits", "levels", "range"
)  # fmt: skip


def raw_features(system: System, before: Array, control: Array, after: Array) -> Array:
    """Return next state, control and change of state (B, m), before they are scaled."""
    return np.concatenate([system.regressors(after), control, system.difference(after, before)], axis=1)


def n_terms(n: int) -> int:
    """Return the number of terms of a polynomial of degree 2 in ``n`` features."""
    return 1 + n + n * (n + 1) // 2


def _features_in(terms: int) -> int:
    return int((np.sqrt(8.0 * terms + 1.0) - 3.0) / 2.0 + 0.5)


def terms_of(features: Array) -> Array:
    """Return 1, the features, and their products i <= j, (B, n_terms)."""
    rows, columns = np.triu_indices(features.shape[1])
    return np.concatenate([np.ones((len(features), 1)), features, features[:, rows] * features[:, columns]], axis=1)


def polynomial(coefficients: Array, features: Array) -> Array:
    """Return the values (B,) of a polynomial of degree 2 at ``features`` (B, n)."""
    n = features.shape[1]
    square = np.zeros((n, n))
    square[np.triu_indices(n)] = coefficients[1 + n :]
    values: Array = coefficients[0] + features @ coefficients[1 : 1 + n] + ((features @ square) * features).sum(axis=1)
    return values


def is_over(end: Array, trees: Array, limits: Array, reached: Array) -> BoolArray:
    """Return whether steps that reached these features (B, r) ended their episode (B,), see `LearnedReward`."""
    over: BoolArray = polynomial(end, reached) + tree_values(trees, reached) > 0.0
    for place, sign, value in limits:
        over |= sign * (reached[:, int(place)] - value) > 0.0
    return over


def network(inner: Array, outer: Array, features: Array) -> Array:
    """Return the values (B,) of a network with one hidden layer at ``features`` (B, m)."""
    values: Array = np.tanh(inner[:, 0] + features @ inner[:, 1:].T) @ outer
    return values


def distance_values(table: Array, system: System, before: Array, control: Array, after: Array) -> Array:
    """Return the values (B, d) of distances, the rows of ``table`` (d, 4): weight, first, second, change.

    The first and the second are places among the states and, after them, the controls, as offsets a and b from their
    neutral values (of a periodic state the shorter way). The value is sqrt(a**2 + b**2) after the step, |a| if both are
    the same; with a change of 1 that before the step is subtracted. Such a sum over an episode depends on its first and
    last state alone.
    """
    first, second = table[:, 1].astype(np.int64), table[:, 2].astype(np.int64)
    both, change = (first != second).astype(np.float64), table[:, 3]
    neutral, pushed = system.neutral_state, control - system.neutral_control

    def lengths(state: Array) -> Array:
        offsets = np.concatenate([system.difference(state, np.broadcast_to(neutral, state.shape)), pushed], axis=1)
        values: Array = np.sqrt(offsets[:, first] ** 2 + both * offsets[:, second] ** 2)
        return values

    return lengths(after) - change * lengths(before)


DEPTH = 3
"""Comparisons of a tree from its root to a leaf."""
NODES, LEAVES = 2**DEPTH - 1, 2**DEPTH
TREE = 2 * NODES + LEAVES
"""Numbers of a tree: the feature and the threshold of each node, and the value of each leaf."""


def tree_values(trees: Array, features: Array) -> Array:
    """Return the sum (B,) of the values of ``trees`` (t, 22) at ``features`` (B, n).

    The nodes of a tree are numbered level by level; the next one is 2 k + 2 after node k if its feature is above its
    threshold, else 2 k + 1. The first leaf follows the last node.
    """
    total, rows = np.zeros(len(features)), np.arange(len(features))
    for tree in trees:
        places, thresholds, values = tree[:NODES].astype(np.int64), tree[NODES : 2 * NODES], tree[2 * NODES :]
        node = np.zeros(len(features), dtype=np.int64)
        for _ in range(DEPTH):
            node = 2 * node + 1 + (features[rows, places[node]] > thresholds[node])
        total += values[node - NODES]
    return total


OFFSETS = (
    "periods", "centre", "factor", "step", "inner", "outer", "end", "last", "bounds", "lengths", "forest", "neutral"
)  # fmt: skip
HEAD = Layout(
    "nx", "nu", "m", "r", "n_last", "hidden", "limits", "n_distances", "n_trees", *OFFSETS,
    "two", "first", "second", "low", "high", "last_low", "last_high",
)  # fmt: skip
SUMS = 4
"""Rows for the values of the three polynomials and of one hidden unit, before those for the features."""


def scratch_rows(learned: LearnedReward) -> int:
    """Return the number of rows of 64 numbers that `judge_lanes` needs."""
    m = len(learned.centre)
    own = SUMS + m + (2 * (m - learned.n_reached) if len(learned.distances) else 0)
    return own if learned.late is None else max(own, scratch_rows(learned.late))


def polynomial_lanes(value, features, n, coefficients):
    """Write the values of a polynomial of ``n`` rows of features to the row ``value``."""
    for lane in range(LANES):
        value[lane] = coefficients[0]
    for i in range(n):
        factor, one = coefficients[1 + i], view(features, i * LANES)
        if factor != 0.0:
            for lane in range(LANES):
                value[lane] += factor * one[lane]
    place = 1 + n
    for i in range(n):
        one = view(features, i * LANES)
        for j in range(i, n):
            factor, other = coefficients[place], view(features, j * LANES)
            if factor != 0.0:
                for lane in range(LANES):
                    value[lane] += factor * one[lane] * other[lane]
            place += 1


def distances_lanes(value, before, control, after, offsets, p):
    """Add the distances to the row ``value``; ``offsets`` has room for states and controls, twice."""
    nx, nu = int(p[HEAD.nx]), int(p[HEAD.nu])
    periods, neutral = view(p, int(p[HEAD.periods])), view(p, int(p[HEAD.neutral]))
    table = view(p, int(p[HEAD.lengths]))
    earlier = view(offsets, (nx + nu) * LANES)
    for i in range(nx):
        for lane in range(LANES):
            offsets[i * LANES + lane] = after[i * LANES + lane] - neutral[i]
            earlier[i * LANES + lane] = before[i * LANES + lane] - neutral[i]
        if periods[i] > 0.0:
            for lane in range(LANES):
                off, old = offsets[i * LANES + lane], earlier[i * LANES + lane]
                offsets[i * LANES + lane] = off - periods[i] * nearest(off / periods[i])
                earlier[i * LANES + lane] = old - periods[i] * nearest(old / periods[i])
    for i in range(nu):
        for lane in range(LANES):
            pushed = control[i * LANES + lane] - neutral[nx + i]
            offsets[(nx + i) * LANES + lane] = pushed
            earlier[(nx + i) * LANES + lane] = pushed
    for k in range(int(p[HEAD.n_distances])):
        weight, i, j, change = table[4 * k], int(table[4 * k + 1]), int(table[4 * k + 2]), table[4 * k + 3]
        both = 0.0 if i == j else 1.0
        one, other = view(offsets, i * LANES), view(offsets, j * LANES)
        for lane in range(LANES):
            value[lane] += weight * math.sqrt(one[lane] * one[lane] + both * other[lane] * other[lane])
        if change > 0.0:
            old, old_other = view(earlier, i * LANES), view(earlier, j * LANES)
            for lane in range(LANES):
                value[lane] -= weight * math.sqrt(old[lane] * old[lane] + both * old_other[lane] * old_other[lane])


def trees_lanes(value, features, count, forest):
    """Add the values of ``count`` trees to the row ``value``."""
    for k in range(count):
        tree = view(forest, k * TREE)
        for lane in range(LANES):
            node = 0
            for _ in range(DEPTH):
                shown = features[int(tree[node]) * LANES + lane]
                node = 2 * node + (2 if shown > tree[NODES + node] else 1)
            value[lane] += tree[NODES + node]


def judge_lanes(before, control, after, scratch, p):
    """Write the rewards to row 0 of ``scratch``, and to row 1 a number that is positive where the episode ends."""
    nx, nu, m, r = int(p[HEAD.nx]), int(p[HEAD.nu]), int(p[HEAD.m]), int(p[HEAD.r])
    periods, centre, factor = view(p, int(p[HEAD.periods])), view(p, int(p[HEAD.centre])), view(p, int(p[HEAD.factor]))
    features = view(scratch, SUMS * LANES)
    row = 0
    for i in range(nx):
        value, shown = view(after, i * LANES), view(features, row * LANES)
        if periods[i] > 0.0:
            turn = TURN / periods[i]
            for lane in range(LANES):
                shown[lane] = math.sin(turn * value[lane])
                shown[LANES + lane] = math.cos(turn * value[lane])
            row += 2
        else:
            for lane in range(LANES):
                shown[lane] = value[lane]
            row += 1
    for i in range(nu * LANES):
        features[row * LANES + i] = control[i]
    row += nu
    for i in range(nx):
        value, old, shown = view(after, i * LANES), view(before, i * LANES), view(features, row * LANES)
        for lane in range(LANES):
            shown[lane] = value[lane] - old[lane]
        if periods[i] > 0.0:
            for lane in range(LANES):
                shown[lane] -= periods[i] * nearest(shown[lane] / periods[i])
        row += 1
    for i in range(m):
        shown, middle, inverse = view(features, i * LANES), centre[i], factor[i]
        for lane in range(LANES):
            shown[lane] = (shown[lane] - middle) * inverse
    end, last = view(scratch, LANES), view(scratch, 2 * LANES)
    polynomial_lanes(scratch, features, m, view(p, int(p[HEAD.step])))
    hidden, inner, outer = view(scratch, 3 * LANES), view(p, int(p[HEAD.inner])), view(p, int(p[HEAD.outer]))
    for k in range(int(p[HEAD.hidden])):
        weights, factor_out = view(inner, k * (1 + m)), outer[k]
        for lane in range(LANES):
            hidden[lane] = weights[0]
        for i in range(m):
            shown, weight = view(features, i * LANES), weights[1 + i]
            for lane in range(LANES):
                hidden[lane] += weight * shown[lane]
        for lane in range(LANES):
            scratch[lane] += factor_out * math.tanh(hidden[lane])
    if p[HEAD.n_distances] > 0.0:
        distances_lanes(scratch, before, control, after, view(features, m * LANES), p)
    polynomial_lanes(end, features, r, view(p, int(p[HEAD.end])))
    trees_lanes(end, features, int(p[HEAD.n_trees]), view(p, int(p[HEAD.forest])))
    polynomial_lanes(last, features, int(p[HEAD.n_last]), view(p, int(p[HEAD.last])))
    bounds = view(p, int(p[HEAD.bounds]))
    for k in range(int(p[HEAD.limits])):
        shown, sign, limit = view(features, int(bounds[3 * k]) * LANES), bounds[3 * k + 1], bounds[3 * k + 2]
        for lane in range(LANES):
            beyond = sign * (shown[lane] - limit)
            end[lane] = beyond if beyond > end[lane] else end[lane]
    low, high, last_low, last_high = p[HEAD.low], p[HEAD.high], p[HEAD.last_low], p[HEAD.last_high]
    two, first, second = p[HEAD.two], p[HEAD.first], p[HEAD.second]
    for lane in range(LANES):
        final = last[lane]
        if two > 0.0:
            final = second if final > 0.0 else first
        final = min(max(final, last_low), last_high)
        usual = min(max(scratch[lane], low), high)
        scratch[lane] = final if end[lane] > 0.0 else usual
