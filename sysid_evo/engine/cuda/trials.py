"""What rollouts on a device are given: trials, drawn as everywhere from their seeds, and the sizes of all arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid_evo.arrays import Array, Seeds
from sysid_evo.controllers.controller import Controller
from sysid_evo.dynamics import Dynamics
from sysid_evo.engine import behaviour
from sysid_evo.engine.compiled.dialect import Precision
from sysid_evo.engine.compiled.run import Kernels
from sysid_evo.engine.compiled.tables import actuation_table, envelope_table
from sysid_evo.randomness import step_noise, trial_draws
from sysid_evo.tasks.task import Task, TaskState

WHOLE = ("survived", "clipped", "diverged")
"""The results that are whole numbers."""


@dataclass(frozen=True)
class Given:
    """What does not depend on the candidates.

    ``arrays`` are sent to the device, ``sizes`` are those that its program knows when it is compiled, ``room`` how
    many numbers a rollout has of its own, ``results`` how many it gives; ``began`` are the E ``trials`` at rest.
    """

    arrays: dict[str, Array]
    sizes: dict[str, int]
    room: dict[str, int]
    results: dict[str, int]
    began: TaskState
    trials: int


def prepare(
    kernels: Kernels,
    dynamics: Dynamics,
    controller: Controller,
    task: Task,
    seeds: Seeds,
    precision: Precision,
    *,
    record: bool,
) -> Given:
    """Return what rollouts of bound ``controller`` and ``task`` in these trials are given."""
    system, trials = dynamics.system, len(seeds)
    began = task.begin(seeds)
    states = np.repeat(began.state[:, None], dynamics.n_lags + 1, axis=1)
    past = np.tile(system.neutral_control, (trials, dynamics.n_lags, 1))
    carry = dynamics.start(states, past, trial_draws(seeds, dynamics.n_draws))
    rows = kernels.task.rows(began)
    arrays = {
        "dynamics_parameters": kernels.dynamics.parameters,
        "controller_parameters": kernels.controller.parameters,
        "task_parameters": kernels.task.parameters,
        "start": carry,
        "task_start": rows.T,
        "trial_data": kernels.task.trial_data(began),
        "noise_of": step_noise(seeds, task.horizon, dynamics.n_noise).transpose(1, 2, 0),
        "envelope": envelope_table(dynamics.envelope, system.nx, precision),
        "actuation": actuation_table(system, precision, before_tanh=kernels.controller.before_tanh),
        "centre": behaviour.neutral(system),
    }
    sizes = {
        "N_CARRY": carry.shape[1],
        "NX": system.nx,
        "NU": system.nu,
        "N_MEMORY": controller.n_memory,
        "N_TASK": len(rows),
        "N_NOISE": dynamics.n_noise,
        "N_THETA": controller.n_parameters,
        "SEEN": dynamics.observed_at,
        "DOUBT_AT": -1 if dynamics.doubt_at is None else dynamics.doubt_at,
        "RECORD": int(record),
        "POSE_ROW": kernels.task.pose_row,
        "N_POSE": kernels.task.n_pose,
    }
    room = {
        "carry": carry.shape[1],
        "control": system.nu,
        "noise": dynamics.n_noise,
        "memory": controller.n_memory,
        "observation": len(task.observations),
        "raw": system.nu,
        "before": system.nx,
        "task": len(rows),
        "tally": 2 * (system.nx + system.nu),
        "scratch": kernels.dynamics.n_scratch,
        "controller_scratch": kernels.controller.n_scratch,
    }
    samples = task.horizon + 1 if record else 0
    results = {
        "fitness": 1,
        "survived": 1,
        "clipped": 1,
        "diverged": 1,
        "final_task": len(rows),
        "counts": 2 * (system.nx + system.nu),
        "doubts": 1,
        "states": samples * system.nx,
        "controls": task.horizon * system.nu if record else 0,
        "poses": samples * kernels.task.n_pose,
    }
    return Given(arrays, sizes, room, results, began, trials)
