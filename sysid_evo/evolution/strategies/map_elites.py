"""MAP-Elites: an archive of the best candidate of each cell of behaviour."""

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
"""Number of best cells whose candidates are the elite."""
LARGEST = 1e300
"""Fitness is limited to +- this value, because the archive accepts finite numbers only."""
ARRAYS = ("candidates", "scores", "biases", "times")


@register_strategy("map_elites")
class MapElites(EvolutionStrategy):
    """MAP-Elites (Mouret and Clune 2015), with the archive of the library ``ribs``.

    Cells are defined by the biases of two channels, each from -1 to 1 in ``bins`` equal parts. The bias of a channel is
    the share of the time above its neutral value minus the share below. ``channels`` names the two, joined by ``+``;
    by default they are the first control and the first state. Each cell keeps its best candidate. A generation is
    ``population`` children of candidates drawn uniformly over the cells: a normal step of standard deviation ``sigma``
    in every parameter, and one of standard deviation ``line`` times the difference to another candidate (Vassiliades
    and Mouret 2018). The first candidates are ``initial`` (default 0) plus normal numbers of deviation ``spread``.

    The candidates of the ``again`` best cells are evaluated again in every generation, and their mean fitness counts,
    so that a high score by chance does not persist. Without behaviour descriptors known is one cell. Random numbers
    come from a generator keyed by (seed, generation).
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
        self._biases, self._times = np.empty((0, 1)), np.empty(0)
        self._cells: IntArray = np.empty((0, 1), dtype=np.int64)

    def forget_fitness(self) -> None:
        """Discard the fitness of the cells; all are evaluated again, some in each generation, before the best are."""
        self._scores, self._times = np.full(len(self._scores), -LARGEST), np.zeros(len(self._times))

    @property
    def elite(self) -> Array:
        best = self._best_first()
        best = best[(self._times[best] > 0) | (self._times.max(initial=0.0) == 0)][:KEPT]
        return self._candidates[best].copy() if len(best) else self._centre[None].copy()

    @property
    def finals(self) -> Mapping[str, Array]:
        """The best cells that are not adjacent, each with its neighbours, best first."""
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
        """Number of filled cells and the best cell, for the progress display."""
        best = self._best_first()
        where = f", best {self._name(int(best[0]))}" if len(best) and self._cell_channels else ""
        return f"{len(best)} of {self.bins ** len(self._cell_channels)} cells{where}"

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
            check_shape("state: biases", state["biases"], (count, max(1, len(self._cell_channels)))),
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
        return np.concatenate([children, self._candidates[self._reevaluated()]])

    def _update(self, population: Array, fitness: Array, behaviour: Array) -> None:
        scores, biases = np.clip(fitness, -LARGEST, LARGEST), self._biases_of(behaviour)
        old, times = self._reevaluated(), np.ones(len(population))
        if len(old):
            times[-len(old) :] += self._times[old]
            share = 1.0 / times[-len(old) :]
            scores[-len(old) :] = (1.0 - share) * self._scores[old] + share * scores[-len(old) :]
            biases[-len(old) :] += (1.0 - share)[:, None] * (self._biases[old] - biases[-len(old) :])
        rest = np.delete(np.arange(len(self._candidates)), old)
        self._fill(
            np.concatenate([population, self._candidates[rest]]),
            np.concatenate([scores, self._scores[rest]]),
            np.concatenate([biases, self._biases[rest].reshape(len(rest), biases.shape[1])]),
            np.concatenate([times, self._times[rest]]),
        )
        self.generation += 1

    def _fill(self, candidates: Array, scores: Array, biases: Array, times: Array) -> None:
        """Store the best candidate of each cell, in the order of the cells."""
        self._archive.clear()
        if len(candidates):
            self._archive.add(candidates, scores, biases, times=times)
        found = self._archive.data(["solution", "objective", "measures", "times", "index"])
        order = np.argsort(found["index"])
        self._candidates, self._scores = found["solution"][order].copy(), found["objective"][order].copy()
        self._biases, self._times = found["measures"][order].copy(), found["times"][order].copy()
        self._cells = np.asarray(self._archive.int_to_grid_index(found["index"][order]), dtype=np.int64)

    def _reevaluated(self) -> IntArray:
        best = self._best_first()
        return best[np.argsort(self._times[best] > 0, kind="stable")][: self.again]

    def _best_first(self) -> IntArray:
        return np.argsort(-self._scores, kind="stable")

    def _biases_of(self, behaviour: Array) -> Array:
        """Return the biases (P, 2) of the two channels; zeros (P, 1) without descriptors."""
        if not self._cell_channels:
            return np.zeros((len(behaviour), 1))
        above, below = (
            behaviour[:, [self.behaviour_names.index(f"{channel} {side}") for channel in self._cell_channels]]
            for side in (ABOVE, BELOW)
        )
        return above - below

    def _name(self, place: int) -> str:
        """Return the name of a candidate's cell: the biases at its centre."""
        middles = (2.0 * self._cells[place] + 1.0) / self.bins - 1.0
        return ", ".join(
            f"{channel} {middle:+.1f}" for channel, middle in zip(self._cell_channels, middles, strict=False)
        )

    @cached_property
    def _cell_channels(self) -> tuple[str, ...]:
        """The channels whose biases define the cells: two, one, or none without descriptors."""
        known = tuple(dict.fromkeys(name.rpartition(" ")[0] for name in self.behaviour_names))
        wanted = self.channels.split("+") if self.channels else [*self.control_names[:1], *known]
        found = tuple(dict.fromkeys(channel for channel in wanted if channel in known))[:2]
        if self.channels and (len(found) < len(wanted) or not found):
            raise InvalidArgument(
                f"map_elites: expected one or two of the channels {', '.join(known) or '(not counted)'}, "
                f"got {self.channels!r}"
            )
        return found

    @cached_property
    def _archive(self) -> Any:
        from ribs.archives import GridArchive

        axes = len(self._cell_channels)
        return GridArchive(
            solution_dim=self.n_parameters,
            dims=[self.bins] * axes or [1],
            ranges=[(-1.0, 1.0)] * max(1, axes),
            dtype=np.float64,
            extra_fields={"times": ((), np.float64)},
        )
