"""Results of rollouts: fitness, behaviour descriptors, trajectories."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sysid_evo.data.trajectory import Trajectory
from sysid_evo.engine.compiled.closed_loop import LoopResults
from sysid_evo.engine.compiled.loops import SAMPLE_EVERY
from sysid_evo.system import System
from sysid_evo.tasks.task import Task, TaskState
from sysid_evo.types import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Rollouts:
    """Results of P candidates in E trials.

    - ``fitness`` (P, E): never nan. A trial that diverged has ``task.worst - 1 + survived / horizon``, less than any
      trial that did not diverge.
    - ``survived`` (P, E): number of steps; ``clipped`` (P, E): steps whose state was clipped to the state bounds.
    - ``task_state``: the last state of the task, (P E) trials; ``engine``: the form that ran.
    - ``behaviour`` (P, E, d): descriptors, see `behaviour_names`; d is 0 if they were not counted.
    - ``outside`` (P, E): steps outside the data, as counted by the dynamics (`Dynamics`); empty if the runner has none.
    - ``trajectories``: if recorded, candidate first, trial second; ``missing``: reasons for skipped trials of a robot.
    """

    fitness: Array
    survived: IntArray
    clipped: IntArray
    task_state: TaskState
    engine: str
    behaviour: Array = field(default_factory=lambda: np.empty((0, 0, 0)))
    outside: Array = field(default_factory=lambda: np.empty((0, 0)))
    trajectories: tuple[Trajectory, ...] = ()
    missing: tuple[str, ...] = ()


def finished(
    found: LoopResults, task: Task, system: System, start: TaskState, task_state: TaskState, engine: str, record: bool
) -> Rollouts:
    """Return the rollouts of trials that begin with ``start`` (E,) and end with ``task_state`` (P E,)."""
    grid = len(found.fitness) // len(start.pose), len(start.pose)
    return Rollouts(
        fitness=scored(task, found.fitness, found.survived, found.diverged).reshape(grid),
        survived=found.survived.reshape(grid),
        clipped=found.clipped.reshape(grid),
        task_state=task_state,
        engine=engine,
        behaviour=time_shares(found.counts, found.survived, found.diverged).reshape(*grid, -1),
        outside=np.where(found.diverged, 0.0, found.outside).reshape(grid),
        trajectories=trajectories(found.tape, found.survived, start.pose, task, system) if record else (),
    )


def scored(task: Task, fitness: Array, survived: IntArray, diverged: BoolArray) -> Array:
    """Return ``fitness`` (B,); a diverged trial scores less than all others, but more the later it diverged."""
    return np.where(diverged, task.worst - 1.0 + survived / task.horizon, fitness)


def sampled(step: int) -> bool:
    """True if the behaviour is sampled in this step."""
    return step % SAMPLE_EVERY == 0


def behaviour_names(system: System) -> tuple[str, ...]:
    """Return the names of the descriptors in `Rollouts.behaviour`: two for each state, then two for each control."""
    channels = (*system.states, *system.controls)
    return tuple(f"{channel.name} {side}" for channel in channels for side in ("above", "below"))


def neutral_values(system: System) -> Array:
    """Return the neutral value of each state and then each control, (nx + nu,)."""
    return np.concatenate([system.neutral_state, system.neutral_control])


def above_and_below(states: Array, controls: Array, centre: Array) -> BoolArray:
    """Return whether each value of states (B, nx) and controls (B, nu) is above, and below, ``centre``: (B, d)."""
    off = np.concatenate([states, controls], axis=1) - centre
    return np.stack([off > 0.0, off < 0.0], axis=2).reshape(len(off), -1)


def time_shares(counts: Array, survived: IntArray, diverged: BoolArray) -> Array:
    """Return the descriptors (B, d) in [0, 1] from the counted samples; 0 for a rollout that diverged."""
    samples = np.maximum(1, -(-survived // SAMPLE_EVERY))[:, None]
    return np.where(diverged[:, None], 0.0, counts / samples)


def trajectories(
    tape: Sequence[Array], survived: IntArray, pose: Array, task: Task, system: System
) -> tuple[Trajectory, ...]:
    """Return the trajectory of each rollout with at least one step, from ``tape`` (states, controls, poses).

    Values after the last step, and poses before the first, are ignored: ``pose`` (E, n) holds the first poses.
    """
    states, controls, poses = tape
    trials = len(pose)
    states = states.reshape(-1, task.horizon + 1, system.nx)
    controls = controls.reshape(-1, task.horizon, system.nu)
    poses_of = poses.reshape(len(states), task.horizon + 1, -1) if pose.shape[1] else None
    found = []
    for i, steps in enumerate(survived):
        if steps == 0:
            continue
        path = None
        if poses_of is not None:
            path = np.concatenate([pose[i % trials][None], poses_of[i, 1 : steps + 1].astype(np.float64)])
        name = f"candidate-{i // trials}-trial-{i % trials}"
        state, control = states[i, : steps + 1].astype(np.float64), controls[i, :steps].astype(np.float64)
        found.append(Trajectory(state, control, system.dt, path, name))
    return tuple(found)
