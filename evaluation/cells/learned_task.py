"""The cell of a task that learns its reward from the data of a comparison, and its use by cells of controllers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from evaluation.storage import result_of
from sysid_evo.data import Dataset
from sysid_evo.data.trajectory import reward_digest
from sysid_evo.errors import Blocked, InvalidData
from sysid_evo.evolution import ControllerEvolution
from sysid_evo.plan import CELL_KINDS, Cell, CellContext, CellKind, CellSettings, blocked_reason
from sysid_evo.registry import Spec, tasks
from sysid_evo.tasks.task import make_task


@dataclass(frozen=True)
class LearnedTaskResult:
    """The spec of a task with what it has learned, as text, and sentences on its held-out errors."""

    task: str
    sentences: tuple[str, ...]


@dataclass(frozen=True)
class LearnTask(CellSettings):
    """The task ``task`` learns its reward from all recordings in ``data``; it has held-out errors of its own."""

    task: Spec
    data: Cell

    def cell(self) -> Cell[LearnTask]:
        """Return the cell of the learned task."""
        name = f"task-{self.task.name}"
        return Cell(kind=LEARN, name=name, title="learn the reward", settings=self, needs=(self.data,))

    def inputs(self) -> dict[str, Any]:
        return {"task": tasks.identity(self.task)}

    def compute(self, work: CellContext) -> LearnedTaskResult:
        parts = work.result(self.data)
        whole: Dataset = parts.training
        if parts.test is not None:
            whole = whole.with_episodes([*parts.training, *parts.test])
        learned = make_task(self.task).learn(whole)
        spec = Spec(self.task.name, {**self.task.parameters, **learned.parameters})
        return LearnedTaskResult(spec.text, learned.sentences)


LEARN = "learn"
CELL_KINDS[LEARN] = CellKind(result_of(LearnedTaskResult))


def learning_cell(task: Spec, data: Cell, dataset: Dataset | None = None) -> Cell[LearnTask] | None:
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
    return LearnTask(task, data).cell()


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
    """Return ``evolution`` for the task as it was learned in the cell ``learned``."""
    return evolution if learned is None else replace(evolution, task=learned_task(evolution.task, learned, work))
