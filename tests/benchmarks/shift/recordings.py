"""What is fitted to, adapted to and tested on: two real cars, four floors, emulated cars in several conditions."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sysid_evo.data import Dataset, Trajectory
from tests.benchmarks.cars import recording
from tests.benchmarks.shift.emulated import cars, recorded

LONGEST = 30.0  # s to adapt to
EMULATED_TIME = 240.0


@dataclass(frozen=True)
class Case:
    """``training`` of one condition; ``new`` seconds, in-domain data and a test of the other."""

    name: str
    shifted: bool
    training: Dataset
    new: Dataset
    own: Dataset
    test: Dataset

    def first(self, seconds: float) -> Dataset:
        """Return the first ``seconds`` of the new recording."""
        left, kept = round(seconds / self.new.system.dt), list[Trajectory]()
        for episode in self.new:
            if left > 1:
                kept.append(episode[: min(left, len(episode))])
                left -= len(kept[-1])
        return self.new.with_episodes(kept)


def cases(wanted: str) -> Iterator[Case]:
    """Yield the cases of the group ``wanted``, one of `GROUPS`."""
    yield from GROUPS[wanted]()


def real_cars() -> Iterator[Case]:
    """Each of the two cars after the other and after itself: 30 s from its first motion on, tested on what follows."""
    logs = {"slippery": recording("slippery_20hz"), "free": recording("free_20hz")}
    for before, (training, _) in logs.items():
        for after, (own, drive) in logs.items():
            new, test = cut(drive)
            yield Case(f"{before} -> {after}", before != after, training, new, own, test)


def floors() -> Iterator[Case]:
    """Each of four drives after the other three; the middle of it is its own kind."""
    root = Path(os.environ.get("SYSID_EVO_DATA", Path(__file__).parents[3].parent / "shared" / "data"))
    data = Dataset.read(root / "f1tenth_frictionmaps")
    drives: dict[str, list[Trajectory]] = {}
    for episode in data:
        drives.setdefault(episode.name.split("_")[0], []).append(episode)
    for name, episodes in drives.items():
        others = [episode for other, theirs in drives.items() if other != name for episode in theirs]
        longest = max(episodes, key=len)
        new, rest = cut(data.with_episodes([longest]))
        middle = len(rest.episodes[0]) // 2
        own, test = rest.episodes[0][:middle], rest.episodes[0][middle:]
        yield Case(
            f"others -> {name}",
            True,
            data.with_episodes(others),
            new,
            data.with_episodes([own]),
            data.with_episodes([test]),
        )


def emulated() -> Iterator[Case]:
    """The nominal car, then with half the grip, a low battery, another of its kind, and itself."""
    robots = cars()
    training = recorded(robots["nominal"].dynamics, seconds=EMULATED_TIME, seed=1)
    for seed, (name, robot) in enumerate(robots.items(), start=10):
        new, own, test = (
            recorded(robot.dynamics, seconds=seconds, seed=10 * seed + i)
            for i, seconds in enumerate((40.0, EMULATED_TIME, 120.0))
        )
        yield Case(f"nominal -> {name}", name != "nominal", training, new, own, test)


def cut(drive: Dataset) -> tuple[Dataset, Dataset]:
    """Return the 30 s from the first motion on, and the rest."""
    episode = drive.episodes[0]
    begin = int(np.argmax(drive.moving[0]))
    end = begin + round(LONGEST / drive.system.dt)
    return drive.with_episodes([episode[begin:end]]), drive.with_episodes([episode[end:]])


GROUPS: dict[str, Callable[[], Iterator[Case]]] = {
    "cars": real_cars,
    "floors": floors,
    "emulated": emulated,
}
