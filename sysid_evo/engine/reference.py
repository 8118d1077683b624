"""The reference form of the rollout: NumPy, any object that keeps the contracts, float64."""

from __future__ import annotations

from typing import Any

import numpy as np

from sysid_evo.carry import clip_state
from sysid_evo.controllers.controller import Controller, View
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.engine import results
from sysid_evo.models.dynamics import Dynamics
from sysid_evo.randomness import CONTROLLER_STREAM, step_noise, trial_draws
from sysid_evo.tasks.task import Task, TaskState
from sysid_evo.types import Array, Seeds

ENGINE = "reference"


def run(
    dynamics: Dynamics, controller: Controller, parameters: Array, task: Task, seeds: Seeds, *, record: bool
) -> dict[str, Any]:
    """Run bound ``controller`` and ``task``; return the fields of `Rollouts`."""
    system = dynamics.system
    candidates, trials = len(parameters), len(seeds)
    batch, grid = candidates * trials, (candidates, trials)
    noise = step_noise(seeds, task.horizon, dynamics.n_noise)
    disturbance = step_noise(seeds, task.horizon, controller.n_noise, CONTROLLER_STREAM)
    draws = np.tile(trial_draws(seeds, dynamics.n_draws), (candidates, 1))

    task_state = task.begin(seeds).tile(candidates)
    states = np.repeat(task_state.state[:, None], dynamics.n_lags + 1, axis=1)
    controls = np.tile(system.neutral_control, (batch, dynamics.n_lags, 1))
    carry = dynamics.start(states, controls, draws)
    memory = np.zeros((*grid, controller.n_memory))
    survived, clipped = np.zeros(batch, dtype=np.int64), np.zeros(batch, dtype=np.int64)
    diverged = np.zeros(batch, dtype=bool)
    counts, centre = np.zeros((batch, 2 * (system.nx + system.nu))), results.neutral(system)
    tape = _Tape(batch, task.horizon, system.nx, system.nu, task_state.pose) if record else None

    with np.errstate(all="ignore"):
        for k in range(task.horizon):
            alive = task_state.alive & ~diverged
            if not alive.any():
                break
            state = carry[:, : system.nx]
            seen = carry[:, dynamics.observed_at : dynamics.observed_at + system.nx]
            observation = task.observe(task_state, seen)
            drawn = np.broadcast_to(disturbance[:, k], (*grid, controller.n_noise)) if controller.n_noise else None
            view = View(observation.reshape(*grid, -1), seen.reshape(*grid, -1), task_state, drawn)
            raw, memory = controller.act(parameters, memory, view)
            control = system.actuate(raw.reshape(batch, system.nu))
            if k % results.EVERY == 0:
                counts += results.sides(state, control, centre) & alive[:, None]
            draw = np.tile(noise[:, k], (candidates, 1)) if dynamics.n_noise else None
            stepped = dynamics.step(carry, control, draw)
            going = alive
            if not np.isfinite(stepped).all():
                diverged |= alive & ~np.isfinite(stepped).all(axis=1)
                going = alive & ~diverged
            stepped, touched = clip_state(stepped, dynamics.envelope)
            reached = stepped[:, : system.nx]
            advanced, after = task.advance(task_state, state, reached, control=control)
            if after is not reached:
                stepped = np.concatenate([after, stepped[:, system.nx :]], axis=1)
            if going.all():
                carry, task_state = stepped, advanced
            else:
                carry = np.where(going[:, None], stepped, carry)
                task_state = task_state.keep(advanced, going)
            survived += going
            clipped += touched & going
            if tape is not None:
                tape.write(k, state, control, going, carry[:, : system.nx], task_state)
        fitness = task.fitness(task_state)

    doubt = np.zeros(batch) if dynamics.doubt_at is None else np.where(diverged, 0.0, carry[:, dynamics.doubt_at])
    fitness = np.where(diverged, task.worst - 1.0 + survived / task.horizon, fitness)
    return {
        "fitness": fitness.reshape(grid),
        "survived": survived.reshape(grid),
        "clipped": clipped.reshape(grid),
        "behaviour": results.shares(counts, survived, diverged).reshape(*grid, -1),
        "doubt": doubt.reshape(grid),
        "task_state": task_state,
        "engine": ENGINE,
        "trajectories": () if tape is None else tape.trajectories(survived, system.dt, grid),
    }


class _Tape:
    """Records states, controls and poses of every rollout while it runs."""

    def __init__(self, batch: int, horizon: int, nx: int, nu: int, pose: Array) -> None:
        self.states = np.zeros((batch, horizon + 1, nx))
        self.controls = np.zeros((batch, horizon, nu))
        self.poses = np.zeros((batch, horizon + 1, pose.shape[1]))
        self.poses[:, 0] = pose

    def write(self, k: int, state: Array, control: Array, going: Any, after: Array, task_state: TaskState) -> None:
        self.states[going, k] = state[going]
        self.controls[going, k] = control[going]
        self.states[going, k + 1] = after[going]
        self.poses[going, k + 1] = task_state.pose[going]

    def trajectories(self, survived: Any, dt: float, grid: tuple[int, int]) -> tuple[Trajectory, ...]:
        return tuple(
            Trajectory(
                self.states[i, : steps + 1],
                self.controls[i, :steps],
                dt,
                self.poses[i, : steps + 1] if self.poses.shape[2] else None,
                f"candidate-{i // grid[1]}-trial-{i % grid[1]}",
            )
            for i, steps in enumerate(survived)
            if steps > 0
        )
