"""The data of a comparison as a cell: recorded on a robot, or given; split into training and test."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from evaluation.cells.plants import Plant
from sysid_evo.data import Dataset
from sysid_evo.data.response import without_dead_stretches
from sysid_evo.data.trajectory import reward_digest
from sysid_evo.errors import InvalidArgument, LinkLost
from sysid_evo.plan import CELL_KINDS, Cell, CellContext, CellKind, CellSettings, ResultType
from sysid_evo.registry import Spec, make_robot, robots

TRAINING, TEST = "training", "test"
MANY = 8
"""Minimum number of episodes from which whole ones can be held out."""
PREDICTABLE = 65
"""Number of samples needed for the longest prediction and the history before it."""


@dataclass(frozen=True)
class SplitDataset:
    """Training and test part of a data set; without ``test`` all of it is for training."""

    training: Dataset
    test: Dataset | None


@dataclass(frozen=True)
class HoldOut:
    """Split of a data set: test episodes by name, else the last share of each; 0 for no test.

    If most of the time is in episodes whose last share is too short for a prediction, whole episodes are held out
    instead, with the same share of the time.
    """

    episodes: tuple[str, ...] | None = None
    share: float = 0.25

    def of(self, dataset: Dataset) -> SplitDataset:
        """Return both parts. Raises `InvalidArgument` or `InvalidData`, see `Dataset.split`.

        Stretches in which commands have no effect are left out, unless the test episodes are named.
        """
        if self.episodes is not None:
            try:
                return SplitDataset(*dataset.split(self.episodes))
            except InvalidArgument as error:
                raise InvalidArgument(f"test: {str(error).removeprefix('split: ')}") from error
        dataset = without_dead_stretches(dataset)
        if self.share == 0.0:
            return SplitDataset(dataset, None)
        return SplitDataset(*dataset.split(whole_episodes(dataset, self.share) or self.share))


def whole_episodes(dataset: Dataset, share: float) -> list[str]:
    """Return the names of the episodes to hold out if parts of them would be too short, else none."""
    short = sum(len(episode) for episode in dataset if share * len(episode) < PREDICTABLE)
    if len(dataset) < MANY or short < 0.5 * dataset.n_steps:
        return []
    names, held, passed = [], 0, 0
    for episode in dataset:
        passed += len(episode)
        if held + len(episode) <= share * passed:
            names.append(episode.name)
            held += len(episode)
    return names


@dataclass(frozen=True)
class GivenData(CellSettings):
    """Recordings that have already been read, split."""

    dataset: Dataset
    split: HoldOut

    def cell(self) -> Cell[GivenData]:
        name = self.dataset.system.name or "data"
        return Cell(kind=DATA, name=name, title=f"prepare {name}", settings=self, local=True)

    def inputs(self) -> dict[str, Any]:
        named = [episode.condition for episode in self.dataset]
        conditions = {"conditions": named} if any(named) else {}
        rewards = {"rewards": found} if (found := reward_digest(self.dataset)) else {}
        return {"fingerprint": self.dataset.fingerprint, "split": asdict(self.split), **conditions, **rewards}

    def compute(self, work: CellContext) -> SplitDataset:
        return self.split.of(self.dataset)


@dataclass(frozen=True)
class RecordedData(CellSettings):
    """Manoeuvres driven on a robot for ``minutes``; the journals of a physical robot are stored next to the data."""

    robot: Spec
    seed: int
    minutes: float
    split: HoldOut

    def cell(self) -> Cell[RecordedData]:
        robot, seconds = make_robot(self.robot), 60.0 * self.minutes
        if not robot.physical:
            plant = Plant(self.robot.label, self.robot.name, robot=self.robot)
            seconds = 0.5 * self.minutes + 60.0 * self.minutes / robot.system.dt * plant.step_seconds()
        label = self.robot.label
        return Cell(
            kind=DATA,
            name=label,
            title=f"record {label}",
            settings=self,
            expected_seconds=seconds,
            local=robot.physical,
        )

    def inputs(self) -> dict[str, Any]:
        return {
            "robot": robots.identity(self.robot),
            "seed": self.seed,
            "minutes": self.minutes,
            "split": asdict(self.split),
        }

    def compute(self, work: CellContext) -> SplitDataset:
        robot = make_robot(self.robot)
        recorded = robot.record(
            seed=self.seed,
            duration=60.0 * self.minutes,
            folder=work.path / "journal" if robot.physical else None,
            progress=work.progress,
        )
        if recorded.report.reason.is_fault:
            raise LinkLost(f"{self.robot.label}: {recorded.report.sentence}")
        return self.split.of(recorded.dataset)


def _save(value: SplitDataset, path: Path, _: Cell) -> list[Path]:
    written = []
    for name, part in ((TRAINING, value.training), (TEST, value.test)):
        if part is not None:
            folder = part.save(path / name)
            written += sorted(file for file in folder.iterdir() if file.is_file())
    return written


def _load(path: Path) -> SplitDataset:
    test = path / TEST
    return SplitDataset(Dataset.load(path / TRAINING), Dataset.load(test) if test.is_dir() else None)


DATA = "data"
CELL_KINDS[DATA] = CellKind(ResultType("data", _save, _load), version=2)
