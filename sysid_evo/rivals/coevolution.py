"""Competitive co-evolution: two populations of controllers, each measured by its lead over the other's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from sysid_evo.arrays import Array, Seeds, check_shape
from sysid_evo.checkpoint import Checkpoint, State
from sysid_evo.controllers.controller import Controller
from sysid_evo.engine import Runner
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.champion import Champion, Finalist
from sysid_evo.evolution.controllers import ControllerEvolution, run_seed, selection_seeds
from sysid_evo.evolution.loop import Generation, Scores, evolve
from sysid_evo.evolution.meeting import met
from sysid_evo.evolution.runs import identity
from sysid_evo.evolution.strategy import EvolutionStrategy
from sysid_evo.progress import Progress
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_aggregate
from sysid_evo.rivals.bodies import TwoBodies
from sysid_evo.rivals.meeting import bodies_of, duel_of, leads
from sysid_evo.rivals.race import Race
from sysid_evo.system import System

OPPONENTS = 4
"""Opponents that every candidate meets in a generation."""
EVERY = 5
"""Generations from one former champion that is remembered to the next."""
LAST = 10
"""Best of the last generation, and latest former champions, among which each population's champion is chosen."""


@dataclass
class Population:
    """One of the populations: its strategy, the best of former generations (H, n), and its history (G, 3)."""

    strategy: EvolutionStrategy
    hall: Array
    history: Array = field(default_factory=lambda: np.empty((0, 3)))

    def opponents(self, rng: np.random.Generator) -> Array:
        """Return ``OPPONENTS`` of its present parents and of its hall of fame in turn, at random, (OPPONENTS, n)."""
        parents = self.strategy.elite
        hall = self.hall if len(self.hall) else parents
        groups = (parents if number % 2 == 0 else hall for number in range(OPPONENTS))
        return np.stack([group[rng.integers(len(group))] for group in groups])

    def tell(self, generation: Generation) -> None:
        """Remember what a generation reached, and every few generations its best."""
        self.history = np.concatenate([self.history, [generation.summary]])
        if (generation.index + 1) % EVERY == 0:
            best = generation.population[int(np.argmax(generation.fitness))]
            self.hall = np.concatenate([self.hall, [best]])

    @property
    def contenders(self) -> Array:
        """The candidates among which its champion is chosen, (K, n)."""
        return np.concatenate([self.strategy.elite[:LAST], self.hall[-LAST:]])


@dataclass(frozen=True)
class Rivalry:
    """The lead of candidates over opponents on all of ``bodies`` in the trials of a generation, made one fitness."""

    bodies: tuple[TwoBodies, ...]
    law: Controller
    race: Race
    aggregate: str

    def __call__(self, candidates: Array, opponents: Array, seeds: Seeds) -> Scores:
        """Return what ``candidates`` (P, n) score against ``opponents`` (K, n) in the trials of ``seeds`` (E,)."""
        fitness = np.stack(
            [leads(two, self.law, self.race, candidates, opponents, seeds) for two in self.bodies]
        ).reshape(len(self.bodies), len(candidates), -1)
        return Scores(make_aggregate(self.aggregate).in_population(fitness), by_model=fitness.mean(axis=2))


