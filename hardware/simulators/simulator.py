"""The contract of a simulator that advances step by step, and the runner of controllers in it.

A simulator runs episodes: each is begun from a seed and advances one sample at a time until it is over. It does not run
in real time.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from hardware.connection import Closeable
from sysid_evo.controllers import Controller
from sysid_evo.controllers.controller import View
from sysid_evo.data import Trajectory
from sysid_evo.data.trajectory import TERMINATED, TRUNCATED
from sysid_evo.engine import Rollouts, results
from sysid_evo.engine.rollout import BoundRunner
from sysid_evo.errors import InvalidArgument
from sysid_evo.progress import Counter, Progress
from sysid_evo.randomness import CONTROLLER_STREAM, draw_for_steps
from sysid_evo.system import System
from sysid_evo.tasks.task import Task, TaskState
from sysid_evo.types import Array, BoolArray, Seeds, check_shape

LONGEST_SEED = 2**31
"""Upper bound of the seeds of episodes."""


class ExternalSimulator(ABC):
    """A simulator that advances only when it is stepped; ``name`` is shown in reports.

    A ``settable`` one can be put into any state of its ``system``. The steps of a ``rewarded`` one have rewards, which
    are recorded.
    """

    name: str
    system: System
    settable: bool = True
    rewarded: ClassVar[bool] = False

    @abstractmethod
    def open(self) -> SimulatorSession:
        """Return a session; use it in a ``with`` statement."""


class SimulatorSession(Closeable):
    """Episodes of one simulator, one after the other."""

    @abstractmethod
    def reset(self, seed: int, at: Array | None = None) -> Array:
        """Begin an episode and return its first state (nx,); ``at`` puts a settable simulator into that state."""

    @abstractmethod
    def step(self, control: Array) -> tuple[Array, float, bool, bool]:
        """Return the next state (nx,), the reward, whether the episode ended there, and whether its time is up."""

    def close(self) -> None:
        """End the session; does nothing by default."""


def ending_of(over: bool, late: bool) -> str:
    """Return the ending of an episode after a step, see `Trajectory`; "" if it continues."""
    return TERMINATED if over else TRUNCATED if late else ""


ENGINE = "environment"
AT_ONCE = 128
"""Number of sessions that run in parallel, with one call of controller and task for all."""


@dataclass(frozen=True)
class SimulatorRunner:
    """Runs every candidate in the simulator itself, step by step: its column of the transfer matrix.

    A trial begins in the initial state of the task, if the simulator can be put there, else with the simulator's own
    reset with the trial's seed. It is over when the simulator or the task ends it.
    """

    simulator: ExternalSimulator
    progress: Progress | None = None

    def reporting(self, progress: Progress) -> SimulatorRunner:
        """Return this runner, which calls ``progress`` with the steps done in all candidates and trials."""
        return replace(self, progress=progress)

    def bind(self, controller: Controller, task: Task) -> BoundRunner:
        """Return a function that runs ``controller`` at ``task``, see `Runner`."""
        bound = task.bind(self.simulator.system)
        return partial(self._run, controller.bind_to(bound), bound)

    def _run(
        self, controller: Controller, task: Task, parameters: Array, seeds: Seeds, *, record: bool = False
    ) -> Rollouts:
        parameters = check_shape("parameters", parameters, (None, controller.n_parameters))
        if len(seeds) < 1 or len(parameters) < 1:
            raise InvalidArgument(f"{self.simulator.name}: expected at least one candidate and one seed, got none")
        each = max(1, AT_ONCE // len(seeds))
        parts: list[_Trials] = []
        blocks = -(-len(parameters) // each)
        counter = Counter(self.progress, blocks * task.horizon)
        with ExitStack() as stack:
            count = min(each, len(parameters)) * len(seeds)
            sessions = [stack.enter_context(self.simulator.open()) for _ in range(count)]
            for first in range(0, len(parameters), each):
                trials = _Trials(self.simulator, sessions, controller, parameters[first : first + each], task, seeds)
                trials.run(record, counter)
                parts.append(trials)
                counter.advance(len(parts) * task.horizon - counter.done)
        return _joined(parts, len(seeds), record)


class _Trials:
    """P candidates in E trials, each in a session of its own."""

    def __init__(
        self,
        simulator: ExternalSimulator,
        sessions: list[SimulatorSession],
        controller: Controller,
        parameters: Array,
        task: Task,
        seeds: Seeds,
    ) -> None:
        self.system, self.task, self.controller, self.parameters = simulator.system, task, controller, parameters
        self.rewarded = task.rewarded_by(simulator.name)
        self.seeds, self.grid = seeds, (len(parameters), len(seeds))
        batch = len(parameters) * len(seeds)
        self.sessions = sessions[:batch]
        task_state = task.begin(seeds).tile(len(parameters))
        begun = [
            session.reset(int(seed), task_state.state[i] if simulator.settable else None)
            for i, (session, seed) in enumerate(zip(self.sessions, np.tile(seeds, len(parameters)), strict=True))
        ]
        self.state = np.array(begun)
        self.task_state: TaskState = replace(task_state, state=self.state)
        self.survived = np.zeros(batch, dtype=np.int64)
        self.diverged = np.zeros(batch, dtype=bool)
        self.counts = np.zeros((batch, 2 * (self.system.nx + self.system.nu)))
        self.states = [[state] for state in self.state]
        self.controls: list[list[Array]] = [[] for _ in range(batch)]
        self.rewards: list[list[float]] = [[] for _ in range(batch)]
        self.endings = [""] * batch

    def run(self, record: bool, counter: Counter) -> None:
        """Step until every trial is over, and count the steps."""
        memory = np.zeros((*self.grid, self.controller.n_memory))
        noise = draw_for_steps(self.seeds, self.task.horizon, self.controller.n_noise, CONTROLLER_STREAM)
        centre = results.neutral_values(self.system)
        over = np.zeros(len(self.state), dtype=bool)
        for k in range(self.task.horizon):
            going = self.task_state.alive & ~over & ~self.diverged
            if not going.any():
                break
            counter.advance(1)
            observation = self.task.observe(self.task_state, self.state)
            drawn = np.broadcast_to(noise[:, k], (*self.grid, self.controller.n_noise)) if noise.size else None
            view = View(observation.reshape(*self.grid, -1), self.state.reshape(*self.grid, -1), self.task_state, drawn)
            raw, memory = self.controller.act(self.parameters, memory, view)
            control = self.system.actuate(raw.reshape(len(self.state), self.system.nu))
            if results.sampled(k):
                self.counts += results.above_and_below(self.state, control, centre) & going[:, None]
            after, reward, ended = self._step(control, going)
            going = going & ~self.diverged
            if self.rewarded:
                advanced = self.task.advance_rewarded(self.task_state, reward)
            else:
                advanced, _ = self.task.advance(self.task_state, self.state, after, control=control)
            self.task_state = self.task_state.updated_where(advanced, going)
            self.state = np.where(going[:, None], after, self.state)
            over |= ended
            self.survived += going
            if record:
                for i in np.flatnonzero(going):
                    self.states[i].append(self.state[i])
                    self.controls[i].append(control[i])

    def _step(self, control: Array, going: BoolArray) -> tuple[Array, Array, BoolArray]:
        """Return states (B, nx) and rewards (B,) after one step, and which trials the simulator ended."""
        after, rewards, ended = self.state.copy(), np.zeros(len(going)), np.zeros(len(going), dtype=bool)
        for i in np.flatnonzero(going):
            after[i], rewards[i], over, late = self.sessions[i].step(control[i])
            ended[i] = over or late
            self.rewards[i].append(rewards[i])
            self.endings[i] = ending_of(over, late)
        self.diverged |= ~(np.isfinite(after).all(axis=1) & np.isfinite(rewards))
        after = self.system.unwrap_towards(np.where(np.isfinite(after), after, self.state), self.state)
        return after, rewards, ended

    def trajectories(self) -> list[Trajectory]:
        """Return the recordings of the trials with at least one step."""
        return [
            Trajectory(
                np.array(self.states[i]),
                np.array(self.controls[i]),
                self.system.dt,
                name=f"candidate-{i // self.grid[1]}-trial-{i % self.grid[1]}",
                rewards=np.array(self.rewards[i][: len(self.controls[i])]),
                ending=self.endings[i] if len(self.rewards[i]) == len(self.controls[i]) else "",
            )
            for i in range(len(self.state))
            if self.controls[i]
        ]


def _joined(parts: list[_Trials], trials: int, record: bool) -> Rollouts:
    survived = np.concatenate([part.survived for part in parts]).reshape(-1, trials)
    scores = [results.scored(one.task, one.task.fitness(one.task_state), one.survived, one.diverged) for one in parts]
    described = [results.time_shares(part.counts, part.survived, part.diverged) for part in parts]
    return Rollouts(
        fitness=np.concatenate(scores).reshape(-1, trials),
        survived=survived,
        clipped=np.zeros_like(survived),
        task_state=parts[-1].task_state,
        engine=ENGINE,
        behaviour=np.concatenate(described).reshape(len(survived), trials, -1),
        trajectories=tuple(trajectory for part in parts for trajectory in part.trajectories()) if record else (),
    )
