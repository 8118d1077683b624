"""Trials that somebody else controls: each goes on by one step when it is given a control, and can begin anew."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from gymnasium.error import ResetNeeded

from sysid_evo.arrays import Array, BoolArray, IntArray, Seeds
from sysid_evo.dynamics import Dynamics, clip_state
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.randomness import step_noise, trial_draws
from sysid_evo.tasks.task import Task


class Trials:
    """``count`` trials of ``task``, side by side, each on one of the dynamics in ``members``.

    The rules are those of a rollout: noise and draws depend on the trial's seed alone, a state beyond the envelope is
    clipped, a trial that diverges is over and worth less than any that does not. Raises `InvalidArgument` without a
    member, `IncompatibleSystem` for members of different systems, `IncompatibleTask`.
    """

    def __init__(self, members: Mapping[str, Dynamics], task: Task, count: int) -> None:
        if not members or count < 1:
            raise InvalidArgument(
                f"environment: expected one model or more, and one trial, got {len(members)}, {count}"
            )
        self.names, self.members = tuple(members), tuple(members.values())
        self.system = self.members[0].system
        for name, member in members.items():
            differences = self.system.differences(member.system)
            if differences:
                raise IncompatibleSystem(f"environment: {self.names[0]} and {name} differ: {'; '.join(differences)}")
        self.task = task.bind(self.system)
        self.member = np.zeros(count, dtype=np.int64)
        self.seeds = np.zeros(count, dtype=np.uint64)
        self.survived = np.zeros(count, dtype=np.int64)
        self.fitness = np.zeros(count)
        self._task_state = self.task.begin(self.seeds)
        self._carries = [np.zeros((count, member.n_carry)) for member in self.members]
        self._noise = [np.zeros((0, 0))] * count
        self._begun = False

    def begin(self, rows: IntArray, seeds: Seeds, members: IntArray) -> None:
        """Let the trials ``rows`` (k,) begin anew, with these ``seeds`` (k,) on these members (k,), by number."""
        self._begun = True
        self.seeds[rows], self.member[rows], self.survived[rows] = seeds, members, 0
        fresh, restarted = self.task.begin(self.seeds), np.zeros(len(self.seeds), dtype=bool)
        restarted[rows] = True
        self._task_state = self._task_state.keep(fresh, restarted)
        self.fitness[rows] = self.task.fitness(fresh)[rows]
        for row in rows:
            number = int(self.member[row])
            member, seed = self.members[number], self.seeds[row : row + 1]
            states = np.tile(fresh.state[row], (1, member.n_lags + 1, 1))
            controls = np.tile(self.system.neutral_control, (1, member.n_lags, 1))
            self._carries[number][row] = member.start(states, controls, trial_draws(seed, member.n_draws))[0]
            self._noise[row] = step_noise(seed, self.task.horizon, member.n_noise)[0]

    @property
    def state(self) -> Array:
        """The states (count, nx)."""
        return self._taken([0] * len(self.members))

    def observe(self) -> Array:
        """Return what a controller is shown, (count, n_observations)."""
        return self.task.observe(self._task_state, self._taken([member.observed_at for member in self.members]))

    def step(self, control: Array) -> tuple[Array, BoolArray, BoolArray]:
        """Go one step on under ``control`` (count, nu).

        Return by how much the fitness grew (count,), which trials are over, and which have reached the horizon.
        Raises `gymnasium.error.ResetNeeded` before the first reset.
        """
        if not self._begun:
            raise ResetNeeded("environment: no trial has begun; call reset() before step()")
        nx, before = self.system.nx, self.state
        after, diverged = before.copy(), np.zeros(len(before), dtype=bool)
        with np.errstate(all="ignore"):
            for number, member in enumerate(self.members):
                rows = np.flatnonzero(self.member == number)
                if len(rows):
                    last = np.minimum(self.survived[rows], self.task.horizon - 1)
                    drawn = [self._noise[row][k] for row, k in zip(rows, last, strict=True)]
                    carry = self._carries[number][rows]
                    stepped = member.step(carry, control[rows], np.array(drawn) if member.n_noise else None)
                    diverged[rows] = ~np.isfinite(stepped).all(axis=1)
                    stepped, _ = clip_state(np.where(diverged[rows, None], carry, stepped), member.envelope)
                    self._carries[number][rows], after[rows] = stepped, stepped[:, :nx]
            advanced, reached = self.task.advance(self._task_state, before, after, control=control)
        for number, carries in enumerate(self._carries):
            rows = np.flatnonzero(self.member == number)
            carries[rows, :nx] = reached[rows]
        self._task_state = self._task_state.keep(advanced, ~diverged)
        self.survived += ~diverged
        lost = self.task.worst - 1.0 + self.survived / self.task.horizon
        fitness = np.where(diverged, lost, self.task.fitness(self._task_state))
        growth, self.fitness = fitness - self.fitness, fitness
        return growth, diverged | ~self._task_state.alive, self.survived >= self.task.horizon

    def _taken(self, places: list[int]) -> Array:
        """Return nx numbers of each trial's carry, (count, nx): from ``places`` on, one for each member."""
        found = np.zeros((len(self.member), self.system.nx))
        for number, at in enumerate(places):
            rows = self.member == number
            found[rows] = self._carries[number][rows, at : at + self.system.nx]
        return found