def evolve_rivals(
    name: str,
    runners: Mapping[str, Runner],
    system: System,
    settings: ControllerEvolution,
    *,
    seed: int,
    populations: int = 2,
    checkpoint: Checkpoint | None = None,
    progress: Progress | None = None,
) -> tuple[Champion, ...]:
    """Evolve controllers against each other in races on all of ``runners``, and return the champion of each population.

    The task of ``settings`` is a `Duel`. In every generation a candidate of one population meets ``OPPONENTS`` of the
    other, parents and former champions by turns, in ``trials`` trials; fitness is its mean lead (m), one of several
    models by the ``aggregate``. With ``populations=1`` it is its own rival. Each champion has the greatest lead over
    the other's last parents and former champions in ``selection_trials`` fresh trials: that is the
    fitness of its only finalist. There is one run, without stages; strategies see no behaviour. The result depends on
    ``seed`` alone; with a ``checkpoint`` an evolution that was stopped goes on where it was. Raises `InvalidArgument`
    for settings that do not fit, `IncompatibleSystem`.

    Source: Togelius and Lucas, "Arms races and car races", PPSN IX (2006).
    """
    if populations not in (1, 2):
        raise InvalidArgument(f"rivals: expected one or two populations, got {populations}")
    if settings.schedule or settings.runs > 1:
        raise InvalidArgument("rivals: expected one run without a schedule")
    duel = duel_of(settings.task)
    two = bodies_of(met(runners, settings), system)
    law = settings.make_controller(duel.bind(system))
    rivalry = Rivalry(tuple(two.values()), law, Race(duel), settings.aggregate)
    sides = [_begun(settings, system, law, seed, side) for side in range(populations)]
    owner = (
        ""
        if checkpoint is None
        else identity(["rivals", populations, repr(settings)], runners, law, duel.bind(system), seed)
    )
    found = None if checkpoint is None else checkpoint.load(owner)
    if found is not None:
        _restore(sides, found)

    def objective(side: int, candidates: Array, generation: int) -> Scores:
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(generation, side)))
        opponents = sides[(side + 1) % populations].opponents(rng)
        return rivalry(candidates, opponents, trial_seeds(run_seed(seed, side), settings.trials, generation=generation))

    start = len(sides[0].history)
    loops = [
        evolve(one.strategy, partial(objective, side), settings.generations, start=start)
        for side, one in enumerate(sides)
    ]
    kept = saved = _state(sides)
    try:
        for generations in zip(*loops, strict=True):
            for one, generation in zip(sides, generations, strict=True):
                one.tell(generation)
            kept = _state(sides)
            if checkpoint is not None and checkpoint.due():
                checkpoint.save(owner, kept)
                saved = kept
            if progress is not None:
                best = ", ".join(f"{generation.fitness.max():+.1f}" for generation in generations)
                progress(generations[0].index + 1, settings.generations, f"best lead {best} m")
    finally:  # Ctrl-C, too
        if checkpoint is not None and kept is not saved:
            checkpoint.save(owner, kept)
    seeds = selection_seeds(seed, settings.selection_trials)
    return tuple(
        _champion(
            f"{name}-{side + 1}", side, one, sides[(side + 1) % populations], rivalry, seeds, runners, settings, seed
        )
        for side, one in enumerate(sides)
    )


def _begun(settings: ControllerEvolution, system: System, law: Controller, seed: int, side: int) -> Population:
    strategy = settings.make_strategy(law.n_parameters, run_seed(seed, side))
    strategy.prepare(behaviour_names=(), control_names=system.control_names, generations=settings.generations)
    return Population(strategy, np.empty((0, law.n_parameters)))


def _champion(
    name: str,
    side: int,
    own: Population,
    other: Population,
    rivalry: Rivalry,
    seeds: Seeds,
    runners: Mapping[str, Runner],
    settings: ControllerEvolution,
    seed: int,
) -> Champion:
    candidates = own.contenders
    fitness = rivalry(candidates, other.contenders, seeds).fitness
    best = int(np.argmax(fitness))
    return Champion(
        name=name,
        parameters=candidates[best],
        against=tuple(runners),
        aggregate=settings.aggregate,
        seed=seed,
        history=own.history,
        controller=settings.controller,
        task=settings.task,
        estimator_delay=settings.estimator_delay,
        noise=settings.noise,
        caution=settings.caution,
        seed_fitness=(float(fitness[best]),),
        system=next(iter(rivalry.bodies)).inner.system,
        finalists=(Finalist("", side, float(fitness[best]), candidates[best]),),
        population=own.strategy.elite,
    )


def _state(sides: list[Population]) -> State:
    """Return all that changes, by the number of the population."""
    state: dict[str, Array | int | float | str] = {}
    for number, one in enumerate(sides):
        state |= {f"{number}.hall": one.hall, f"{number}.history": one.history}
        state |= {f"{number}.strategy.{name}": value for name, value in one.strategy.state.items()}
    return state


def _restore(sides: list[Population], state: State) -> None:
    """Let new populations go on from ``state``."""
    for number, one in enumerate(sides):
        prefix = f"{number}.strategy."
        one.hall = check_shape("hall", state[f"{number}.hall"], (None, one.strategy.n_parameters))
        one.history = check_shape("history", state[f"{number}.history"], (None, 3))
        if len(one.history):
            one.strategy.restore(
                {name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)}
            )
