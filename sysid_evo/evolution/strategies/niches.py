"""Islands for different kinds of behaviour, so that a broad basin with a low roof does not take everything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.strategies.strategy import ABOVE, BELOW, EvolutionStrategy, StrategyState, make_strategy
from sysid_evo.randomness import derived_seed
from sysid_evo.registry.grammar import Spec
from sysid_evo.registry.registry import register_strategy, strategies
from sysid_evo.types import Array, check_shape

ANYTHING = "anything"
QUANTILE = 0.8
LAST = 20
"""Generations of an island over which its promise is taken."""
KEPT = 15
"""Candidates of an island from which its finalist is chosen."""
USUAL_GENERATIONS = 300
SURVEY_SHARE = 0.2
LONGEST_SURVEY = 75
"""Generations of an island after which its kind of behaviour shows, at the latest."""
PATIENCE = 150
"""Generations without a rise after which a start may be over, and another begins."""
PATIENCE_SHARE = 0.125
"""The same as a share of all generations: the longer a search may take, the longer a start may stand still."""
RISE = 0.01
"""Share of the promise that counts as a rise."""
ALIKE = 0.03
"""Share of what was reached within which several starts of a kind are taken to have reached the same."""
LAST_SHARE = 0.2
"""Share of the generations after the survey in which the best starts go on."""


@dataclass
class Island:
    """One search, kept to one side of one channel: ``side`` is +1 above, -1 below, 0 for no such limit.

    ``best`` are the best candidates of its last generation, best first, and ``scores`` what they scored.
    """

    name: str
    channel: str
    side: int
    strategy: EvolutionStrategy
    best: Array
    scores: Array
    kind: int
    promises: list[float] = field(default_factory=list)
    age: int = 0
    peak: float = -np.inf
    peak_age: int = 0
    behaviour: Array = field(default_factory=lambda: np.empty(0))

    @property
    def smoothed_quantile(self) -> float:
        """The 80 % quantile of the fitness of a generation, the mean of the last few; -inf before the first."""
        return float(np.mean(self.promises)) if self.promises else -np.inf

    def stagnated(self, patience: int) -> bool:
        """Whether it has not risen for ``patience`` generations, so that another start is worth more."""
        return self.age - self.peak_age >= patience

    def bias(self, names: Sequence[str]) -> float:
        """Return how much longer its better half is above than below neutral in its channel, as a share of the time."""
        above, below = (self.behaviour[names.index(f"{self.channel} {side}")] for side in (ABOVE, BELOW))
        return float(above - below)

    def tell(self, population: Array, fitness: Array, behaviour: Array, off: Array) -> None:
        """Report a generation: fitness (P,), behaviour (P, d), and how far it is ``off`` the niche (P,), 0 inside."""
        inside = off <= 0.0
        least, most = float(fitness.min()), float(fitness.max())
        span = most - least if -np.inf < least < most else 1.0
        ranked = np.where(inside, fitness, least - span * (1.0 + off))
        order = np.argsort(-ranked, kind="stable")
        self.best, self.scores = population[order[:KEPT]].copy(), ranked[order[:KEPT]].copy()
        reached = np.sort(fitness[inside])
        some = inside.any() and reached[int(QUANTILE * (len(reached) - 1))] > -np.inf  # of -inf a quantile is nan
        promise = float(np.quantile(reached, QUANTILE)) if some else -np.inf
        self.promises = [*self.promises, promise][-LAST:]
        self.age += 1
        if self.smoothed_quantile > self.peak + RISE * abs(self.peak) or not np.isfinite(self.peak):
            self.peak, self.peak_age = self.smoothed_quantile, self.age
        self.behaviour = behaviour[order[: max(1, int(inside.sum()) // 2)]].mean(axis=0)
        self.strategy.tell(population, ranked)


@register_strategy("niches")
class Niches(EvolutionStrategy):
    """Searches of different kinds of behaviour side by side, each with its share of the budget.

    First a *survey*: one search by ``strategy``, a spec, for each side of each control, kept to candidates
    whose control is more of the time above its neutral value than below, or the other way round (for a car:
    forwards, backwards, left, right). A candidate outside the niche of its island ranks below all inside. Of
    these islands ``slots`` go on, one of each *kind*: both sides of the control that divides behaviour most, then
    of the next, whatever they promise, so that a kind that climbs slowly is not lost to one that climbs fast. In
    every generation ``slots`` islands are asked. One that has not risen for long is over, and its slot goes to a
    new start, of the kind with the fewest starts; not of one whose starts all reached the same, for there nothing
    more is to be found. At the end the best starts of all go on. Every start gives a finalist.

    ``channels`` names other channels by which the first niches are told apart, joined by ``+``. Where nobody
    counts behaviour there is one niche. After niching by clearing (Petrowski 1996), with covariance matrix
    adaptation and restarts (Auger and Hansen 2005) in each niche.
    """

    def __init__(
        self, *, n_parameters: int, seed: int, strategy: str = "cma_es", slots: int = 2, channels: str = ""
    ) -> None:
        if n_parameters < 1 or slots < 1:
            raise InvalidArgument(f"niches: expected n_parameters and slots >= 1, got {n_parameters} and {slots}")
        strategies.check(strategy)
        self.n_parameters, self.seed = n_parameters, seed
        self.spec, self.slots, self.channels = Spec.parse(strategy), slots, channels
        self.generation = 0
        self._made: list[Island] = []
        self._chosen: list[int] = []
        self._running: list[int] = []
        self._asked: list[tuple[int, int]] = []

    @property
    def islands(self) -> list[Island]:
        """Every island: those of the survey, then the further starts."""
        if not self._made:
            for number, side in enumerate(self._sides()):
                self._made.append(self._island(number, *side))
        return self._made

    @property
    def active(self) -> list[Island]:
        """The islands from which the champion may come: all starts of the kinds that were chosen."""
        return [island for island in self.islands if island.kind in self._chosen] if self._chosen else self.islands

    @property
    def elite(self) -> Array:
        """The best of the islands that go on, best first."""
        found = np.concatenate([island.best for island in self.active])
        scores = np.concatenate([island.scores for island in self.active])
        return found[np.argsort(-scores, kind="stable")]

    @property
    def finals(self) -> Mapping[str, Array]:
        return {island.name: island.best for island in self.active if island.age}

    def forget_fitness(self) -> None:
        for island in self.islands:
            island.promises, island.scores = [], np.full(len(island.scores), -np.inf)
            island.strategy.forget_fitness()

    @property
    def status(self) -> str:
        """What goes on, in a few words."""
        best = max(self.active, key=lambda island: island.smoothed_quantile)
        return f"{len(self.active)} niches, best {best.name}"

    @property
    def state(self) -> StrategyState:
        found: dict[str, Array | int | float | str] = {
            "generation": self.generation,
            "kinds": np.array([island.kind for island in self.islands], dtype=np.float64),
            "chosen": np.array(self._chosen, dtype=np.float64),
            "running": np.array(self._running, dtype=np.float64),
        }
        for number, island in enumerate(self.islands):
            own = {
                "best": island.best.copy(),
                "scores": island.scores.copy(),
                "promises": np.array(island.promises, dtype=np.float64),
                "behaviour": island.behaviour.copy(),
                "age": island.age,
                "peak": island.peak,
                "peak_age": island.peak_age,
                **{f"strategy/{name}": value for name, value in island.strategy.state.items()},
            }
            found |= {f"{number}/{name}": value for name, value in own.items()}
        return found

    def restore(self, state: StrategyState) -> None:
        if not {"generation", "kinds", "chosen", "running"} <= set(state):
            raise InvalidArgument(
                f"niches: expected a state with generation, kinds, chosen, running, got {sorted(state)}"
            )
        self._made = []
        surveyed = len(self.islands)
        kinds = [int(i) for i in check_shape("state: kinds", state["kinds"], (None,))]
        running, chosen = (
            [int(i) for i in check_shape(f"state: {name}", state[name], (None,))] for name in ("running", "chosen")
        )
        if kinds[:surveyed] != list(range(surveyed)) or any(not 0 <= kind < surveyed for kind in kinds):
            raise InvalidArgument(f"niches: expected islands that begin with a survey of {surveyed}, got kinds {kinds}")
        if any(not 0 <= i < len(kinds) for i in (*running, *chosen)):
            raise InvalidArgument(f"niches: expected some of {len(kinds)} islands to run, got {running} and {chosen}")
        for kind in kinds[surveyed:]:
            self._start(kind)
        for number, island in enumerate(self.islands):
            own = {name.partition("/")[2]: value for name, value in state.items() if name.startswith(f"{number}/")}
            if not {"best", "scores", "promises", "behaviour", "age", "peak", "peak_age"} <= set(own):
                raise InvalidArgument(f"niches: the state lacks island {number}")
            island.best = check_shape("state: best", own.pop("best"), (None, self.n_parameters)).copy()
            island.scores = check_shape("state: scores", own.pop("scores"), (len(island.best),)).copy()
            island.promises = check_shape("state: promises", own.pop("promises"), (None,)).tolist()
            island.behaviour = check_shape("state: behaviour", own.pop("behaviour"), (None,)).copy()
            island.age, island.peak_age = int(own.pop("age")), int(own.pop("peak_age"))
            island.peak = float(own.pop("peak"))
            island.strategy.restore({name.partition("/")[2]: value for name, value in own.items()})
        self.generation, self._running, self._chosen = int(state["generation"]), running, chosen

    def ask(self) -> Array:
        count, first = len(self.islands), self.generation * self.slots
        turn = self._running or sorted({(first + i) % count for i in range(self.slots)})
        populations = [self.islands[i].strategy.ask() for i in turn]
        self._asked = [(i, len(population)) for i, population in zip(turn, populations, strict=True)]
        return np.concatenate(populations)

    def _update(self, population: Array, fitness: Array, behaviour: Array) -> None:
        begin = 0
        for index, count in self._asked:
            part, island = slice(begin, begin + count), self.islands[index]
            off = self._off(island, behaviour[part])
            island.tell(population[part], fitness[part], behaviour[part], off)
            begin += count
        self.generation += 1
        if self.generation == self._survey:
            self._chosen = self._choose()
            self._running = list(self._chosen)
        elif self.generation == self._end:
            going = [i for i, island in enumerate(self.islands) if island.kind in self._chosen]
            self._running = sorted(going, key=lambda i: -self.islands[i].smoothed_quantile)[: self.slots]
        elif self._survey < self.generation < self._end:
            self._running = [
                self._start(self._next_restart()) if self.islands[i].stagnated(self._patience) else i
                for i in self._running
            ]

    @property
    def _total(self) -> int:
        return self.generations or USUAL_GENERATIONS

    @property
    def _patience(self) -> int:
        return max(PATIENCE, int(PATIENCE_SHARE * self._total))

    @property
    def _survey(self) -> int:
        """How many generations the survey takes, all islands together."""
        count = len(self._sides())
        turns = -(-count // self.slots)
        if count <= self.slots:
            return 1
        return turns * max(1, min(LONGEST_SURVEY, int(SURVEY_SHARE * self._total) // turns))

    @property
    def _end(self) -> int:
        """The generation from which no further start begins."""
        return self._total - int(LAST_SHARE * (self._total - self._survey))

    def _start(self, kind: int) -> int:
        """Begin a further search of a kind; return its number."""
        first = self.islands[kind]
        self._made.append(self._island(len(self._made), first.channel, first.side, kind))
        return len(self._made) - 1

    def _next_restart(self) -> int:
        """Return the kind of which a further start promises most."""
        starts = {kind: [island for island in self.islands if island.kind == kind] for kind in self._chosen}
        open_ones = [
            kind
            for kind in self._chosen
            if not _converged([one.peak for one in starts[kind] if one.stagnated(self._patience)])
        ]
        return min(
            open_ones or self._chosen,
            key=lambda kind: (len(starts[kind]), -max(island.peak for island in starts[kind])),
        )

    def _off(self, island: Island, behaviour: Array) -> Array:
        """Return how far candidates are on the wrong side (P,), in shares of the time; 0 inside the niche."""
        if island.side == 0:
            return np.zeros(len(behaviour))
        above, below = (behaviour[:, self.behaviour_names.index(f"{island.channel} {side}")] for side in (ABOVE, BELOW))
        return np.maximum(0.0, -island.side * (above - below))

    def _island(self, number: int, channel: str, side: int, kind: int | None = None) -> Island:
        strategy = make_strategy(self.spec, n_parameters=self.n_parameters, seed=derived_seed(self.seed, number))
        niche = ANYTHING if side == 0 else f"{channel} {ABOVE if side > 0 else BELOW}"
        earlier = sum(island.channel == channel and island.side == side for island in self._made)
        name = f"{niche} #{earlier + 1}" if earlier else niche
        elite = strategy.elite
        best, scores = elite.copy(), np.full(len(elite), -np.inf)
        return Island(name, channel, side, strategy, best, scores, number if kind is None else kind)

    def _sides(self) -> list[tuple[str, int]]:
        """Return the channel and side of each island of the survey, at least one for each slot."""
        channels = self.channels.split("+") if self.channels else self.control_names
        counted = [channel for channel in channels if f"{channel} {ABOVE}" in self.behaviour_names]
        if self.channels and len(counted) < len(channels):
            there = dict.fromkeys(name.rpartition(" ")[0] for name in self.behaviour_names)
            raise InvalidArgument(f"niches: channels are {', '.join(there) or 'not counted'}, got {self.channels!r}")
        sides = [(channel, side) for channel in counted for side in (1, -1)] or [("", 0)]
        return sides * -(-self.slots // len(sides))

    def _choose(self) -> list[int]:
        """Return ``slots`` islands of the survey: both sides of the channels that divide behaviour most."""
        sides = range(len(self._sides()))
        apart: dict[str, float] = dict.fromkeys((self.islands[i].channel for i in sides), 0.0)
        for island in (self.islands[i] for i in sides if self.islands[i].side):
            apart[island.channel] += island.side * island.bias(self.behaviour_names)

        def first(i: int) -> tuple[bool, float, float]:
            island = self.islands[i]
            return not np.isfinite(island.smoothed_quantile), -apart[island.channel], -island.smoothed_quantile

        return sorted(sides, key=first)[: self.slots]


def _converged(reached: list[float]) -> bool:
    """Whether several starts that are over reached the same, so that another one would as well."""
    return len(reached) > 1 and max(reached) - min(reached) <= ALIKE * abs(max(reached))
