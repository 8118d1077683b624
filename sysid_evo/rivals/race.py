"""Two bodies on one walled track, which slow each other down where they touch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self, cast

import numpy as np

from sysid_evo.arrays import Array, BoolArray, IntArray, Seeds
from sysid_evo.rivals.bodies import RIVAL, one_body
from sysid_evo.system import System
from sysid_evo.tasks.duel import Duel
from sysid_evo.tasks.scene import Scene
from sysid_evo.tasks.task import Task, TaskState
from sysid_evo.tasks.walled_track import WalledTrackState

if TYPE_CHECKING:
    from sysid_evo.engine.compiled.kernel import TaskKernel

DECIDED = 10.0
"""A lead (m) that counts in full: more is no better."""
KEPT_IN_TOUCH = 0.8
"""Share of its speed that a body keeps in each step in which it touches the other."""


@dataclass(frozen=True)
class RaceState(TaskState):
    """``own`` and ``rival`` are where the two stand, ``contacts`` (B,) the steps in which they touched."""

    own: WalledTrackState
    rival: WalledTrackState
    contacts: IntArray

    def tile(self, copies: int) -> Self:
        return self.of(self.own.tile(copies), self.rival.tile(copies), np.tile(self.contacts, copies))

    def only(self, trial: int) -> Self:
        return self.of(self.own.only(trial), self.rival.only(trial), self.contacts[trial : trial + 1])

    def keep(self, advanced: Self, going: BoolArray) -> Self:
        contacts = np.where(going, advanced.contacts, self.contacts)
        return self.of(self.own.keep(advanced.own, going), self.rival.keep(advanced.rival, going), contacts)

    def of(self, own: WalledTrackState, rival: WalledTrackState, contacts: IntArray) -> Self:
        state = np.concatenate([own.state, rival.state], axis=1)
        return replace(self, state=state, pose=own.pose, alive=own.alive, own=own, rival=rival, contacts=contacts)


class Race(Task):
    """Fitness is how far (m) the first body is ahead of the second at the end, at most ``DECIDED`` either way.

    Both do the same `Duel` on the same track and begin side by side, on sides that the trial's seed says. In every
    step in which their distance is below that of two bodies both keep ``KEPT_IN_TOUCH`` of their speed.
    """

    fitness_unit = "m"
    worst = -DECIDED

    def __init__(self, duel: Duel) -> None:
        self.duel, self.horizon = duel, duel.horizon
        rival = (replace(channel, name=f"{RIVAL}{channel.name}") for channel in duel.observations)
        self.observations = (*duel.observations, *rival)

    alone: Duel

    def check_system(self, system: System) -> None:
        self.duel.check_system(one_body(system))

    def bind(self, system: System) -> Self:
        bound = super().bind(system)
        bound.alone = self.duel.bind(one_body(system))
        return bound

    def begin(self, seeds: Seeds) -> RaceState:
        side = 0.25 * self.duel.width * (1.0 - 2.0 * (np.asarray(seeds, dtype=np.uint64) & np.uint64(1)))
        begun, middle = self.alone.begin(seeds), np.zeros(len(seeds))
        own, rival = (replace(begun, pose=np.stack([middle, y, middle], axis=1)) for y in (side, -side))
        state, contacts = np.tile(begun.state, (1, 2)), np.zeros(len(seeds), dtype=np.int64)
        return RaceState(state, own.pose, own.alive, own, rival, contacts)

    def observe(self, task_state: TaskState, state: Array) -> Array:
        here = cast("RaceState", task_state)
        mine, its = np.split(state, 2, axis=1)
        seen = (
            self.alone.observe_rival(here.own, mine, here.rival.pose),
            self.alone.observe_rival(here.rival, its, here.own.pose),
        )
        return np.concatenate(seen, axis=1)

    def advance(
        self, task_state: TaskState, before: Array, after: Array, *, control: Array, pose: Array | None = None
    ) -> tuple[TaskState, Array]:
        here = cast("RaceState", task_state)
        (x, its_x), (y, its_y), (u, its_u) = (np.split(both, 2, axis=1) for both in (before, after, control))
        own, y = self.alone.advance(here.own, x, y, control=u, pose=pose)
        rival, its_y = self.alone.advance(here.rival, its_x, its_y, control=its_u)
        apart = own.pose[:, :2] - rival.pose[:, :2]
        touching = (apart**2).sum(axis=1) < (2.0 * self.duel.body) ** 2
        kept = np.where(touching, KEPT_IN_TOUCH, 1.0)[:, None]
        reached = np.concatenate([y, its_y], axis=1)
        rows = [row + i * self.alone.system.nx for i in (0, 1) for row in self.alone.speeds]
        reached[:, rows] *= kept
        joined = here.of(cast("WalledTrackState", own), cast("WalledTrackState", rival), here.contacts + touching)
        return joined, reached

    def fitness(self, task_state: TaskState) -> Array:
        here = cast("RaceState", task_state)
        return np.clip(here.own.furthest - here.rival.furthest, -DECIDED, DECIDED)

    def measures(self, task_state: TaskState) -> Mapping[str, Array]:
        """Return how far (m) both came, and the steps in which they touched."""
        here = cast("RaceState", task_state)
        way, its = here.own.furthest, here.rival.furthest
        return {"way (m)": way, "way of the rival (m)": its, "contacts": here.contacts.astype(np.float64)}

    def scene(self, task_state: TaskState, trial: int) -> Scene:
        """Return both walls of one trial."""
        return self.duel.scene(cast("RaceState", task_state).own, trial)

    def kernel(self) -> TaskKernel | None:
        from sysid_evo.engine.kernels.race import race_kernel

        return race_kernel(self)
