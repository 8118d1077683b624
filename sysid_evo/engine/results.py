"""What rollouts return: fitness, descriptors of behaviour, trajectories."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sysid_evo.data.trajectory import Trajectory
from sysid_evo.engine.compiled.closed_loop import LoopResults
from sysid_evo.engine.compiled.loops import EVERY
from sysid_evo.system import System
from sysid_evo.tasks.task import Task, TaskState
from sysid_evo.types import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Rollouts:
    """What P candidates did in E trials.

    ``fitness`` (P, E) is never nan: a trial that diverged has ``task.worst - 1 + survived /
    horizon``, below any that did not. ``survived`` (P, E) steps; ``clipped`` (P, E) counts the
    steps whose state was clipped to the model's state_bounds. ``behaviour`` (P, E, d) says what the controller
    did, see `behaviour_names`; d is 0 where nobody counted. ``penalty`` (P, E) is what the dynamics counted of it, in
    steps, see `Dynamics`; 0 where it counts none, empty where nobody asked it. ``trajectories`` (only when recorded)
    stand candidate first, trial second; ``task_state`` is the last one. ``engine`` names the form
    that ran. On a robot trials may be ``missing``: one reason for each that is not among the E.
    """

    fitness: Array
    survived: IntArray
    clipped: IntArray
    task_state: TaskState
    engine: str
    behaviour: Array = field(default_factory=lambda: np.empty((0, 0, 0)))
    penalty: Array = field(default_factory=lambda: np.empty((0, 0)))
    trajectories: tuple[Trajectory, ...] = ()
    missing: tuple[str, ...] = ()


def finished(
    found: LoopResults, task: Task, system: System, began: TaskState, task_state: TaskState, engine: str, record: bool
) -> Rollouts:
    """Return what came of trials that ``began`` (E,), of each candidate; ``task_state`` is the last one (P E,)."""
    grid = len(found.fitness) // len(began.pose), len(began.pose)
    return Rollouts(
        fitness=scored(task, found.fitness, found.survived, found.diverged).reshape(grid),
        survived=found.survived.reshape(grid),
        clipped=found.clipped.reshape(grid),
        task_state=task_state,
        engine=engine,
        behaviour=time_shares(found.counts, found.survived, found.diverged).reshape(*grid, -1),
        penalty=np.where(found.diverged, 0.0, found.penalty).reshape(grid),
        trajectories=trajectories(found.tape, found.survived, began.pose, task, system) if record else (),
    )


def scored(task: Task, fitness: Array, survived: IntArray, diverged: BoolArray) -> Array:
    """Return ``fitness`` (B,), where a trial that diverged is worth less than any that did not, but more the later."""
    return np.where(diverged, task.worst - 1.0 + survived / task.horizon, fitness)


def sampled(step: int) -> bool:
    """Whether the behaviour is looked at in this step: while a rollout runs, so that nothing has to be recorded."""
    return step % EVERY == 0


def behaviour_names(system: System) -> tuple[str, ...]:
    """Return what the descriptors of `Rollouts.behaviour` are called, two for each state and then each control."""
    channels = (*system.states, *system.controls)
    return tuple(f"{channel.name} {side}" for channel in channels for side in ("above", "below"))


def neutral_values(system: System) -> Array:
    """Return the neutral value of each state and then each control, (nx + nu,)."""
    return np.concatenate([system.neutral_state, system.neutral_control])


def above_and_below(states: Array, controls: Array, centre: Array) -> BoolArray:
    """Return whether each value of states (B, nx) and controls (B, nu) is above ``centre``, and below: (B, d)."""
    off = np.concatenate([states, controls], axis=1) - centre
    return np.stack([off > 0.0, off < 0.0], axis=2).reshape(len(off), -1)


def time_shares(counts: Array, survived: IntArray, diverged: BoolArray) -> Array:
    """Return the descriptors (B, d), shares in [0, 1], from the samples counted; 0 for a rollout that diverged."""
    samples = np.maximum(1, -(-survived // EVERY))[:, None]
    return np.where(diverged[:, None], 0.0, counts / samples)


def trajectories(
    tape: Sequence[Array], survived: IntArray, pose: Array, task: Task, system: System
) -> tuple[Trajectory, ...]:
    """Return what was recorded in ``tape`` (states, controls and poses, flat or not) of each rollout that took a step.

    What comes after the last step, and the pose before the first, may be anything: ``pose`` (E, n) is where trials
    begin.
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
        where = None
        if poses_of is not None:
            where = np.concatenate([pose[i % trials][None], poses_of[i, 1 : steps + 1].astype(np.float64)])
        name = f"candidate-{i // trials}-trial-{i % trials}"
        state, control = states[i, : steps + 1].astype(np.float64), controls[i, :steps].astype(np.float64)
        found.append(Trajectory(state, control, system.dt, where, name))
    return tuple(found)
