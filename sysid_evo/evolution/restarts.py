"""A search that begins anew, with more candidates, where it no longer gets better."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sysid_evo.arrays import Array, check_shape
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.strategy import EvolutionStrategy, StrategyState
from sysid_evo.registry import Spec, make_strategy, register_strategy, strategies

SIZES = ("population", "parents", "children")
"""Parameters of a strategy that say how many candidates it asks for: these grow."""
KEPT = 15
"""Best candidates of the last generation of a start that are remembered."""
LAST = 10
"""Generations over whose best the mean is taken, since fitness is noisy."""
REMEMBERED = 8
"""Starts that give a finalist: the best."""


@dataclass
class Start:
    """What one start ended with, or has at present: its candidates (K, n), best first, and their fitness (K,)."""

    number: int
    best: Array
    scores: Array


@register_strategy("restarts")
class Restarts(EvolutionStrategy):
    """Begins ``strategy``, a spec, anew where it is stuck, each time with ``growth`` times the candidates.

    Stuck is a start whose best of a generation, the mean of the last few, has not risen by more than ``rise``
    of its value for ``patience`` generations. The next one has another seed. What the strategy calls
    ``population``, ``parents`` or ``children`` grows, so that later generations cost more rollouts. No start
    begins where fewer than ``patience`` generations are left. Each of the best starts gives a finalist. With
    ``cma_es`` this is the IPOP-CMA-ES of Auger and Hansen (2005), with one rule of stopping for their many.
    """

    def __init__(
        self,
        *,
        n_parameters: int,
        seed: int,
        strategy: str = "cma_es",
        patience: int = 60,
        growth: float = 2.0,
        rise: float = 0.01,
    ) -> None:
        if n_parameters < 1 or patience < 1 or not 1.0 <= growth < np.inf or not 0.0 <= rise < np.inf:
            raise InvalidArgument(
                "restarts: expected n_parameters, patience, growth >= 1 and rise >= 0, "
                f"got {n_parameters}, {patience}, {growth} and {rise}"
            )
        self.spec = strategies.check(strategy)
        self._sizes = {
            name: self.spec.parameters.get(name, default)
            for name, default in strategies.parameters(self.spec.name).items()
            if name in SIZES
        }
        if growth > 1.0 and not self._sizes:
            raise InvalidArgument(
                f"restarts: strategy {self.spec.name!r} has no parameter {', '.join(SIZES)} "
                "that could grow; use growth=1"
            )
        self.n_parameters, self.seed = n_parameters, seed
        self.patience, self.growth, self.rise = patience, growth, rise
        self.generation = 0
        self._ended: list[Start] = []
        self._recent: list[float] = []
        self._begin(0)

    def forget_fitness(self) -> None:
        """Forget earlier starts, and what the present one scored; it goes on."""
        self._search.forget_fitness()
        self._now.scores = np.full(len(self._now.best), -np.inf)
        self._ended, self._recent = [], []
        self._mark, self._waited = -math.inf, 0

    def prepare(
        self, *, behaviour_names: tuple[str, ...], control_names: tuple[str, ...], generations: int | None = None
    ) -> None:
        super().prepare(behaviour_names=behaviour_names, control_names=control_names, generations=generations)
        self._prepare_search()

    @property
    def elite(self) -> Array:
        starts = self._starts()
        scores = np.concatenate([start.scores for start in starts])
        return np.concatenate([start.best for start in starts])[np.argsort(-scores, kind="stable")]

    @property
    def finals(self) -> Mapping[str, Array]:
        return {f"start {start.number + 1}": start.best for start in self._starts()}

    @property
    def needed(self) -> int | None:
        """What the strategy needs, and those that are remembered."""
        inner = self._search.needed
        return None if inner is None else max(inner, KEPT)

    @property
    def status(self) -> str:
        """What goes on, in a few words."""
        return f"start {self._now.number + 1}, best {self._starts()[0].number + 1}"

    @property
    def state(self) -> StrategyState:
        starts = {
            f"{place}/{name}": value
            for place, start in enumerate([*self._ended, self._now])
            for name, value in (
                ("number", start.number), ("best", start.best.copy()), ("scores", start.scores.copy()),
            )
        }  # fmt: skip
        search = {f"strategy/{name}": value for name, value in self._search.state.items()}
        counted = {"generation": self.generation, "starts": len(self._ended) + 1, "waited": self._waited}
        return {**counted, "mark": self._mark, "recent": np.array(self._recent, dtype=np.float64), **starts, **search}

    def restore(self, state: StrategyState) -> None:
        if not {"generation", "starts", "waited", "mark", "recent"} <= set(state):
            raise InvalidArgument(
                f"restarts: expected a state with generation, starts, waited, mark and recent, got {sorted(state)}"
            )
        starts = [self._start_of(state, place) for place in range(int(state["starts"]))]
        if not starts:
            raise InvalidArgument("restarts: expected a state with one start or more, got none")
        self._begin(starts[-1].number)
        self._search.restore(
            {name.removeprefix("strategy/"): value for name, value in state.items() if name.startswith("strategy/")}
        )
        *self._ended, self._now = starts
        self._recent = check_shape("state: recent", state["recent"], (None,)).tolist()
        self._mark, self._waited = float(state["mark"]), int(state["waited"])
        self.generation = int(state["generation"])

    def ask(self) -> Array:
        return self._search.ask()

    def _update(self, population: Array, fitness: Array, behaviour: Array) -> None:
        self._search.tell(population, fitness, behaviour, self.by_model)
        order = np.argsort(-fitness, kind="stable")[:KEPT]
        self._now.best, self._now.scores = population[order].copy(), fitness[order].copy()
        self._recent = [*self._recent, float(fitness.max())][-LAST:]
        self.generation += 1
        level = sum(self._recent) / len(self._recent)
        if level > self._mark and (math.isinf(self._mark) or level - self._mark > self.rise * abs(self._mark)):
            self._mark, self._waited = level, 0
        else:
            self._waited += 1
        left = math.inf if self.generations is None else self.generations - self.generation
        if self._waited >= self.patience <= left:
            number = self._now.number + 1
            self._ended = self._starts()[: REMEMBERED - 1]
            self._begin(number)

    def _begin(self, number: int) -> None:
        """Begin start ``number``, counted from 0."""
        sizes = {name: round(size * self.growth**number) for name, size in self._sizes.items()}
        spec = Spec(self.spec.name, {**self.spec.parameters, **sizes})
        seed = int(np.random.SeedSequence(self.seed, spawn_key=(number,)).generate_state(1, np.uint32)[0])
        self._search = make_strategy(spec, n_parameters=self.n_parameters, seed=seed)
        self._prepare_search()
        elite = self._search.elite.copy()
        self._now = Start(number, elite, np.full(len(elite), -np.inf))
        self._recent = []
        self._mark, self._waited = -math.inf, 0

    def _prepare_search(self) -> None:
        left = None if self.generations is None else self.generations - self.generation
        self._search.prepare(behaviour_names=self.behaviour_names, control_names=self.control_names, generations=left)

    def _starts(self) -> list[Start]:
        """Return the starts that are remembered and the present one, that with the best candidate first."""
        return sorted([*self._ended, self._now], key=lambda start: -float(start.scores.max()))

    def _start_of(self, state: StrategyState, place: int) -> Start:
        lacking = {f"{place}/{name}" for name in ("number", "best", "scores")} - set(state)
        if lacking:
            raise InvalidArgument(f"restarts: the state lacks {', '.join(sorted(lacking))}")
        best = check_shape("state: best", state[f"{place}/best"], (None, self.n_parameters)).copy()
        scores = check_shape("state: scores", state[f"{place}/scores"], (len(best),)).copy()
        return Start(int(state[f"{place}/number"]), best, scores)
