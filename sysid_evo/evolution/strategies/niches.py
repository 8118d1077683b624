"""Islands for different classes of behaviour, so that a broad but low optimum does not take the whole budget."""

from __future__ import annotations

from collections.abc import Mapping
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
AVERAGED_GENERATIONS = 20
"""Generations over which the 80 % quantile of an island is averaged."""
N_KEPT = 15
"""Candidates of an island among which its finalist is chosen."""
DEFAULT_GENERATIONS = 300
INITIAL_SHARE = 0.2
MAX_INITIAL = 75
"""Most generations of an island in the initial phase; by then its behaviour is visible."""
PATIENCE = 150
"""An island without improvement in this number of generations has stagnated, and a restart takes its slot."""
PATIENCE_SHARE = 0.125
"""The same as a share of all generations; the larger of the two numbers counts."""
MIN_RISE = 0.01
"""Relative increase of the smoothed quantile that counts as an improvement."""
TOLERANCE = 0.03
"""Several islands of one class have converged to the same fitness if it differs by at most this share."""
LAST_SHARE = 0.2
"""Share of the generations after the initial phase in which only the best islands continue."""


@dataclass
class Island:
    """One search, restricted to one side of one channel: ``side`` is +1 above, -1 below, 0 for no restriction.

    ``best``, ``scores``: best candidates of the last generation; ``behaviour_class``: number of the first such island.
    """

    name: str
    channel: str
    side: int
    strategy: EvolutionStrategy
    best: Array
    scores: Array
    behaviour_class: int
    quantiles: list[float] = field(default_factory=list)
    age: int = 0
    peak: float = -np.inf
    peak_age: int = 0
    behaviour: Array = field(default_factory=lambda: np.empty(0))

    @property
    def smoothed_quantile(self) -> float:
        """The 80 % quantile of the fitness, averaged over the last generations; -inf before the first."""
        return float(np.mean(self.quantiles)) if self.quantiles else -np.inf

    def stagnated(self, patience: int) -> bool:
        """True if it has not improved for ``patience`` generations."""
        return self.age - self.peak_age >= patience

    def tell(self, population: Array, fitness: Array, behaviour: Array, off: Array) -> None:
        """Report a generation: fitness (P,), behaviour (P, d), and distance ``off`` the niche (P,), 0 inside."""
        inside = off <= 0.0
        lowest, highest = float(fitness.min()), float(fitness.max())
        span = highest - lowest if -np.inf < lowest < highest else 1.0
        ranked = np.where(inside, fitness, lowest - span * (1.0 + off))
        order = np.argsort(-ranked, kind="stable")
        self.best, self.scores = population[order[:N_KEPT]].copy(), ranked[order[:N_KEPT]].copy()
        reached = np.sort(fitness[inside])
        finite = inside.any() and reached[int(QUANTILE * (len(reached) - 1))] > -np.inf  # np.quantile of -inf is nan
        quantile = float(np.quantile(reached, QUANTILE)) if finite else -np.inf
        self.quantiles = [*self.quantiles, quantile][-AVERAGED_GENERATIONS:]
        self.age += 1
        if self.smoothed_quantile > self.peak + MIN_RISE * abs(self.peak) or not np.isfinite(self.peak):
            self.peak, self.peak_age = self.smoothed_quantile, self.age
        self.behaviour = behaviour[order[: max(1, int(inside.sum()) // 2)]].mean(axis=0)
        self.strategy.tell(population, ranked)


@register_strategy("niches")
class Niches(EvolutionStrategy):
    """Parallel searches (islands) for different classes of behaviour, each with its share of the budget.

    - Initial phase: one search by ``strategy`` (a spec) for each side of each control. An island is restricted to
      candidates whose control is above its neutral value for more of the time than below, or the reverse (for a car:
      forwards, backwards, left, right). A candidate outside the niche ranks below all candidates inside.
    - Then ``slots`` islands continue: both sides of the control that separates behaviour most, then of the next one.
      Fitness does not decide here, so that a class that improves slowly is not lost. Each generation evaluates
      ``slots`` islands. When an island stagnates, its slot goes to a restart in the class with the fewest islands,
      except in a class whose islands have converged to the same fitness.
    - In the last phase only the best islands continue. Each island gives a finalist.

    ``channels`` names other channels for the initial niches, joined by ``+``. Without behaviour descriptors there is
    one niche. Sources: niching by clearing (Petrowski 1996); CMA-ES with restarts (Auger and Hansen 2005).
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
        self._sizes: list[tuple[int, int]] = []

    @property
    def islands(self) -> list[Island]:
        """All islands: those of the initial phase, then the restarts."""
        if not self._made:
            for number, side in enumerate(self._sides()):
                self._made.append(self._island(number, *side))
        return self._made

    @property
    def active(self) -> list[Island]:
        """The islands that give finalists: all islands of the chosen behaviour classes."""
        return [one for one in self.islands if not self._chosen or one.behaviour_class in self._chosen]

    @property
    def elite(self) -> Array:
        """The best candidates of the active islands, best first."""
        found = np.concatenate([island.best for island in self.active])
        scores = np.concatenate([island.scores for island in self.active])
        return found[np.argsort(-scores, kind="stable")]

    @property
    def finals(self) -> Mapping[str, Array]:
        return {island.name: island.best for island in self.active if island.age}

    def forget_fitness(self) -> None:
        for island in self.islands:
            island.quantiles, island.scores = [], np.full(len(island.scores), -np.inf)
            island.strategy.forget_fitness()

    @property
    def status(self) -> str:
        """One-line status for the progress display."""
        best = max(self.active, key=lambda island: island.smoothed_quantile)
        side = f", best with {best.channel} mostly {ABOVE if best.side > 0 else BELOW} neutral" if best.side else ""
        return f"{len(self.active)} niches{side}"

    @property
    def state(self) -> StrategyState:
        found: dict[str, Array | int | float | str] = {
            "generation": self.generation,
            "behaviour_classes": np.array([island.behaviour_class for island in self.islands], dtype=np.float64),
            "chosen": np.array(self._chosen, dtype=np.float64),
            "running": np.array(self._running, dtype=np.float64),
        }
        for number, island in enumerate(self.islands):
            own = {
                "best": island.best.copy(),
                "scores": island.scores.copy(),
                "quantiles": np.array(island.quantiles, dtype=np.float64),
                "behaviour": island.behaviour.copy(),
                "age": island.age,
                "peak": island.peak,
                "peak_age": island.peak_age,
                **{f"strategy/{name}": value for name, value in island.strategy.state.items()},
            }
            found |= {f"{number}/{name}": value for name, value in own.items()}
        return found

    def restore(self, state: StrategyState) -> None:
        if not {"generation", "behaviour_classes", "chosen", "running"} <= set(state):
            raise InvalidArgument(
                f"niches: expected a state with generation, behaviour_classes, chosen, running, got {sorted(state)}"
            )
        self._made = []
        initial = len(self.islands)
        classes = [int(i) for i in check_shape("state: behaviour_classes", state["behaviour_classes"], (None,))]
        running, chosen = (
            [int(i) for i in check_shape(f"state: {name}", state[name], (None,))] for name in ("running", "chosen")
        )
        if classes[:initial] != list(range(initial)) or any(not 0 <= one < initial for one in classes):
            raise InvalidArgument(
                f"niches: expected behaviour classes that begin with 0 to {initial - 1}, got {classes}"
            )
        if any(not 0 <= i < len(classes) for i in (*running, *chosen)):
            raise InvalidArgument(f"niches: expected running, chosen below {len(classes)}, got {running}, {chosen}")
        for behaviour_class in classes[initial:]:
            self._restart(behaviour_class)
        for number, island in enumerate(self.islands):
            own = {name.partition("/")[2]: value for name, value in state.items() if name.startswith(f"{number}/")}
            if not {"best", "scores", "quantiles", "behaviour", "age", "peak", "peak_age"} <= set(own):
                raise InvalidArgument(f"niches: the state lacks island {number}")
            island.best = check_shape("state: best", own.pop("best"), (None, self.n_parameters)).copy()
            island.scores = check_shape("state: scores", own.pop("scores"), (len(island.best),)).copy()
            island.quantiles = check_shape("state: quantiles", own.pop("quantiles"), (None,)).tolist()
            island.behaviour = check_shape("state: behaviour", own.pop("behaviour"), (None,)).copy()
            island.age, island.peak_age = int(own.pop("age")), int(own.pop("peak_age"))
            island.peak = float(own.pop("peak"))
            island.strategy.restore({name.partition("/")[2]: value for name, value in own.items()})
        self.generation, self._running, self._chosen = int(state["generation"]), running, chosen

    def ask(self) -> Array:
        count, first = len(self.islands), self.generation * self.slots
        active_islands = self._running or sorted({(first + i) % count for i in range(self.slots)})
        populations = [self.islands[i].strategy.ask() for i in active_islands]
        self._sizes = [(i, len(population)) for i, population in zip(active_islands, populations, strict=True)]
        return np.concatenate(populations)

    def _update(self, population: Array, fitness: Array, behaviour: Array) -> None:
        begin = 0
        for index, count in self._sizes:
            part, island = slice(begin, begin + count), self.islands[index]
            off = -island.side * self._bias(island, behaviour[part]) if island.side else np.zeros(count)
            island.tell(population[part], fitness[part], behaviour[part], np.maximum(0.0, off))
            begin += count
        self.generation += 1
        if self.generation == self._initial_generations:
            self._chosen = self._choose()
            self._running = list(self._chosen)
        elif self.generation == self._end:
            active = [i for i, island in enumerate(self.islands) if island.behaviour_class in self._chosen]
            self._running = sorted(active, key=lambda i: -self.islands[i].smoothed_quantile)[: self.slots]
        elif self._initial_generations < self.generation < self._end:
            self._running = [
                self._restart(self._next_restart()) if self.islands[i].stagnated(self._patience) else i
                for i in self._running
            ]

    @property
    def _total(self) -> int:
        return self.generations or DEFAULT_GENERATIONS

    @property
    def _patience(self) -> int:
        return max(PATIENCE, int(PATIENCE_SHARE * self._total))

    @property
    def _initial_generations(self) -> int:
        """Number of generations of the initial phase, all islands together."""
        count = len(self._sides())
        rounds = -(-count // self.slots)
        if count <= self.slots:
            return 1
        return rounds * max(1, min(MAX_INITIAL, int(INITIAL_SHARE * self._total) // rounds))

    @property
    def _end(self) -> int:
        """The generation from which no restart begins."""
        return self._total - int(LAST_SHARE * (self._total - self._initial_generations))

    def _restart(self, behaviour_class: int) -> int:
        """Begin a new island of a behaviour class; return its number."""
        first = self.islands[behaviour_class]
        self._made.append(self._island(len(self._made), first.channel, first.side, behaviour_class))
        return len(self._made) - 1

    def _next_restart(self) -> int:
        """Return the behaviour class of the next restart: fewest islands, then highest peak; converged classes last."""
        members = {chosen: [one for one in self.islands if one.behaviour_class == chosen] for chosen in self._chosen}
        stagnated = {
            key: [one.peak for one in found if one.stagnated(self._patience)] for key, found in members.items()
        }
        not_converged = [chosen for chosen in self._chosen if not _converged(stagnated[chosen])]
        return min(not_converged or self._chosen, key=lambda i: (len(members[i]), -max(one.peak for one in members[i])))

    def _bias(self, island: Island, behaviour: Array) -> Array:
        """Return the share of the time above neutral in the island's channel, minus that below, (...), of (..., d)."""
        above, below = (self.behaviour_names.index(f"{island.channel} {side}") for side in (ABOVE, BELOW))
        return behaviour[..., above] - behaviour[..., below]

    def _island(self, number: int, channel: str, side: int, first: int | None = None) -> Island:
        strategy = make_strategy(self.spec, n_parameters=self.n_parameters, seed=derived_seed(self.seed, number))
        niche = ANYTHING if side == 0 else f"{channel} {ABOVE if side > 0 else BELOW}"
        earlier = sum(island.channel == channel and island.side == side for island in self._made)
        name = f"{niche} #{earlier + 1}" if earlier else niche
        elite = strategy.elite
        best, scores = elite.copy(), np.full(len(elite), -np.inf)
        return Island(name, channel, side, strategy, best, scores, number if first is None else first)

    def _sides(self) -> list[tuple[str, int]]:
        """Return the channel and side of each island of the initial phase, at least one for each slot."""
        channels = self.channels.split("+") if self.channels else self.control_names
        counted = [channel for channel in channels if f"{channel} {ABOVE}" in self.behaviour_names]
        if self.channels and len(counted) < len(channels):
            known = dict.fromkeys(name.rpartition(" ")[0] for name in self.behaviour_names)
            raise InvalidArgument(f"niches: expected channels among {', '.join(known) or '-'}, got {self.channels!r}")
        sides = [(channel, side) for channel in counted for side in (1, -1)] or [("", 0)]
        return sides * -(-self.slots // len(sides))

    def _choose(self) -> list[int]:
        """Return ``slots`` islands of the initial phase: both sides of the channels that separate behaviour most.

        Example: throttle islands with biases +0.8 and -0.6 (1.4 apart) precede steering with +0.3 and -0.2 (0.5 apart).
        """
        sides = range(len(self._sides()))
        separation: dict[str, float] = dict.fromkeys((self.islands[i].channel for i in sides), 0.0)
        for island in (self.islands[i] for i in sides if self.islands[i].side):
            separation[island.channel] += island.side * float(self._bias(island, island.behaviour))

        def order(i: int) -> tuple[bool, float, float]:
            island = self.islands[i]
            return not np.isfinite(island.smoothed_quantile), -separation[island.channel], -island.smoothed_quantile

        return sorted(sides, key=order)[: self.slots]


def _converged(peaks: list[float]) -> bool:
    """True if several stagnated islands reached the same fitness; a further restart is then unlikely to help."""
    return len(peaks) > 1 and max(peaks) - min(peaks) <= TOLERANCE * abs(max(peaks))
