"""The cell of a task that learns its reward from the data of a comparison, and its use by cells of controllers."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

from evaluation.cells.plants import STEPS
from evaluation.cells.slow_models import CANDIDATES, FEWEST
from evaluation.storage import result_of
from sysid_evo.data import Dataset
from sysid_evo.data.trajectory import reward_digest
from sysid_evo.errors import Blocked, InvalidData
from sysid_evo.evolution import ControllerEvolution
from sysid_evo.plan import CELL_KINDS, Cell, CellContext, CellKind, CellSettings, blocked_reason
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec, tasks
from sysid_evo.tasks.task import Task, make_task


@dataclass(frozen=True)
class LearnedTaskResult:
    """The spec of a task with what it has learned, as text, and sentences on its held-out errors.

    ``warning`` is a sentence if the reward is badly known, else empty. ``step_seconds`` are
    the seconds of a step of the task if it is computed exactly, else 0.
    """

    task: str
    sentences: tuple[str, ...]
    warning: str = ""
    step_seconds: float = 0.0


@dataclass(frozen=True)
class LearnTask(CellSettings):
    """The task ``task`` learns its reward from all recordings in ``data``; it has held-out errors of its own.

    If they are too large and the task can be computed exactly, it is, which is slow: searches then have as many
    generations as fit into ``search_minutes``.
    """

    task: Spec
    data: Cell
    search_minutes: float

    def cell(self) -> Cell[LearnTask]:
        name = f"task-{self.task.name}"
        return Cell(kind=LEARN, name=name, title="learn the reward", settings=self, needs=(self.data,))

    def inputs(self) -> dict[str, Any]:
        return {"task": tasks.identity(self.task), "search_minutes": self.search_minutes}

    def compute(self, work: CellContext) -> LearnedTaskResult:
        parts = work.result(self.data)
        whole: Dataset = parts.training
        if parts.test is not None:
            whole = whole.with_episodes([*parts.training, *parts.test])
        learned = make_task(self.task).learn(whole)
        if not learned.warning or not learned.exact:
            spec = Spec(self.task.name, {**self.task.parameters, **learned.parameters})
            warning = f"{learned.warning} {REMEDY}" if learned.warning else ""
            return LearnedTaskResult(spec.text, learned.sentences, warning)
        spec = Spec(self.task.name, {**self.task.parameters, **learned.exact})
        seconds = _step_seconds(make_task(spec).bind(whole.system), whole)
        sentence = (
            f"{learned.warning} The environment is put into each state instead and gives its own reward, which takes "
            f"{1e6 * seconds:.2g} µs a step: a search has the generations that fit into {self.search_minutes:g} min "
            "(search_minutes)."
        )
        return LearnedTaskResult(spec.text, (sentence,), step_seconds=seconds)


REMEDY = (
    "Fitness in models is unreliable. Record longer or under a controller that reaches other rewards and ends, or "
    "write the reward as a function, register_reward, in a file for --plugin FILE."
)
TIMED = 64
"""Number of recorded steps whose reward is timed."""


def _step_seconds(task: Task, dataset: Dataset) -> float:
    """Return the seconds in which a bound ``task`` computes the reward of one step, with two digits."""
    longest = max(dataset, key=len)
    before, control, after = longest.states[:-1][:TIMED], longest.controls[:TIMED], longest.states[1:][:TIMED]
    state, began = task.begin(trial_seeds(0, len(before))), time.perf_counter()
    task.advance(state, before, after, control=control)
    return float(f"{(time.perf_counter() - began) / len(before):.2g}")


LEARN = "learn"
CELL_KINDS[LEARN] = CellKind(result_of(LearnedTaskResult), version=3)


def learning_cell(
    task: Spec, search_minutes: float, data: Cell, dataset: Dataset | None = None
) -> Cell[LearnTask] | None:
    """Return the cell in which ``task`` learns its reward from ``data``, None if it needs no recording.

    Raises `InvalidData` if the recordings, ``dataset`` if they are read already, have no rewards.
    """
    made = make_task(task)
    if not made.needs_recording:
        return None
    if dataset is not None and not reward_digest(dataset):
        raise InvalidData(
            f"the task {task} learns its reward from the recordings, and these have none. Record the environment again "
            f"(--robot ... --minutes ... in place of --data), or write the reward as a function, register_reward, in a "
            "file for --plugin FILE"
        )
    return LearnTask(task, data, search_minutes).cell()


def needed(learned: Cell[LearnTask] | None) -> tuple[Cell, ...]:
    """Return the cell ``learned``, if there is one."""
    return () if learned is None else (learned,)


def learned_task(task: Spec, learned: Cell[LearnTask] | None, work: CellContext) -> Spec:
    """Return ``task`` with what it learned in the cell ``learned``."""
    if learned is None:
        return task
    found: LearnedTaskResult | None = work.result(learned)
    if found is None:
        raise Blocked(blocked_reason(learned))
    return Spec.parse(found.task)


def with_learned_task(
    evolution: ControllerEvolution, learned: Cell[LearnTask] | None, work: CellContext
) -> ControllerEvolution:
    """Return ``evolution`` for the task learned in the cell ``learned``, with fewer generations if it is slow."""
    if learned is None:
        return evolution
    task = learned_task(evolution.task, learned, work)
    seconds = evolution.trials * evolution.repeats * CANDIDATES * STEPS * work.result(learned).step_seconds
    most = max(FEWEST, int(60.0 * learned.settings.search_minutes / seconds)) if seconds else evolution.generations
    return replace(evolution, task=task, generations=min(most, evolution.generations))
