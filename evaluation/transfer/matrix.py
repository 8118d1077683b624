"""The transfer matrix: a controller on a system over fresh trials, computed or measured."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from evaluation.storage import from_plain, plain
from sysid_evo.controllers.controller import make_controller
from sysid_evo.data import Trajectory
from sysid_evo.display import Displayed, listed
from sysid_evo.engine import Rollouts, Runner, as_runners
from sysid_evo.errors import InvalidArgument, SysidEvoError, described
from sysid_evo.evolution import Champion
from sysid_evo.files import write_atomically
from sysid_evo.models import Dynamics
from sysid_evo.progress import Counter, Progress, reporting
from sysid_evo.randomness import as_seed, trial_seeds
from sysid_evo.registry import Spec
from sysid_evo.system import System
from sysid_evo.tasks import Target, Task, TaskState
from sysid_evo.tasks.task import make_task
from sysid_evo.types import Array, Seeds

AT_REST = "constant"
"""The registered controller with constant controls; a champion of it that was not evolved is at rest."""

AT_RANDOM = "random"
"""The registered controller with random commands."""

NOT_RUN = "not run"
"""The reason of a cell that was not tried: a gap in the matrix, not a failure."""


@dataclass(frozen=True, repr=False)
class TransferMatrix(Displayed):
    """Cells by row and column; the ``robot``, if there is one, is the last column.

    ``families`` names the family of each model column, and of other models that a controller was evolved against, if it
    is known. ``other_robots`` are columns that are neither models nor the robot whose fitness counts as achieved.
    """

    champions: tuple[Champion, ...]
    columns: tuple[str, ...]
    cells: Mapping[tuple[str, str], TransferResult]
    families: Mapping[str, str]
    robot: str | None = None
    other_robots: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        champions: Sequence[Champion],
        columns: Sequence[str],
        cells: Iterable[TransferResult],
        *,
        families: Mapping[str, str] | None = None,
        robot: str | None = None,
        other_robots: Sequence[str] = (),
    ) -> TransferMatrix:
        """Return the matrix of ``cells``; a missing one was not run. Raises `InvalidArgument`."""
        names = [champion.name for champion in champions]
        for what, found in (("controllers", names), ("columns", list(columns))):
            repeated = sorted({name for name in found if found.count(name) > 1})
            if repeated:
                raise InvalidArgument(f"transfer: names of {what} must differ, repeated: {', '.join(repeated)}")
        last = (*other_robots, *((robot,) if robot is not None else ()))
        for name in last:
            if name not in columns:
                raise InvalidArgument(f"transfer: the robot {name!r} is not among the columns {', '.join(columns)}")
        ordered = (*(c for c in columns if c not in last), *last)
        placed = {(cell.champion, cell.column): cell for cell in cells}
        for name in names:
            for column in ordered:
                placed.setdefault((name, column), TransferResult(name, column, reason=NOT_RUN))
        given = families or {}
        named = {**given, **{column: given.get(column, column) for column in ordered}}
        return cls(tuple(champions), ordered, placed, named, robot, tuple(other_robots))

    @property
    def rows(self) -> tuple[str, ...]:
        return tuple(champion.name for champion in self.champions)

    @property
    def models(self) -> tuple[str, ...]:
        """The columns that are not robots."""
        return tuple(column for column in self.columns if column not in (self.robot, *self.other_robots))

    @property
    def at_rest(self) -> tuple[str, ...]:
        """The controllers at rest: shares of fitness are measured from theirs."""
        return tuple(one.name for one in self.champions if one.controller.name == AT_REST and not one.against)

    @property
    def at_random(self) -> tuple[str, ...]:
        """The controllers with random commands."""
        return tuple(one.name for one in self.champions if one.controller.name == AT_RANDOM and not one.against)

    @property
    def baselines(self) -> tuple[str, ...]:
        """The controllers that were not evolved."""
        return tuple(one.name for one in self.champions if not one.against)

    @property
    def unit(self) -> str:
        """The unit of fitness."""
        return next((cell.unit for cell in self.cells.values() if cell.unit), "")

    @property
    def trials(self) -> int:
        """The largest number of trials in a cell."""
        return max((cell.trials for cell in self.cells.values()), default=0)

    def cell(self, champion: str, column: str) -> TransferResult:
        return self.cells[champion, column]

    def facts(self) -> Mapping[str, str]:
        return {row: listed(f"{self.cell(row, on).mean:.4g} on {on}" for on in self.columns) for row in self.rows}

    def failures(self) -> tuple[TransferResult, ...]:
        """Return the cells that were tried and failed, row by row."""
        cells = (self.cell(row, column) for row in self.rows for column in self.columns)
        return tuple(cell for cell in cells if cell.failed and cell.reason != NOT_RUN)


@dataclass(frozen=True)
class TransferResult:
    """Result of ``champion`` on ``column`` in E trials, or the ``reason`` why it failed.

    ``fitness`` (E,) in ``unit``. ``clipped_share`` is the share of steps whose state was clipped to the model's state
    bounds, ``diverged_share`` that of the trials that were no longer numbers. ``engine`` names the form of the rollout.
    ``missing`` gives a reason for each trial that a robot did not finish. ``measures`` are means of the task's further
    measures (`Task.measures`), None without a number.
    """

    champion: str
    column: str
    fitness: Array = field(default_factory=lambda: np.empty(0))
    clipped_share: float = 0.0
    diverged_share: float = 0.0
    unit: str = ""
    engine: str = ""
    traces: tuple[Trace, ...] = field(default=(), repr=False)
    reason: str = ""
    missing: tuple[str, ...] = ()
    measures: Mapping[str, float | None] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        return bool(self.reason)

    @property
    def trials(self) -> int:
        return len(self.fitness)

    @property
    def mean(self) -> float:
        """Mean fitness, NaN for a failed cell."""
        return float(self.fitness.mean()) if len(self.fitness) else float("nan")

    @property
    def std(self) -> float:
        """Standard deviation of the fitness over trials (n - 1), NaN below two trials."""
        return float(self.fitness.std(ddof=1)) if len(self.fitness) > 1 else float("nan")

    @property
    def standard_error(self) -> float:
        """Standard error of the mean, NaN below two trials."""
        return self.std / np.sqrt(len(self.fitness)) if len(self.fitness) else float("nan")


@dataclass(frozen=True)
class Trace:
    """One recorded trial. ``waypoints`` (k, 2), in space (k, 3), in m are the markers of the task's `Scene`.

    ``waypoint_radius`` is in m; a task without markers has none. ``walls`` and ``targets`` are those of the scene.
    """

    trajectory: Trajectory
    fitness: float
    waypoints: Array = field(default_factory=lambda: np.empty((0, 2)))
    waypoint_radius: float = 0.0
    walls: tuple[Array, ...] = ()
    targets: tuple[Target, ...] = ()

    def __post_init__(self) -> None:
        given = np.asarray(self.waypoints, dtype=np.float64)
        object.__setattr__(self, "waypoints", given if given.ndim == 2 else given.reshape(-1, 2))  # a list may be empty


def transfer(
    champions: Sequence[Champion],
    runners: Mapping[str, Runner | Dynamics],
    *,
    seed: int,
    families: Mapping[str, str] | None = None,
    robot: str | None = None,
    trials: int = 100,
    traces: int = 10,
    progress: Progress | bool | None = None,
) -> TransferMatrix:
    """Run every champion on every runner, or model, in the same fresh trials.

    ``robot`` names the runner that is the robot, if one is. The first ``traces`` trials are kept, see `kept_traces`.
    ``progress`` is called after every cell; True shows a bar.
    """
    runners, seeds = as_runners(runners, "transfer"), transfer_seeds(as_seed(seed), trials)
    cells = []
    with reporting(progress, "transfer") as report:
        counter = Counter(report, len(champions) * len(runners))
        for champion in champions:
            for column, runner in runners.items():
                kept = kept_traces(traces, own=column == robot or column in champion.against)
                cells.append(try_controller(champion, column, runner, seeds, traces=kept))
                counter.advance(1)
    return TransferMatrix.of(champions, tuple(runners), cells, families=families, robot=robot)


TRANSFER = 2**31 + 1
"""Generation number of the transfer trials, which are used in no evolution and no selection of a champion."""


def transfer_seeds(seed: int, trials: int) -> Seeds:
    """Return the seeds of fresh trials (trials,), common to all cells."""
    return trial_seeds(seed, trials, generation=TRANSFER)


def kept_traces(traces: int, *, own: bool) -> int:
    """Return how many of ``traces`` trials a cell keeps: all on the robot and on models evolved against (``own``).

    Elsewhere one is enough for a comparison with those.
    """
    return traces if own else min(traces, 1)


def try_controller(champion: Champion, column: str, runner: Runner, seeds: Seeds, *, traces: int = 0) -> TransferResult:
    """Run ``champion``, see `run_controller`; an error becomes the reason of a failed cell."""
    try:
        return run_controller(champion, column, runner, seeds, traces=traces)
    except Exception as error:  # a plugin or a robot may fail in any way; the other cells must be computed
        return TransferResult(champion.name, column, reason=described(error))


def run_controller(champion: Champion, column: str, runner: Runner, seeds: Seeds, *, traces: int = 0) -> TransferResult:
    """Run ``champion`` on ``runner`` in a trial of every seed (E,); the first ``traces`` are kept."""
    controller, task = make_controller(champion.controller), make_task(champion.task)
    rollouts = runner.bind(controller, task)(champion.parameters[None], seeds, record=traces > 0)
    return result_of(champion, column, rollouts, task, traces=traces)


def result_of(champion: Champion, column: str, rollouts: Rollouts, task: Task, *, traces: int = 0) -> TransferResult:
    """Return the cell of finished trials; a cell without a single finished trial has failed."""
    if rollouts.fitness.size == 0:
        reason = "; ".join(("no trial was finished", *rollouts.missing[:1]))
        return TransferResult(champion.name, column, reason=reason, missing=rollouts.missing)
    fitness = rollouts.fitness[0]
    measures: dict[str, float | None] = {}  # means over the trials that have one
    if champion.system is not None:
        for name, values in task.bind(champion.system).measures(rollouts.task_state).items():
            known = values[np.isfinite(values)]
            measures[name] = float(known.mean()) if len(known) else None
    return TransferResult(
        champion=champion.name,
        column=column,
        fitness=fitness,
        clipped_share=float(rollouts.clipped.sum() / max(1, rollouts.survived.sum())),
        diverged_share=float((fitness < task.worst).mean()),
        unit=task.fitness_unit,
        engine=rollouts.engine,
        traces=_traces(rollouts, traces, task),
        missing=rollouts.missing,
        measures=measures,
    )


def _traces(rollouts: Rollouts, wanted: int, task: Task) -> tuple[Trace, ...]:
    """Return the first trials that were recorded; a trial without a step has no trajectory."""
    trials = np.flatnonzero(rollouts.survived[0] > 0)
    kept = []
    for trial, trajectory in list(zip(trials, rollouts.trajectories, strict=False))[:wanted]:
        scene = task.scene(rollouts.task_state, int(trial))
        fitness = float(rollouts.fitness[0, trial])
        kept.append(Trace(trajectory, fitness, scene.markers, scene.radius, scene.walls, scene.targets))
    return tuple(kept)


FOLDER = Path("results") / "measured"
BY_HAND = Spec("by_hand")
"""Spec in place of a controller if a person drives."""


@dataclass(frozen=True)
class MeasuredResult:
    """A cell, its driver (``champion``, the row), and whether the column is a robot, and a physical one."""

    champion: Champion
    cell: TransferResult
    on_robot: bool
    physical: bool = False

    @cached_property
    def digest(self) -> str:
        """SHA-256 of everything in it."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()

    def to_json(self) -> str:
        """Return it as strict JSON."""
        value = {
            "cell": plain(self.cell),
            "champion": self.champion.to_dict(),
            "tensors": {name: array.tolist() for name, array in self.champion.tensors.items()},
            "on_robot": self.on_robot,
            "physical": self.physical,
        }
        return json.dumps(value, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> MeasuredResult:
        """Inverse of `to_json`."""
        value = json.loads(text)
        champion = Champion.from_dict(value["champion"], value["tensors"])
        cell = from_plain(TransferResult, value["cell"], place="cell")
        return cls(champion, cell, value["on_robot"], value["physical"])


def human_driver(name: str = "human", *, task: str = "point_to_point", system: System | None = None) -> Champion:
    """Return the row of a person who drives: without parameters, evolved against nothing."""
    return Champion(
        name, np.empty(0), (), "min", 0, np.empty((0, 3)), controller=BY_HAND, task=Spec.parse(task), system=system
    )


def measured_by_person(
    name: str,
    column: str,
    trials: Sequence[tuple[float, Trajectory | None, TaskState]],
    *,
    task: str,
    system: System,
    on_robot: bool,
    physical: bool = False,
    traces: int = 10,
) -> MeasuredResult:
    """Return the cell of trials that ``name`` drove by hand: fitness, trajectory and final state of each."""
    goal, kept = make_task(task), []
    for fitness, trajectory, state in trials[:traces]:
        if trajectory is not None:
            scene = goal.scene(state, 0)
            kept.append(Trace(trajectory, fitness, scene.markers, scene.radius))
    cell = TransferResult(
        champion=name,
        column=column,
        fitness=np.array([fitness for fitness, _, _ in trials]),
        unit=goal.fitness_unit,
        engine="by hand",
        traces=tuple(kept),
    )
    return MeasuredResult(human_driver(name, task=task, system=system), cell, on_robot=on_robot, physical=physical)


def save_measured(run: Path, measured: MeasuredResult) -> Path:
    """Store a cell in the run folder ``run``; it replaces an earlier one of the same row and column."""
    name = f"{measured.champion.name}@{measured.cell.column}.json"
    text = measured.to_json()
    return write_atomically(run / FOLDER / re.sub(r"[^\w.@+-]+", "-", name), lambda file: file.write_text(text))


def load_measured(run: Path) -> tuple[tuple[MeasuredResult, ...], tuple[str, ...]]:
    """Return every measured cell of the run folder, the oldest first, and a remark for each that is damaged."""
    files = sorted((run / FOLDER).glob("*.json"), key=lambda file: (file.stat().st_mtime_ns, file.name))
    found, remarks = [], []
    for file in files:
        try:
            found.append(MeasuredResult.from_json(file.read_text(encoding="utf-8")))
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, SysidEvoError) as error:
            remarks.append(f"{file} is damaged and left out: {type(error).__name__}: {error}")
    return tuple(found), tuple(remarks)


def with_measured(matrix: TransferMatrix | None, measured: Sequence[MeasuredResult]) -> TransferMatrix | None:
    """Return ``matrix`` with the measured cells, in new rows and columns if necessary.

    The robot that counts as achieved is the physical one driven last, else that of ``matrix``, else the one
    driven last.
    """
    if not measured:
        return matrix
    champions = {champion.name: champion for champion in (matrix.champions if matrix else ())}
    columns = dict.fromkeys(matrix.columns if matrix else ())
    cells = dict(matrix.cells) if matrix else {}
    robot, physical = (matrix.robot if matrix else None), False
    robots = {robot: None} if robot is not None else {}
    for item in measured:
        champions.setdefault(item.champion.name, item.champion)
        columns[item.cell.column] = None
        cells[item.champion.name, item.cell.column] = item.cell
        if item.on_robot:
            robots[item.cell.column] = None
            if item.physical or (not physical and (matrix is None or matrix.robot is None)):
                robot, physical = item.cell.column, physical or item.physical
    return TransferMatrix.of(
        tuple(champions.values()),
        tuple(columns),
        cells.values(),
        families=matrix.families if matrix else None,
        robot=robot,
        other_robots=tuple(name for name in robots if name != robot),
    )
