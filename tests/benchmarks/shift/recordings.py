"""What is fitted to, adapted to and tested on: two real cars, four floors, emulated robots in several conditions."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from sysid_evo.data import Dataset, Trajectory
from sysid_evo.validation.folds import Block
from tests.benchmarks.cars import recording
from tests.benchmarks.shift.emulated import Condition, cars, cart_poles, heaters, pendulums, recorded

LONGEST = 30.0  # s to adapt to
EPISODES, TEST_EPISODES, NEW_EPISODES, NEW_RECORDINGS = 12, 6, 2, 3
"""Number of emulated episodes to fit to, to test on and to adapt to, and number of recordings to adapt to."""
TYPICAL_DT = 0.05  # s


@dataclass(frozen=True)
class Case:
    """``training`` of one condition; ``new`` recordings to adapt to, in-domain data and a test of the other."""

    name: str
    shifted: bool
    training: Dataset
    new: tuple[Dataset, ...]
    own: Dataset
    test: Dataset

    def first(self, seconds: float, seed: int = 0) -> Dataset:
        """Return ``seconds`` of a new recording, which depends on the ``seed``: of another one, or another part of it.

        Of a slow system, sampled at less than 20 Hz, it is as many samples as of one that is sampled at 20 Hz.
        """
        new = self.new[seed % len(self.new)]
        steps = round(seconds / min(new.system.dt, TYPICAL_DT))
        begin = steps * (seed // len(self.new))
        begin = begin if begin + steps <= new.n_steps else 0
        return Block(begin, begin + steps, 1).part(new)


def cases(wanted: str) -> Iterator[Case]:
    """Yield the cases of the group ``wanted``, one of `GROUPS`."""
    yield from GROUPS[wanted]()


def real_cars() -> Iterator[Case]:
    """Each of the two cars after the other and after itself: 30 s from its first motion on, tested on what follows."""
    logs = {"slippery": recording("slippery_20hz"), "free": recording("free_20hz")}
    for before, (training, _) in logs.items():
        for after, (own, drive) in logs.items():
            new, test = cut(drive)
            yield Case(f"{before} -> {after}", before != after, training, (new,), own, test)


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
            (new,),
            data.with_episodes([own]),
            data.with_episodes([test]),
        )


def emulated(conditions: Callable[[], Mapping[str, Condition]]) -> Iterator[Case]:
    """The nominal robot in each of its ``conditions``, the first of which is its own."""
    found = conditions()
    own_name = next(iter(found))
    training = recorded(found[own_name], episodes=EPISODES, seed=1)
    for seed, (name, condition) in enumerate(found.items(), start=10):
        own, test = (
            recorded(condition, episodes=count, seed=10 * seed + i) for i, count in ((1, EPISODES), (2, TEST_EPISODES))
        )
        new = tuple(
            recorded(condition, episodes=NEW_EPISODES, seed=10 * seed + i) for i in (0, *range(3, 2 + NEW_RECORDINGS))
        )
        robot = conditions.__name__.removesuffix("s").replace("_", "-")
        shown = f"{robot}: nominal" if robot != "car" else "nominal"
        yield Case(f"{shown} -> {name}", name != own_name, training, new, own, test)


def cut(drive: Dataset) -> tuple[Dataset, Dataset]:
    """Return the 30 s from the first motion on, and the rest."""
    episode = drive.episodes[0]
    begin = int(np.argmax(drive.moving[0]))
    end = begin + round(LONGEST / drive.system.dt)
    return drive.with_episodes([episode[begin:end]]), drive.with_episodes([episode[end:]])


GROUPS: dict[str, Callable[[], Iterator[Case]]] = {
    "cars": real_cars,
    "floors": floors,
    "emulated": partial(emulated, cars),
    "heater": partial(emulated, heaters),
    "pendulum": partial(emulated, pendulums),
    "cart-pole": partial(emulated, cart_poles),
}
