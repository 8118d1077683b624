"""An archive of the best candidate for each kind of behaviour."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.strategies.strategy import ABOVE, BELOW, EvolutionStrategy, StrategyState
from sysid_evo.extras import check_installed
from sysid_evo.randomness import keyed_generator
from sysid_evo.registry.registry import register_strategy
from sysid_evo.types import Array, IntArray, check_shape

KEPT = 15
"""Cells that the elite is taken from: the best."""
LARGEST = 1e300
"""Fitness beyond this counts as this, since the archive takes finite numbers only."""
ARRAYS = ("candidates", "scores", "leans", "times")


@register_strategy("map_elites")
class MapElites(EvolutionStrategy):
    """MAP-Elites (Mouret and Clune 2015), with the archive of the library ``ribs``.

    Cells are told apart by two leans, each from -1 to 1 in ``bins`` equal parts: the share of the time for which
    a channel is above its neutral value less that below. ``channels`` names the two, joined by ``+``; by default
    they are the first control and the first state. Each cell keeps its best candidate. A generation is
    ``population`` children of candidates drawn evenly over the cells: a normal step of deviation ``sigma`` in every
    parameter, and one of deviation ``line`` times the way to another candidate (Vassiliades and Mouret 2018).
    The first candidates are ``initial`` (default 0) plus normal numbers of deviation ``spread``.

    The ``again`` best cells are asked again in every generation, and the mean of all that a candidate scored
    counts, so that a lucky draw of a noisy fitness does not last there. Where nobody counts behaviour there is
    one cell. Random numbers come from a generator keyed by (seed, generation).
    """

    requires: ClassVar[tuple[str, ...]] = ("ribs",)

    def __init__(
        self,
        *,
        n_parameters: int,
        seed: int,
        population: int = 50,
        again: int = 10,
        channels: str = "",
        bins: int = 10,
        sigma: float = 0.1,
        line: float = 0.2,
        spread: float = 1.0,
        finalists: int = 6,
        initial: Array | None = None,
    ) -> None:
        if min(n_parameters, population, bins, finalists) < 1 or again < 0 or sigma <= 0 or min(line, spread) < 0:
            raise InvalidArgument(
                "map_elites: expected n_parameters, population, bins, finalists >= 1, again, line, spread >= 0, "
                f"sigma > 0, got {n_parameters}, {population}, {bins}, {finalists}, {again}, {line}, {spread}, {sigma}"
            )
        check_installed("strategy 'map_elites'", self.requires)
        self.n_parameters, self.seed = n_parameters, seed
        self.population, self.again, self.bins, self.channels = population, again, bins, channels
        self.sigma, self.line, self.spread, self.finalists = sigma, line, spread, finalists
        self._centre = np.zeros(n_parameters) if initial is None else check_shape("initial", initial, (n_parameters,))
        self.generation = 0
        self._candidates, self._scores = np.empty((0, n_parameters)), np.empty(0)
        self._leans, self._times = np.empty((0, 1)), np.empty(0)
        self._cells: IntArray = np.empty((0, 1), dtype=np.int64)

    def forget_fitness(self) -> None:
        """Forget what the cells scored: all are asked again, some in every generation, before the best are."""
        self._scores, self._times = np.full(len(self._scores), -LARGEST), np.zeros(len(self._times))

    @property
    def elite(self) -> Array:
        best = self._best_first()
        best = best[(self._times[best] > 0) | (self._times.max(initial=0.0) == 0)][:KEPT]
        return self._candidates[best].copy() if len(best) else self._centre[None].copy()

    @property
    def finals(self) -> Mapping[str, Array]:
        """The best cells that do not touch each other, each with the cells around it, best first."""
        found: dict[str, Array] = {}
        taken: list[int] = []
        order = self._best_first()
        for one in order:
            apart = np.abs(self._cells - self._cells[one]).max(axis=1)
            if len(taken) < self.finalists and all(apart[other] > 1 for other in taken):
                taken.append(int(one))
                near = [other for other in order if apart[other] <= 1]
                found[self._name(int(one))] = self._candidates[near].copy()
        return found or {"": self.elite}

    @property
    def status(self) -> str:
        """What is filled, in a few words."""
        best = self._best_first()
        where = f", best {self._name(int(best[0]))}" if len(best) and self._told_apart else ""
        return f"{len(best)} of {self.bins ** len(self._told_apart)} cells{where}"

    @property
    def state(self) -> StrategyState:
        arrays = {name: getattr(self, f"_{name}").copy() for name in ARRAYS}
        return {"generation": self.generation, **arrays}

    def restore(self, state: StrategyState) -> None:
        if set(state) != {"generation", *ARRAYS}:
            raise InvalidArgument(
                f"map_elites: expected a state with generation, {', '.join(ARRAYS)}, got {sorted(state)}"
            )
        candidates = check_shape("state: candidates", state["candidates"], (None, self.n_parameters))
        count = len(candidates)
        self._fill(
            candidates,
            check_shape("state: scores", state["scores"], (count,)),
            check_shape("state: leans", state["leans"], (count, max(1, len(self._told_apart)))),
            check_shape("state: times", state["times"], (count,)),
        )
        self.generation = int(state["generation"])

    def ask(self) -> Array:
        rng = keyed_generator(self.seed, self.generation)
        shape = self.population, self.n_parameters
        if not len(self._candidates):
            return self._centre + self.spread * rng.standard_normal(shape)
        first, second = self._candidates[rng.integers(len(self._candidates), size=(2, self.population))]
        along = self.line * rng.standard_normal((self.population, 1)) * (second - first)
        children = first + self.sigma * rng.standard_normal(shape) + along
        return np.concatenate([children, self._candidates[self._asked_again()]])

    def _update(self, population: Array, fitness: Array, behaviour: Array) -> None:
        scores, leans = np.clip(fitness, -LARGEST, LARGEST), self._leans_of(behaviour)
        old, times = self._asked_again(), np.ones(len(population))
        if len(old):
            times[-len(old) :] += self._times[old]
            share = 1.0 / times[-len(old) :]
            scores[-len(old) :] = (1.0 - share) * self._scores[old] + share * scores[-len(old) :]
            leans[-len(old) :] += (1.0 - share)[:, None] * (self._leans[old] - leans[-len(old) :])
        rest = np.delete(np.arange(len(self._candidates)), old)
        self._fill(
            np.concatenate([population, self._candidates[rest]]),
            np.concatenate([scores, self._scores[rest]]),
            np.concatenate([leans, self._leans[rest].reshape(len(rest), leans.shape[1])]),
            np.concatenate([times, self._times[rest]]),
        )
        self.generation += 1

    def _fill(self, candidates: Array, scores: Array, leans: Array, times: Array) -> None:
        """Keep the best of each cell, in the order of the cells."""
        self._archive.clear()
        if len(candidates):
            self._archive.add(candidates, scores, leans, times=times)
        found = self._archive.data(["solution", "objective", "measures", "times", "index"])
        order = np.argsort(found["index"])
        self._candidates, self._scores = found["solution"][order].copy(), found["objective"][order].copy()
        self._leans, self._times = found["measures"][order].copy(), found["times"][order].copy()
        self._cells = np.asarray(self._archive.int_to_grid_index(found["index"][order]), dtype=np.int64)

    def _asked_again(self) -> IntArray:
        best = self._best_first()
        return best[np.argsort(self._times[best] > 0, kind="stable")][: self.again]

    def _best_first(self) -> IntArray:
        return np.argsort(-self._scores, kind="stable")

    def _leans_of(self, behaviour: Array) -> Array:
        """Return the lean (P, 2) of each of the two channels; (P, 1) zeros where nobody counts."""
        if not self._told_apart:
            return np.zeros((len(behaviour), 1))
        above, below = (
            behaviour[:, [self.behaviour_names.index(f"{channel} {side}") for channel in self._told_apart]]
            for side in (ABOVE, BELOW)
        )
        return above - below

    def _name(self, place: int) -> str:
        """Return where a candidate lies: the middle of its cell."""
        middles = (2.0 * self._cells[place] + 1.0) / self.bins - 1.0
        return ", ".join(f"{channel} {middle:+.1f}" for channel, middle in zip(self._told_apart, middles, strict=False))

    @cached_property
    def _told_apart(self) -> tuple[str, ...]:
        """The channels by whose lean cells are told apart: two, or one, or none where nobody counts."""
        there = tuple(dict.fromkeys(name.rpartition(" ")[0] for name in self.behaviour_names))
        wanted = self.channels.split("+") if self.channels else [*self.control_names[:1], *there]
        found = tuple(dict.fromkeys(channel for channel in wanted if channel in there))[:2]
        if self.channels and (len(found) < len(wanted) or not found):
            raise InvalidArgument(
                f"map_elites: expected one or two of the channels {', '.join(there) or '(not counted)'}, "
                f"got {self.channels!r}"
            )
        return found

    @cached_property
    def _archive(self) -> Any:
        from ribs.archives import GridArchive

        axes = len(self._told_apart)
        return GridArchive(
            solution_dim=self.n_parameters,
            dims=[self.bins] * axes or [1],
            ranges=[(-1.0, 1.0)] * max(1, axes),
            dtype=np.float64,
            extra_fields={"times": ((), np.float64)},
        )
