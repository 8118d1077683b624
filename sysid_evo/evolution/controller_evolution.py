"""Evolution of a controller against a model or an ensemble: settings, disturbed models, range of the states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from itertools import chain, product

import numpy as np

from sysid_evo.carry import clip_state
from sysid_evo.controllers.controller import Controller, make_controller
from sysid_evo.data.dataset import Dataset
from sysid_evo.engine.results import behaviour_names
from sysid_evo.engine.rollout import BoundRunner, DynamicsRunner, Runner, as_runners
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.aggregates import make_aggregate
from sysid_evo.evolution.champion import Champion, Finalist
from sysid_evo.evolution.halving import Halving, Start
from sysid_evo.evolution.loop import Objective, Scores
from sysid_evo.evolution.margins import best_candidate, lasting_fitness, margins_of
from sysid_evo.evolution.runs import FinishedRun, Runs, evolution_digest
from sysid_evo.evolution.strategies.strategy import EvolutionStrategy, make_strategy
from sysid_evo.models.disturbances import Disturbed, DomainRandomisation
from sysid_evo.models.dynamics import Dynamics, started
from sysid_evo.progress import Checkpoint, Progress, reporting
from sysid_evo.randomness import as_seed, derived_seed, trial_seeds
from sysid_evo.registry.grammar import Spec
from sysid_evo.registry.registry import aggregates, controllers, noises, strategies, tasks
from sysid_evo.system import System
from sysid_evo.tasks.task import Task, make_task
from sysid_evo.types import Array, Converted, IntArray, Seeds, check_shape


@dataclass(frozen=True)
class EnsembleObjective:
    """Fitness on all runners in ``trials`` trials, combined by ``aggregate`` (a spec).

    All candidates of a generation have the same trials on all models, keyed by (seed, generation, trial). The next
    generation has new trials.
    """

    runners: Sequence[Runner]
    controller: Controller
    task: Task
    seed: int
    trials: int = 10
    aggregate: str = "min"

    def __post_init__(self) -> None:
        aggregates.check(self.aggregate)
        if not self.runners or self.trials < 1:
            raise InvalidArgument(
                f"ensemble: expected at least one model and one trial, got {len(self.runners)} and {self.trials}"
            )

    @cached_property
    def bound(self) -> list[BoundRunner]:
        """Controller and task on each runner."""
        return [runner.bind(self.controller, self.task) for runner in self.runners]

    def __call__(self, population: Array, generation: int) -> Scores:
        """Return the scores of ``population`` (P, n) in ``generation``."""
        return self.on_trials(population, trial_seeds(self.seed, self.trials, generation=generation))

    def on_trials(self, population: Array, seeds: Seeds) -> Scores:
        """Return the scores of ``population`` (P, n) in these trials. Raises `ShapeError` if a runner skips trials."""
        shape = len(population), len(seeds)
        runs = [run(population, seeds) for run in self.bound]
        fitness = np.stack([check_shape("fitness in every trial", run.fitness, shape) for run in runs])
        described = [run.behaviour.mean(axis=1) for run in runs if run.behaviour.shape[:2] == shape]
        behaviour = np.mean(described, axis=0) if described else None
        return Scores(
            make_aggregate(self.aggregate)(fitness), behaviour, fitness.mean(axis=2), np.median(fitness, axis=0)
        )


SELECTION = 2**31
"""Generation number of the fresh trials on which champions are chosen; no run reaches it."""


@dataclass(frozen=True)
class ControllerEvolution:
    """Settings of controller evolution: numbers and specs (or their text), all storable.

    - ``trials``: trials of each candidate in each generation (paper: 10).
    - ``repeats``: number of runs, each with its own seed (paper: 2).
    - ``aggregate``: rule that combines the fitness on several models, a spec, ``NAME(parameter=value)``.
    - ``selection_trials``: fresh trials on which each behaviour class of each run selects its finalist; the champion
      is one of the finalists, see `Champion`.
    - ``estimator_delay``: delay in s with which controllers observe the state of a model, see `Disturbed`.
    - ``starts``: several ways to begin, in place of ``controller`` and ``strategy``. They share the generations by
      successive halving, see `Halving`.
    - ``noise``: domain randomisation, a spec (`DomainRandomisation`), empty for none. It acts during evolution and the
      choice of the champion, not when claims are measured.
    """

    generations: int = 300
    trials: int = 10
    repeats: int = 1
    aggregate: str = "min"
    selection_trials: int = 100
    estimator_delay: float = 0.0
    controller: Converted[Spec | str, Spec] = Converted(controllers.check, "recurrent")
    task: Converted[Spec | str, Spec] = Converted(tasks.check, "point_to_point")
    strategy: Converted[Spec | str, Spec] = Converted(strategies.check, "mu_plus_lambda")
    noise: str = ""
    starts: Converted[Sequence[Start] | str, tuple[Start, ...]] = Converted(Start.listed, ())

    def __post_init__(self) -> None:
        for name in ("generations", "trials", "repeats", "selection_trials"):
            number = getattr(self, name)
            if not isinstance(number, (int, np.integer)) or number < 1:
                raise InvalidArgument(f"evolution: expected {name} as a whole number >= 1, got {number!r}")
        if self.starts:
            Halving(len(self.starts) * self.repeats, self.generations * self.repeats)
        aggregates.check(self.aggregate)
        self.make_noise()
        if not 0.0 <= self.estimator_delay < np.inf:
            raise InvalidArgument(f"evolution: expected estimator_delay >= 0 s, got {self.estimator_delay}")

    @property
    def all_starts(self) -> tuple[Start, ...]:
        """The ``starts``, or ``controller`` and ``strategy`` as the only one."""
        return self.starts or (Start(self.controller, self.strategy),)

    def make_task(self, system: System) -> Task:
        """Return the task, bound to ``system``."""
        return make_task(self.task).bind(system)

    def make_controller(self, task: Task) -> Controller:
        """Return the controller with the inputs of ``task`` and the outputs of its system."""
        return make_controller(self.controller).bind_to(task)

    def make_noise(self) -> DomainRandomisation | None:
        """Return the domain randomisation, None without one."""
        return noises.make(self.noise) if self.noise else None

    def make_strategy(
        self, n_parameters: int, seed: int, spec: Spec | None = None, *, initial: Array | None = None,
        first_steps: Array | None = None,
    ) -> EvolutionStrategy:  # fmt: skip
        """Return the strategy, or that of ``spec``, with ``initial`` and ``first_steps`` (n,) if it has them.

        Raises `InvalidArgument` if two candidates or its state do not fit into memory.
        """
        import psutil

        spec = spec or self.strategy
        size, memory = 8e-9 * n_parameters, 1e-9 * psutil.virtual_memory().total
        try:
            if 2.0 * size > memory:
                raise MemoryError(f"two candidates take {2.0 * size:.3g} of {memory:.3g} GB of memory")
            known, given = strategies.parameters(spec.name), {INITIAL: initial, FIRST_STEPS: first_steps}
            begin = {name: value for name, value in given.items() if value is not None and name in known}
            return make_strategy(spec, n_parameters=n_parameters, seed=seed, **begin)
        except MemoryError as error:
            raise InvalidArgument(
                f"evolution: a controller of {n_parameters:,} parameters is too large for {spec} on this machine: "
                f"{error}. Use a smaller controller"
            ) from error


INITIAL, FIRST_STEPS = "initial", "first_steps"
"""Parameters of the strategies that can start from given parameters of a controller, and in steps of given sizes."""


def evolve_controller(
    name: str,
    runners: Mapping[str, Runner | Dynamics],
    system: System,
    settings: ControllerEvolution,
    *,
    seed: int,
    initial: Array | None = None,
    checkpoint: Checkpoint | None = None,
    progress: Progress | bool | None = None,
) -> Champion:
    """Return the fittest controller of an evolution against all ``runners`` (or models) together.

    The result depends on ``seed`` and the arguments alone. `choose` selects among its finalists by their score on
    other models. ``initial`` (n,) are parameters from which the first run starts, if its strategy has a parameter of
    this name. ``progress`` is called after every generation with a note of the fitness; True shows a bar.

    With a ``checkpoint``, for example `CheckpointFile`, an evolution that was interrupted or killed resumes from
    there and ends with the same champion.
    """
    runners, seed = as_runners(runners, "evolve_controller"), as_seed(seed)
    task = settings.make_task(system)
    starts = settings.all_starts * settings.repeats
    laws = [make_controller(start.controller).bind_to(task) for start in starts]
    halving = Halving(len(starts), settings.generations * settings.repeats) if settings.starts else None
    disturbed = disturbed_runners(runners, settings)
    seeds = selection_seeds(seed, settings.selection_trials)
    start_of: dict[int, int] = {}

    def lineage(run: int, ended: Sequence[FinishedRun]) -> tuple[int, ...]:
        return (run,) if halving is None else halving.lineage(run, [one.fitness for one in ended])

    @cache
    def objective(run: int, start: int) -> EnsembleObjective:
        return EnsembleObjective(
            tuple(disturbed.values()), laws[start], task, derived_seed(seed, run), settings.trials, settings.aggregate
        )

    def start_run(run: int, ended: Sequence[FinishedRun]) -> tuple[EvolutionStrategy, Objective]:
        start, *continued = lineage(run, ended)
        start_of[run] = start
        strategy = settings.make_strategy(
            laws[start].n_parameters,
            derived_seed(seed, start),
            starts[start].strategy,
            initial=initial if start == 0 else None,
            first_steps=laws[start].first_steps(task.observation_sizes()),
        )
        strategy.prepare(
            behaviour_names=behaviour_names(system),
            control_names=system.control_names,
            generations=settings.generations if halving is None else halving.longest,
        )
        if continued:
            strategy.restore(ended[lineage(run, ended)[-2]].strategy)
        return strategy, objective(run, start)

    def margins(start: int, candidates: Array, rows: IntArray) -> Array:
        delay = settings.estimator_delay
        law, goal = starts[start].controller, settings.task
        return margins_of(lasting_fitness(candidates[rows], runners, law, goal, system, seeds, delay=delay))

    def finalists_of(run: int, strategy: EvolutionStrategy) -> tuple[Finalist, ...]:
        found, final = [], objective(run, start_of[run])
        for behaviour_class, candidates in strategy.finals.items():
            scores = final.on_trials(candidates, seeds)
            winner = best_candidate(scores, task.worst, partial(margins, start_of[run], candidates))
            found.append(Finalist(behaviour_class, run, float(scores.fitness[winner]), candidates[winner]))
        return tuple(found)

    inputs = [repr(settings), *([] if initial is None else initial.tolist())]
    runs = Runs(
        (settings.generations,) * settings.repeats if halving is None else halving.lengths,
        start_run,
        finalists_of,
        models=tuple(disturbed),
        checkpoint=checkpoint,
        identity="" if checkpoint is None else evolution_digest(inputs, runners, laws[0], task, seed),
    )
    with reporting(progress, f"evolve {name}") as report:
        ended = runs.finish(report)
    best = max(chain.from_iterable(run.finalists for run in ended), key=lambda one: one.fitness)  # of equals the first
    start, *_ = path = lineage(best.repeat, ended)
    same = [run for run in range(len(ended)) if starts[lineage(run, ended)[0]].controller == starts[start].controller]
    return Champion(
        name=name,
        parameters=best.parameters,
        against=tuple(runners),
        aggregate=settings.aggregate,
        seed=seed,
        history=np.concatenate([ended[run].history for run in path]),
        controller=starts[start].controller,
        task=settings.task,
        estimator_delay=settings.estimator_delay,
        noise=settings.noise,
        seed_fitness=tuple(ended[run].fitness for run in same),
        system=system,
        finalists=tuple(chain.from_iterable(ended[run].finalists for run in same)),
        population=ended[best.repeat].population,
    )


def selection_seeds(seed: int, trials: int) -> Seeds:
    """Return the seeds (trials,) of the fresh trials that select finalists and champions."""
    return trial_seeds(seed, trials, generation=SELECTION)


def disturbed_runners(runners: Mapping[str, Runner], settings: ControllerEvolution) -> dict[str, Runner]:
    """Return ``runners`` with the noise and delay of ``settings``. Raises `InvalidArgument` for no model."""
    noise, delay = settings.make_noise(), settings.estimator_delay
    if noise is None and delay == 0.0:
        return dict(runners)
    found: dict[str, Runner] = {}
    for label, runner in runners.items():
        if not isinstance(runner, DynamicsRunner):
            raise InvalidArgument(f"evolution: {label} is not a model: noise and delay can only be added to models")
        found[label] = replace(runner, dynamics=Disturbed(runner.dynamics, noise, delay=delay))
    return found


def delayed_runner(name: str, runner: Runner, delay: float) -> Runner:
    """Return ``runner`` with an observation delay of ``delay`` s. Raises `InvalidArgument` if it is not a model."""
    if delay == 0.0:
        return runner
    if not isinstance(runner, DynamicsRunner):
        raise InvalidArgument(f"evolution: {name} is not a model: a delay can only be added to models")
    return replace(runner, dynamics=Disturbed(runner.dynamics, delay=delay))


SECONDS = 5.0
"""Time for which each extreme command is held in `simulated_state_range`."""
MAX_COMMANDS = 243
QUANTILE = 0.99
"""Quantile of the recorded samples that `recorded_state_range` returns."""


def recorded_state_range(dataset: Dataset) -> Array:
    """Return the 99 % quantile of the absolute value of each recorded state, (nx,)."""
    states = np.concatenate([episode.states for episode in dataset])
    return np.asarray(np.quantile(np.abs(states), QUANTILE, axis=0))


def simulated_state_range(dynamics: Dynamics) -> Array | None:
    """Return the largest absolute value of each state under constant extreme commands from rest, (nx,).

    None without controls, or if a control has no limits. Values that are not finite are ignored.
    """
    system = dynamics.system
    if not system.nu or not all(channel.bounded for channel in system.controls):
        return None
    ends = [sorted({channel.low, channel.neutral, channel.high}) for channel in system.controls]
    commands = np.array(list(product(*ends))[:MAX_COMMANDS])
    carry = started(dynamics, np.tile(system.neutral_state, (len(commands), 1)))
    noise = np.zeros((len(commands), dynamics.n_noise)) if dynamics.n_noise else None
    farthest = np.abs(system.neutral_state)
    with np.errstate(all="ignore"):
        for _ in range(round(SECONDS / system.dt)):
            carry, _ = clip_state(dynamics.step(carry, commands, noise), dynamics.state_bounds)
            states = np.abs(carry[:, : system.nx])
            farthest = np.maximum(farthest, np.where(np.isfinite(states), states, 0.0).max(axis=0))
    return farthest
