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
from evaluation.cells.plants import ROLLOUT_STEPS_PER_SECOND, SLOW, Plant, fitted, labels_of, runners
from evaluation.experiment import Experiment, default_task
from evaluation.rounds import ERROR_STEPS, SHORT_EPISODE, RecordingRound, RoundsSummary, reason_to_end
from evaluation.storage import load_result, save_result
from sysid_evo.controllers.controller import make_controller
from sysid_evo.controllers.linear import Exploring
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.engine import DynamicsRunner, Rollouts
from sysid_evo.errors import Blocked, InvalidArgument, InvalidData
from sysid_evo.evolution import Champion, ControllerEvolution, Finalist, Scores, evolve_controller
from sysid_evo.evolution.aggregates import make_aggregate
from sysid_evo.evolution.margins import best_candidate, lasting_fitness, margins_of, with_horizon
from sysid_evo.models import DynamicsModel
from sysid_evo.plan import CELL_KINDS, Cell, CellContext, CellKind, CellSettings, ResultType, blocked_reason, cell_seed
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec, make_robot, models
from sysid_evo.tasks.task import make_task
from sysid_evo.types import Array, IntArray

EPISODES, EPISODE_STEPS = 10, 100
"""Number of episodes of a round, and the steps of each, if it does not end before."""
BEYOND = 1.2
"""Horizon of the evolution as a multiple of the episodes of a round."""
FEWEST_EPISODES = 2
DEFAULT_ROUNDS = 6
RANDOM_TRIALS = 4
"""Number of trials under random commands that decide whether a robot is recorded in rounds."""


