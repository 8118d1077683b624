"""The reference form of the rollout: NumPy in float64, for any object that follows the contracts."""

from __future__ import annotations

import numpy as np

from sysid_evo.carry import clip_state
from sysid_evo.controllers.controller import Controller, View
from sysid_evo.engine.compiled.closed_loop import LoopResults
from sysid_evo.engine.results import Rollouts, above_and_below, finished, neutral_values, sampled
from sysid_evo.models.dynamics import Dynamics, started
from sysid_evo.processors import one_blas_thread
from sysid_evo.randomness import CONTROLLER_STREAM, draw_for_steps, draw_for_trials
from sysid_evo.tasks.task import Task
from sysid_evo.types import Array, Seeds

ENGINE = "reference"


@one_blas_thread()
def run(
    dynamics: Dynamics, controller: Controller, parameters: Array, task: Task, seeds: Seeds, *, record: bool
) -> Rollouts:
    """Return the rollouts of the bound ``controller`` and ``task``, see `sysid_evo.engine.rollout.rollout`."""
    system = dynamics.system
    candidates, trials = len(parameters), len(seeds)
    batch, grid = candidates * trials, (candidates, trials)
    noise = draw_for_steps(seeds, task.horizon, dynamics.n_noise)
    disturbance = draw_for_steps(seeds, task.horizon, controller.n_noise, CONTROLLER_STREAM)
    draws = np.tile(draw_for_trials(seeds, dynamics.n_draws), (candidates, 1))

    start = task.begin(seeds)
    task_state = start.tile(candidates)
    carry = started(dynamics, task_state.state, draws)
    memory = np.zeros((*grid, controller.n_memory))
    survived, clipped = np.zeros(batch, dtype=np.int64), np.zeros(batch, dtype=np.int64)
    diverged = np.zeros(batch, dtype=bool)
    counts, centre = np.zeros((batch, 2 * (system.nx + system.nu))), neutral_values(system)
    n_recorded = batch if record else 0
    recorded_states = np.zeros((n_recorded, task.horizon + 1, system.nx))
    recorded_controls = np.zeros((n_recorded, task.horizon, system.nu))
    recorded_poses = np.zeros((n_recorded, task.horizon + 1, start.pose.shape[1]))

    with np.errstate(all="ignore"):
        for k in range(task.horizon):
            alive = task_state.alive & ~diverged
            if not alive.any():
                break
            state = carry[:, : system.nx]
            observed = carry[:, dynamics.observed_at : dynamics.observed_at + system.nx]
            observation = task.observe(task_state, observed)
            drawn = np.broadcast_to(disturbance[:, k], (*grid, controller.n_noise)) if controller.n_noise else None
            view = View(observation.reshape(*grid, -1), observed.reshape(*grid, -1), task_state, drawn)
            raw, memory = controller.act(parameters, memory, view)
            control = system.actuate(raw.reshape(batch, system.nu))
            if sampled(k):
                counts += above_and_below(state, control, centre) & alive[:, None]
            draw = np.tile(noise[:, k], (candidates, 1)) if dynamics.n_noise else None
            stepped = dynamics.step(carry, control, draw)
            active = alive
            if not np.isfinite(stepped).all():
                diverged |= alive & ~np.isfinite(stepped).all(axis=1)
                active = alive & ~diverged
            stepped, was_clipped = clip_state(stepped, dynamics.state_bounds)
            reached = stepped[:, : system.nx]
            advanced, after = task.advance(task_state, state, reached, control=control)
            if after is not reached:
                stepped = np.concatenate([after, stepped[:, system.nx :]], axis=1)
            if active.all():
                carry, task_state = stepped, advanced
            else:
                carry = np.where(active[:, None], stepped, carry)
                task_state = task_state.updated_where(advanced, active)
            survived += active
            clipped += was_clipped & active
            if record:
                recorded_states[active, k], recorded_states[active, k + 1] = state[active], carry[active, : system.nx]
                recorded_controls[active, k], recorded_poses[active, k + 1] = control[active], task_state.pose[active]
        fitness = task.fitness(task_state)

    outside = np.zeros(batch) if dynamics.outside_at is None else carry[:, dynamics.outside_at]
    tape = (recorded_states, recorded_controls, recorded_poses)
    found = LoopResults(fitness, survived, clipped, diverged, counts, outside, tape)
    return finished(found, task, system, start, task_state, ENGINE, record)
