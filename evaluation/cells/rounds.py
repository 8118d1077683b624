"""Recording in rounds: evolve a controller in models of all data so far, record the robot under it, fit again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.cells.controllers import CONTROLLERS, ControllerSettings, evolution_settings, identity_of
from evaluation.cells.data import DATA, HoldOut, SplitDataset
from evaluation.cells.learned_task import LearnTask, learned_task, needed
from evaluation.cells.models import Fit
from evaluation.cells.plants import ROLLOUT_STEPS_PER_SECOND, Plant, fitted, labels_of, runners
from evaluation.experiment import Experiment, default_task
from evaluation.rounds import (
    ERROR_STEPS,
    MOST_AGAIN,
    SHORT_EPISODE,
    RecordingRound,
    RoundsSummary,
    best_round,
    labels_to_search,
    reason_to_end,
    round_to_continue,
    rounds_to_try_again,
)
from evaluation.storage import load_result, save_result
from sysid_evo.controllers.controller import Controller, make_controller
from sysid_evo.controllers.linear import Exploring
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.engine import DynamicsRunner, Rollouts
from sysid_evo.engine.rollout import BoundRunner
from sysid_evo.errors import Blocked, InvalidArgument, InvalidData
from sysid_evo.evolution import Champion, ControllerEvolution, Finalist, Scores, evolve_controller
from sysid_evo.evolution.aggregates import make_aggregate
from sysid_evo.evolution.margins import best_candidate, lasting_fitness, margins_of, with_horizon
from sysid_evo.models import DynamicsModel
from sysid_evo.motion import PlanarBody
from sysid_evo.plan import CELL_KINDS, Cell, CellContext, CellKind, CellSettings, ResultType, blocked_reason, cell_seed
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec, make_robot, models
from sysid_evo.system import System
from sysid_evo.tasks.task import make_task
from sysid_evo.types import Array, IntArray, Seeds

ROUND_STEPS, EPISODE_STEPS = 1000, 100
"""Steps after which a round records no further episode, and most steps of an episode that is not judged."""
FEWEST_EPISODES, OF_BODIES = 3, 4
"""Number of judged episodes at least, however long they last, and that of a robot that moves."""
MORE_EPISODES = 4
"""Most episodes of a round, as a multiple of those of `EPISODE_STEPS`: shorter ones are recorded more often."""
EPISODES_AGAIN = 20
"""Most further episodes of a controller after the last round."""
LONGEST_SHARE = 0.05
"""Most steps of a judged episode, as a share of all recorded steps."""
SEARCH_STEPS, BEYOND = 120, 1.2
"""Horizon of the evolution at least, and as a multiple of the steps for which the best controller so far lasts."""
DEFAULT_ROUNDS, OF_MOVING = 16, 10
"""Most rounds by default, and those of a robot that moves; most comparisons end earlier, see `reason_to_end`."""
MOST_SEARCHES = 14.0
"""Most simulated steps of all evolutions, in those of one with `SEARCH_STEPS`: the rounds end in some ten minutes."""
NEARER = 0.1
"""Factor of sigma in a search that continues a controller."""
RECORDING_SECONDS = 100.0
RANDOM_TRIALS = 4
"""Number of trials under random commands that show whether trials end early."""


def default_rounds(experiment: Experiment, robot: Spec) -> int | None:
    """Return a number of rounds for a program that moves, ends trials early or learns its reward; else None.

    The first recording of such a robot shows little of what a good controller meets. None also if the settings that
    rounds choose are given, or the ``robot`` is compiled, physical or slow.
    """
    if experiment.stop_after is not None or experiment.data_digest is not None:
        return None
    chosen = ("models", "controller", "strategy", "procedure", "starts", "generations", "reference", "ensembles")
    given = any(getattr(experiment, name) is not None for name in chosen)
    if given or not _is_cheap(experiment, robot) or make_robot(robot).dynamics is not None:
        return None
    if isinstance(make_robot(robot).system.motion, PlanarBody):
        return OF_MOVING
    learns = make_task(experiment.task or default_task((robot,))).needs_recording
    return DEFAULT_ROUNDS if learns or trials_end_early(experiment, robot) else None


def trials_end_early(experiment: Experiment, robot: Spec) -> bool:
    """Return whether half of some trials of ``robot`` end within `SHORT_EPISODE` steps under random commands.

    The trials are those of the task of ``experiment``. False for a robot that is physical or slow.
    """
    if not _is_cheap(experiment, robot):
        return False
    made, goal = make_robot(robot), Spec.parse(experiment.task or default_task((robot,)))
    enough = min(SHORT_EPISODE, make_task(goal).bind(made.system).horizon)
    runner = made.runner()
    assert runner is not None
    drive = runner.bind(make_controller("random"), make_task(with_horizon(goal, enough)))
    steps = drive(np.zeros((1, 0)), trial_seeds(experiment.seed, RANDOM_TRIALS)).survived
    return bool(np.median(steps) < enough)


def _is_cheap(experiment: Experiment, robot: Spec) -> bool:
    """Return whether ``robot`` is a program of which all steps of the rounds take at most `RECORDING_SECONDS`."""
    if make_robot(robot).physical:
        return False
    return experiment.max_steps * Plant(robot.label, robot.name, robot=robot).timed <= RECORDING_SECONDS


@dataclass(frozen=True)
class RoundsSoFar:
    """The recordings of all rounds so far, and their summary."""

    dataset: Dataset
    summary: RoundsSummary

    @classmethod
    def before_any(cls, parts: SplitDataset) -> RoundsSoFar:
        """Return the first recording, without a round."""
        dataset = parts.training
        lengths = [len(episode) for episode in dataset]
        return cls(dataset, RoundsSummary(dataset.n_steps, int(np.median(lengths))))


@dataclass(frozen=True)
class Round(CellSettings):
    """Round ``number``: fit ``specs`` to all data so far, evolve a controller in them, record ``robot`` under it.

    Models that do not predict are left out of the evolution if others do, see `labels_to_search`.
    The evolution continues from that of `round_to_continue`, other runs from the beginning. Its trials are as long as
    those of the task if the robot moves or its last step has a reward of its own, else see `search_horizon`. ``noise``
    is that of `Exploring`, in a share ``noisy_share`` of the episodes. The others have the same starts in every round,
    and their fitness alone is compared. Judged episodes last as long as the trial, up to `LONGEST_SHARE` of
    ``max_steps``: a controller that lasts is recorded in fewer and longer episodes, and returns of all rounds are
    comparable. The best are tried again at the end, see `tried_again`. No round follows one that gives a
    `reason_to_end`, or if it might leave no steps for that, of ``max_steps`` in all.
    """

    number: int
    data: Cell
    previous: Cell[Round] | None
    robot: Plant
    specs: tuple[Spec, ...]
    evolution: ControllerEvolution
    noise: float
    noisy_share: float
    max_steps: int
    seed: int
    preset: str
    is_last: bool = False

    def cell(self) -> Cell[Round]:
        evolution, steps = self.evolution, SEARCH_STEPS
        assert self.robot.robot is not None
        if make_robot(self.robot.robot).system.motion is not None:
            steps = make_task(evolution.task).horizon
        rollouts = evolution.repeats * evolution.generations * evolution.trials * 50 * len(self.specs)
        fits = (Fit(spec, self.data, self.seed, self.preset).cell() for spec in self.specs)
        return Cell(
            kind="round",
            name=f"round-{self.number}",
            title=f"round {self.number}: fit, evolve and record",
            settings=self,
            needs=(self.data if self.previous is None else self.previous,),
            expected_seconds=sum(fit.expected_seconds for fit in fits)
            + 10.0 * rollouts * steps / ROLLOUT_STEPS_PER_SECOND
            + max(ROUND_STEPS, FEWEST_EPISODES * LONGEST_SHARE * self.max_steps) * self.robot.step_seconds(),
        )

    def inputs(self) -> dict[str, Any]:
        return {
            "number": self.number,
            "robot": self.robot.inputs(),
            "models": [models.identity(spec) for spec in self.specs],
            **identity_of(self.evolution),
            "repeats": self.evolution.repeats,
            "command_noise": [self.noise, self.noisy_share],
            "episodes": [ROUND_STEPS, EPISODE_STEPS, FEWEST_EPISODES, MORE_EPISODES, LONGEST_SHARE],
            "horizon": [SEARCH_STEPS, BEYOND],
            "max_steps": self.max_steps,
            "seed": self.seed,
            "last": self.is_last,
        }

    def compute(self, work: CellContext) -> RoundsSoFar:
        before = RoundsSoFar.before_any(work.result(self.data)) if self.previous is None else work.result(self.previous)
        summary, dataset = before.summary, before.dataset
        longest = make_task(self.evolution.task).bind(dataset.system).horizon
        whole = max(1, min(longest, round(LONGEST_SHARE * self.max_steps)))
        short = min(EPISODE_STEPS, whole)
        moves = dataset.system.motion is not None
        fewest = OF_BODIES if moves else FEWEST_EPISODES
        always_noisy = self.noisy_share == 1.0  # hides which controller is the best: steps are kept to try them again
        kept = (MOST_AGAIN + FEWEST_EPISODES - 1) * whole if always_noisy else 0
        episodes = min(ROUND_STEPS, self.max_steps - summary.steps - fewest * whole - kept) // short
        if summary.ended:
            return before
        if episodes < fewest:
            summary = replace(summary, ended=f"{self.max_steps} recorded steps are the most")
            goal = with_horizon(recorded_task(self.evolution.task, dataset), whole)
            return replace(before, summary=self.tried_again(summary, work, dataset.system, goal))
        goal = recorded_task(self.evolution.task, dataset)
        least = longest if moves or make_task(goal).pays_at_limit else SEARCH_STEPS
        learned = {spec.label: Fit(spec, self.data, self.seed, self.preset).learn(dataset) for spec in self.specs}
        known: Sequence[RecordingRound] = summary.rounds
        start = round_to_continue(known)
        searched = {label: learned[label] for label in labels_to_search(known, tuple(learned))}
        champion = evolve_controller(
            f"round {self.number}",
            searched,
            dataset.system,
            in_trials_of(continued(self.evolution, start), goal, search_horizon(known, longest, least)),
            seed=cell_seed(self.seed, f"round {self.number}"),
            initial=None if start is None else start.parameters,
            progress=work.progress,
        )
        law, robot = make_controller(champion.controller), self.robot.runner(work, delay=0.0)
        noisy, seed = round(self.noisy_share * episodes), cell_seed(self.seed, "rounds")
        explored: list[Rollouts] = []
        driver: Controller = Exploring(law, self.noise)
        seeds = trial_seeds(seed, MORE_EPISODES * noisy, generation=self.number)
        if self.noisy_share < 1.0:
            explorer = robot.bind(driver, make_task(with_horizon(goal, short)))
            explored = record_until(explorer, champion.parameters, seeds, noisy * short)
            driver, seeds = law, trial_seeds(seed, max(fewest, MORE_EPISODES * (episodes - noisy)))
        judge = make_task(with_horizon(goal, whole))
        count = noisy if driver is not law else episodes - noisy
        judged = record_until(robot.bind(driver, judge), champion.parameters, seeds, count * short, fewest)
        driven, seeds = [*explored, *judged], seeds[: len(judged)]
        recorded = [run for one in driven for run in one.trajectories]
        new = [replace(run, name=f"round-{self.number}-{i + 1}") for i, run in enumerate(recorded)]
        if not new:
            raise InvalidData(f"round {self.number}: no step was recorded on {self.robot.label}")
        claims = [
            DynamicsRunner(model).bind(driver, judge)(champion.parameters[None], seeds) for model in searched.values()
        ]
        combined = make_aggregate(self.evolution.aggregate)
        made = RecordingRound(
            number=self.number,
            controller=champion.controller.text,
            parameters=champion.parameters,
            claimed=np.asarray(combined(np.stack([run.fitness[0] for run in claims])[:, :, None])),  # (M, E, 1) to (E,)
            achieved=np.concatenate([one.fitness[0] for one in judged]),
            steps=np.concatenate([one.survived[0] for one in driven]),
            errors={label: error_ahead(model, dataset, new) for label, model in learned.items()},
        )
        ended = reason_to_end(known, made, whole)
        if not ended and not moves and searches((*known, made), longest, least) > MOST_SEARCHES:
            ended = "the controllers last so long that another evolution would take too much time"
        summary = replace(summary, rounds=(*known, made), ended=ended)
        if ended or self.is_last:
            summary = self.tried_again(summary, work, dataset.system, with_horizon(goal, whole))
        return RoundsSoFar(dataset.with_episodes([*dataset.episodes, *new]), summary)

    def tried_again(self, summary: RoundsSummary, work: CellContext, system: System, goal: Spec) -> RoundsSummary:
        """Return ``summary`` with further episodes of the controllers that may be the best, and of controls at rest.

        They are trials of ``goal``, as many as surely fit into the steps left, up to `EPISODES_AGAIN` of each
        controller. When they may no longer suffice for all, the worst so far is left out: without noise on the commands
        one or two episodes show which controllers last. The best has `FEWEST_EPISODES` at least, or none is tried.
        """
        if not summary.rounds:
            return summary
        robot, task = self.robot.runner(work, delay=0.0), make_task(goal)
        seeds, longest = trial_seeds(cell_seed(self.seed, "again"), EPISODES_AGAIN), task.bind(system).horizon
        left = self.max_steps - summary.steps
        near = {one.number: one for one in rounds_to_try_again(summary.rounds)}
        drives = {number: robot.bind(make_controller(one.controller), task) for number, one in near.items()}
        fitness: dict[int, list[Array]] = {number: [] for number in near}
        steps = episodes = 0
        while near and episodes < EPISODES_AGAIN:
            kept = max(0, FEWEST_EPISODES - episodes - 1)  # further episodes of the best
            if steps + (len(near) + kept) * longest > left:
                means = {number: float(np.mean(fitness[number])) if episodes else 0.0 for number in near}
                del near[min(reversed(near), key=lambda number: means[number])]  # of equals the last
                continue
            for number, one in near.items():
                run = drives[number](one.parameters[None], seeds[episodes : episodes + 1])
                fitness[number].append(run.fitness[0])
                steps += int(run.survived.sum())
            episodes += 1
        again = {number: np.concatenate(runs) for number, runs in fitness.items() if len(runs) >= FEWEST_EPISODES}
        idle = Champion.baseline("constant", self.evolution.task, system)
        rest = robot.bind(make_controller(idle.controller.text), task)
        return replace(
            summary,
            rounds=tuple(
                replace(one, again=again[one.number]) if one.number in again else one for one in summary.rounds
            ),
            rest=rest(idle.parameters[None], seeds[: max(episodes, FEWEST_EPISODES)]).fitness[0],
            steps_again=steps,
            whole=longest == make_task(self.evolution.task).bind(system).horizon,
        )


def record_until(
    drive: BoundRunner, parameters: Array, seeds: Seeds, steps: int, fewest: int = FEWEST_EPISODES
) -> list[Rollouts]:
    """Return the recorded episodes of ``seeds`` (E,), in their order, the first that have ``steps`` steps in all.

    They are at least ``fewest`` if there are as many seeds.
    """
    driven: list[Rollouts] = []
    for k in range(len(seeds)):
        if k < fewest or sum(int(run.survived.sum()) for run in driven) < steps:
            driven.append(drive(parameters[None], seeds[k : k + 1], record=True))
    return driven


def search_horizon(known: Sequence[RecordingRound], longest: int, least: int = SEARCH_STEPS) -> int:
    """Return the horizon of the evolution, `BEYOND` the mean end of the judged episodes of the best round.

    Models then show what ends them. It is at least the ``least``, and at most the ``longest``. Where all episodes last
    equally long, nothing ends them, and it is the ``least``.
    """
    best = best_round(known)
    if best is None or len(np.unique(np.concatenate([one.judged_steps for one in known]))) == 1:
        return min(least, longest)
    return min(max(least, round(BEYOND * float(best.judged_steps.mean()))), longest)


def searches(known: Sequence[RecordingRound], longest: int, least: int = SEARCH_STEPS) -> float:
    """Return the simulated steps of all evolutions up to that after ``known``, in those of one with `SEARCH_STEPS`.

    An evolution with longer trials has fewer generations, but at least half of them, see `in_trials_of`.
    """
    horizons = [search_horizon(known[:count], longest, least) for count in range(len(known) + 1)]
    return sum(max(1.0, horizon / (2.0 * SEARCH_STEPS)) for horizon in horizons)


def in_trials_of(evolution: ControllerEvolution, task: Spec, horizon: int) -> ControllerEvolution:
    """Return ``evolution`` at ``task`` in trials of ``horizon`` steps.

    The fewer steps, the more generations, so that the search simulates as many steps; at least half of the generations.
    """
    generations = max(evolution.generations // 2, evolution.generations * SEARCH_STEPS // horizon, 1)
    return replace(evolution, task=with_horizon(task, horizon), generations=generations)


def continued(evolution: ControllerEvolution, earlier: RecordingRound | None) -> ControllerEvolution:
    """Return ``evolution`` with the start first whose controller is that of ``earlier``, from which it continues.

    A run that only continues searches nearer to it: a large sigma would lose what the rounds before have found.
    """
    if earlier is None:
        return evolution
    starts = sorted(evolution.starts, key=lambda one: one.controller.text != earlier.controller)
    if starts:
        starts[0] = replace(starts[0], strategy=nearer(starts[0].strategy))
    strategy = nearer(evolution.strategy) if evolution.repeats == 1 else evolution.strategy
    return replace(evolution, starts=tuple(starts), strategy=strategy)


def nearer(strategy: Spec) -> Spec:
    """Return ``strategy`` with its sigma times `NEARER`, unchanged if none is given."""
    sigma = strategy.parameters.get("sigma")
    if sigma is None:
        return strategy
    return Spec(strategy.name, {**strategy.parameters, "sigma": NEARER * float(sigma)}, strategy.label)


def last_round(experiment: Experiment, robot: Plant | None, first: Cell, specs: tuple[Spec, ...]) -> Cell[Round]:
    """Return the cell of the last round, which needs all others; ``first`` is the recording before them.

    Raises `InvalidArgument` without a robot that is a program.
    """
    if robot is None:
        raise InvalidArgument("rounds: expected a robot that is a program, such as an environment; give --robot")
    found: Cell[Round] | None = None
    count = experiment.rounds or 1
    for number in range(1, count + 1):
        found = Round(
            number, first, found, robot, specs, evolution_settings(experiment), experiment.command_noise,
            1.0 if experiment.noisy_share is None else experiment.noisy_share, experiment.max_steps, experiment.seed,
            experiment.preset, is_last=number == count,
        ).cell()  # fmt: skip
    assert found is not None
    return found


def recorded_task(task: Spec, dataset: Dataset) -> Spec:
    """Return ``task`` with the reward that it learns from ``dataset``, unchanged if it needs no recording."""
    made = make_task(task)
    return Spec(task.name, {**task.parameters, **made.learn(dataset).parameters}) if made.needs_recording else task


def error_ahead(model: DynamicsModel, recorded: Dataset, episodes: Sequence[Trajectory]) -> float:
    """Return the error of ``model`` after `ERROR_STEPS` steps on new ``episodes``, in standard deviations of the data.

    It is the mean over the states of the root mean square error; shorter episodes count to their end. Infinite if a
    simulation is not finite.
    """
    system, squares = model.system, []
    spread = system.spread(np.concatenate([episode.states for episode in (*recorded.episodes, *episodes)]))
    spread = np.where(spread > 0.0, spread, 1.0)
    for episode in Dataset(system, tuple(episodes)):
        for first in range(0, max(1, len(episode) - ERROR_STEPS + 1), ERROR_STEPS // 2):
            controls = episode.controls[first : first + ERROR_STEPS]
            earlier = slice(max(0, first - model.n_lags), first)
            simulated = model.simulate(episode.states[earlier.start : first + 1], episode.controls[earlier], controls)
            off = system.difference(simulated[-1], episode.states[first + len(controls)])
            squares.append((off / spread) ** 2)
    error = float(np.sqrt(np.mean(squares, axis=0)).mean())
    return error if np.isfinite(error) else float("inf")


@dataclass(frozen=True)
class RoundData(CellSettings):
    """The recordings of all rounds, split."""

    last: Cell[Round]
    split: HoldOut

    def cell(self) -> Cell[RoundData]:
        label = self.last.settings.robot.label
        return Cell(kind=DATA, name=label, title=f"gather all rounds of {label}", settings=self, needs=(self.last,))

    def inputs(self) -> dict[str, Any]:
        return {"split": asdict(self.split)}

    def compute(self, work: CellContext) -> SplitDataset:
        return self.split.of(work.result(self.last).dataset)


@dataclass(frozen=True)
class ChooseRound(ControllerSettings):
    """Choice among the controllers of all rounds: the highest mean fitness on the robot, in the last episodes of it.

    Of those with all the fitness there is, the largest margin in ``members`` counts, models of all data: see
    `lasting_fitness`. The finalists of the result are the controllers of all rounds that are of its kind, with
    their claims, and as forecasts their fitness on the robot.
    """

    last: Cell[Round]
    members: tuple[Plant, ...]
    label: str
    learned: Cell[LearnTask] | None = None

    def cell(self) -> Cell[ChooseRound]:
        return Cell(
            kind="choose_round",
            name=self.label,
            title="choose among all rounds",
            settings=self,
            needs=(self.last, *needed(self.learned), *(cell for member in self.members for cell in member.needs)),
            labels={"name": self.label, "against": labels_of(self.members)},
        )

    def inputs(self) -> dict[str, Any]:
        return {"members": [member.inputs() for member in self.members]}

    def compute(self, work: CellContext) -> Champion:
        found, settings = work.result(self.last), self.last.settings
        if found is None:
            raise Blocked(blocked_reason(self.last))
        rounds = found.summary.compared
        if not rounds:
            raise InvalidData("no round was recorded: allow more steps with --max-steps")
        evolution, members = settings.evolution, fitted(self.members, work)
        task = learned_task(evolution.task, self.learned, work)
        system = found.dataset.system
        count = min(len(one.fitness) for one in rounds)
        by_trial = np.stack([one.fitness[:count] for one in rounds])
        scores = Scores(np.array([float(one.fitness.mean()) for one in rounds]), by_trial=by_trial)
        seeds, judges = trial_seeds(cell_seed(settings.seed, "choose round"), count), runners(members, work)

        def margins(rows: IntArray) -> Array:
            lasting = [
                lasting_fitness(one.parameters[None], judges, Spec.parse(one.controller), task, system, seeds)
                for one in (rounds[row] for row in rows)
            ]
            return margins_of(np.concatenate(lasting))

        winner = rounds[best_candidate(scores, make_task(task).bind(system).worst, margins)]
        finalists = tuple(
            Finalist(f"round {one.number}", 0, float(one.claimed.mean()), one.parameters, float(one.fitness.mean()))
            for one in found.summary.rounds
            if one.controller == winner.controller
        )
        return Champion(
            name=self.label,
            parameters=winner.parameters,
            against=labels_of(members),
            aggregate=evolution.aggregate,
            seed=settings.seed,
            history=np.empty((0, 3)),
            controller=Spec.parse(winner.controller),
            task=task,
            system=system,
            finalists=finalists,
        )


def _save(value: RoundsSoFar, path: Path, _: Cell) -> list[Path]:
    folder = value.dataset.save(path / "data")
    files = sorted(file for file in folder.iterdir() if file.is_file())
    return [*files, *save_result(value.summary, path / "rounds")]


def _load(path: Path) -> RoundsSoFar:
    return RoundsSoFar(Dataset.load(path / "data"), load_result(RoundsSummary, path / "rounds"))


CELL_KINDS["round"] = CellKind(ResultType("rounds", _save, _load), version=13)
CELL_KINDS["choose_round"] = CellKind(CONTROLLERS, version=4, tolerant=True)