def default_rounds(experiment: Experiment, robot: Spec) -> int | None:
    """Return `DEFAULT_ROUNDS` for a program whose trials end within `SHORT_EPISODE` steps under random commands.

    A recording of it shows little of what a good controller meets. None if the settings that rounds choose are given,
    or the ``robot`` is compiled, physical or slow.
    """
    if experiment.stop_after is not None or experiment.data_digest is not None:
        return None
    chosen = ("models", "controller", "strategy", "procedure", "starts", "generations", "reference", "ensembles")
    given = any(getattr(experiment, name) is not None for name in chosen) or experiment.schedule or experiment.penalty
    made = make_robot(robot)
    runner = None if given or made.physical or made.dynamics is not None else made.runner()
    if runner is None or Plant(robot.label, robot.name, robot=robot).timed > SLOW:
        return None
    task = make_task(experiment.task or default_task((robot,))).bind(made.system)
    drive = runner.bind(make_controller("random"), task)
    steps = drive(np.zeros((1, 0)), trial_seeds(experiment.seed, RANDOM_TRIALS)).survived
    return DEFAULT_ROUNDS if np.median(steps) < min(SHORT_EPISODE, task.horizon) else None


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

    The evolution starts from the best controller so far, a second run from the beginning. ``noise`` is that of
    `Exploring`. No round follows one that gives a `reason_to_end`, or if fewer than `FEWEST_EPISODES` episodes are left
    of ``max_steps`` recorded steps in all.
    """

    number: int
    data: Cell
    previous: Cell[Round] | None
    robot: Plant
    specs: tuple[Spec, ...]
    evolution: ControllerEvolution
    noise: float
    max_steps: int
    seed: int
    preset: str

    def cell(self) -> Cell[Round]:
        """Return the cell of the round."""
        evolution, steps = self.evolution, BEYOND * EPISODE_STEPS
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
            + EPISODES * EPISODE_STEPS * self.robot.step_seconds(),
        )

    def inputs(self) -> dict[str, Any]:
        return {
            "number": self.number,
            "robot": self.robot.inputs(),
            "models": [models.identity(spec) for spec in self.specs],
            **identity_of(self.evolution),
            "repeats": self.evolution.repeats,
            "command_noise": self.noise,
            "episodes": [EPISODES, EPISODE_STEPS, BEYOND],
            "max_steps": self.max_steps,
            "seed": self.seed,
        }

    def compute(self, work: CellContext) -> RoundsSoFar:
        before = RoundsSoFar.before_any(work.result(self.data)) if self.previous is None else work.result(self.previous)
        summary, dataset = before.summary, before.dataset
        episodes = min(EPISODES, (self.max_steps - summary.steps) // EPISODE_STEPS)
        if summary.ended:
            return before
        if episodes < FEWEST_EPISODES:
            return replace(before, summary=replace(summary, ended=f"{self.max_steps} recorded steps are the most"))
        learned = {spec.label: Fit(spec, self.data, self.seed, self.preset).learn(dataset) for spec in self.specs}
        known: Sequence[RecordingRound] = summary.rounds
        best = max(known, key=lambda one: float(one.achieved.mean()), default=None)
        goal, horizon = recorded_task(self.evolution.task, dataset), round(BEYOND * EPISODE_STEPS)
        champion = evolve_controller(
            f"round {self.number}",
            learned,
            dataset.system,
            replace(self.evolution, task=with_horizon(goal, horizon)),
            seed=cell_seed(self.seed, f"round {self.number}"),
            initial=None if best is None else best.parameters,
            progress=work.progress,
        )
        seeds = trial_seeds(cell_seed(self.seed, "rounds"), episodes, generation=self.number)
        law = Exploring(make_controller(champion.controller), self.noise)
        task = make_task(with_horizon(goal, EPISODE_STEPS))
        driven = self.robot.runner(work, delay=0.0).bind(law, task)(champion.parameters[None], seeds, record=True)
        new = [replace(run, name=f"round-{self.number}-{i + 1}") for i, run in enumerate(driven.trajectories)]
        if not new:
            raise InvalidData(f"round {self.number}: no step was recorded on {self.robot.label}")
        claims = [DynamicsRunner(one).bind(law, task)(champion.parameters[None], seeds) for one in learned.values()]
        made = RecordingRound(
            number=self.number,
            parameters=champion.parameters,
            claimed=_claimed(claims, self.evolution.aggregate),
            achieved=driven.fitness[0],
            steps=driven.survived[0],
            errors={label: error_ahead(model, dataset, new) for label, model in learned.items()},
        )
        summary = replace(summary, rounds=(*known, made), ended=reason_to_end(known, made, EPISODE_STEPS))
        return RoundsSoFar(dataset.with_episodes([*dataset.episodes, *new]), summary)


def last_round(experiment: Experiment, robot: Plant | None, first: Cell, specs: tuple[Spec, ...]) -> Cell[Round]:
    """Return the cell of the last round, which needs all others; ``first`` is the recording before them.

    Raises `InvalidArgument` without a robot that is a program.
    """
    if robot is None:
        raise InvalidArgument("rounds: expected a robot that is a program, such as an environment; give --robot")
    found: Cell[Round] | None = None
    for number in range(1, (experiment.rounds or 1) + 1):
        found = Round(
            number, first, found, robot, specs, evolution_settings(experiment), experiment.command_noise,
            experiment.max_steps, experiment.seed, experiment.preset,
        ).cell()  # fmt: skip
    assert found is not None
    return found


def recorded_task(task: Spec, dataset: Dataset) -> Spec:
    """Return ``task`` with the reward that it learns from ``dataset``, unchanged if it needs no recording."""
    made = make_task(task)
    return Spec(task.name, {**task.parameters, **made.learn(dataset).parameters}) if made.needs_recording else task


def _claimed(runs: Sequence[Rollouts], aggregate: str) -> Array:
    """Return the fitness in each trial (E,), combined over the models as in the evolution."""
    fitness = np.stack([run.fitness[0] for run in runs])  # (M, E)
    return np.asarray(make_aggregate(aggregate)(fitness[:, :, None]))


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
        """Return the cell of both parts."""
        label = self.last.settings.robot.label
        return Cell(kind=DATA, name=label, title=f"gather all rounds of {label}", settings=self, needs=(self.last,))

    def inputs(self) -> dict[str, Any]:
        return {"split": asdict(self.split)}

    def compute(self, work: CellContext) -> SplitDataset:
        return self.split.of(work.result(self.last).dataset)


@dataclass(frozen=True)
class ChooseRound(ControllerSettings):
    """Choice among the controllers of all rounds: the highest mean fitness in the episodes recorded under it.

    Of those with all the fitness there is, the largest margin in ``members`` counts, models of all data: see
    `lasting_fitness`. The finalists of the result are the controllers of all rounds, with their claims, and as
    forecasts their fitness on the robot.
    """

    last: Cell[Round]
    members: tuple[Plant, ...]
    label: str
    learned: Cell[LearnTask] | None = None

    def cell(self) -> Cell[ChooseRound]:
        """Return the cell of the controller."""
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
        rounds = found.summary.rounds
        if not rounds:
            raise InvalidData("no round was recorded: allow more steps with --max-steps")
        evolution, members = settings.evolution, fitted(self.members, work)
        task = learned_task(evolution.task, self.learned, work)
        system = found.dataset.system
        candidates = np.stack([one.parameters for one in rounds])
        count = min(len(one.achieved) for one in rounds)
        by_trial = np.stack([one.achieved[:count] for one in rounds])
        scores = Scores(np.array([float(one.achieved.mean()) for one in rounds]), by_trial=by_trial)
        seeds, judges = trial_seeds(cell_seed(settings.seed, "choose round"), count), runners(members, work)

        def margins(rows: IntArray) -> Array:
            return margins_of(lasting_fitness(candidates[rows], judges, evolution.controller, task, system, seeds))

        winner = best_candidate(scores, make_task(task).bind(system).worst, margins)
        finalists = tuple(
            Finalist(f"round {one.number}", 0, float(one.claimed.mean()), one.parameters, float(one.achieved.mean()))
            for one in rounds
        )
        return Champion(
            name=self.label,
            parameters=candidates[winner],
            against=labels_of(members),
            aggregate=evolution.aggregate,
            seed=settings.seed,
            history=np.empty((0, 3)),
            controller=evolution.controller,
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


CELL_KINDS["round"] = CellKind(ResultType("rounds", _save, _load))
CELL_KINDS["choose_round"] = CellKind(CONTROLLERS, tolerant=True)
