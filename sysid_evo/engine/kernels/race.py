"""Two bodies over lanes, see `sysid_evo.rivals`: their dynamics, their controllers, and the race itself."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.engine.compiled.dialect import KernelSource
from sysid_evo.engine.compiled.kernel import ControllerKernel, DynamicsKernel, TaskKernel
from sysid_evo.engine.compiled.lanes import LANES, view
from sysid_evo.engine.compiled.layout import CACHE_LINE, Layout, padded
from sysid_evo.engine.kernels.networks import squash
from sysid_evo.engine.kernels.stepping import copy
from sysid_evo.engine.kernels.walled_track import HEAD as SINGLE
from sysid_evo.engine.kernels.walled_track import ROWS as TRACK
from sysid_evo.engine.kernels.walled_track import walled_track_kernel
from sysid_evo.rivals.race import DECIDED, KEPT_IN_TOUCH, Race, RaceState
from sysid_evo.tasks.duel import Duel
from sysid_evo.tasks.task import TaskState
from sysid_evo.tasks.track import NUMBERS
from sysid_evo.tasks.walled_track import WalledTrackState

if TYPE_CHECKING:
    from sysid_evo.controllers.controller import Controller

BODIES = Layout("nx", "nu", "n_carry", "n_noise", align=CACHE_LINE)
DRIVERS = Layout("n_theta", "n_memory", "n_seen", "nu", "second", "first_before", "second_before", align=CACHE_LINE)
RACE = Layout("nx", "n_seen", "touch", align=CACHE_LINE)
TASK = Layout("fitness", "alive", "contacts", "own")
OWN = TRACK.track + NUMBERS
"""Rows of one of the two."""


def bodies_kernel(inner: DynamicsKernel, nx: int, nu: int, n_carry: int, n_noise: int) -> DynamicsKernel:
    """Return the kernel of `TwoBodies` of ``inner``."""
    parameters = BODIES.pack(inner.parameters, nx=nx, nu=nu, n_carry=n_carry, n_noise=n_noise)
    source = KernelSource(step_both, {"one": inner.source})
    return DynamicsKernel(source, parameters, n_carry + inner.n_scratch, inner.precision)


def step_both(carry, control, noise, parameters, scratch):
    """Step each of two bodies: its carry is put together, and put back."""
    nx, nu, n_noise = int(parameters[BODIES.nx]), int(parameters[BODIES.nu]), int(parameters[BODIES.n_noise])
    n_carry = int(parameters[BODIES.n_carry])
    rest = n_carry - nx
    for body in range(2):
        state, others = view(carry, body * nx * LANES), view(carry, (2 * nx + body * rest) * LANES)
        copy(state, scratch, nx * LANES)
        copy(others, view(scratch, nx * LANES), rest * LANES)
        one(
            scratch,
            view(control, body * nu * LANES),
            view(noise, body * n_noise * LANES),
            view(parameters, BODIES.size),
            view(scratch, n_carry * LANES),
        )
        copy(scratch, state, nx * LANES)
        copy(view(scratch, nx * LANES), others, rest * LANES)


def drivers_kernel(
    first: ControllerKernel, second: ControllerKernel, law: Controller, n_seen: int, nu: int
) -> ControllerKernel:
    """Return the kernel of `TwoDrivers`, of which the first is ``law``; each is shown ``n_seen`` observations."""
    own = padded(first.parameters)
    parameters = DRIVERS.pack(
        own,
        second.parameters,
        n_theta=law.n_parameters,
        n_memory=law.n_memory,
        n_seen=n_seen,
        nu=nu,
        second=DRIVERS.size + len(own),
        first_before=first.before_tanh,
        second_before=second.before_tanh,
    )
    source = KernelSource(act_both, {"first": first.source, "second": second.source})
    return ControllerKernel(source, parameters, max(first.n_scratch, second.n_scratch))


def act_both(theta, memory, observation, raw, parameters, scratch):
    """Let the first act for the first body, the second for the second."""
    size = int(parameters[DRIVERS.nu]) * LANES
    first(theta, memory, observation, raw, view(parameters, DRIVERS.size), scratch)
    if parameters[DRIVERS.first_before] > 0.0:
        squash(raw, size)
    second(
        view(theta, int(parameters[DRIVERS.n_theta]) * LANES),
        view(memory, int(parameters[DRIVERS.n_memory]) * LANES),
        view(observation, int(parameters[DRIVERS.n_seen]) * LANES),
        view(raw, size),
        view(parameters, int(parameters[DRIVERS.second])),
        scratch,
    )
    if parameters[DRIVERS.second_before] > 0.0:
        squash(view(raw, size), size)


def duel_kernel(task: Duel) -> TaskKernel | None:
    """Return the compiled form of a bound duel of one body alone; None if its motion has none."""
    kernel = walled_track_kernel(task)
    if kernel is None:
        return None
    return replace(kernel, observe=KernelSource(observe_alone, {"see": kernel.observe}))


def observe_alone(task, state, observation, parameters):
    """What is seen of the track, and nobody else."""
    see(task, state, observation, parameters)
    ahead = view(observation, (3 + int(parameters[SINGLE.rays])) * LANES)
    reach = parameters[SINGLE.reach]
    for lane in range(LANES):
        ahead[lane] = reach
        ahead[LANES + lane] = 0.0


def race_kernel(task: Race) -> TaskKernel | None:
    """Return the compiled form of a bound race; None if its motion has none."""
    alone = walled_track_kernel(task.alone)
    if alone is None:
        return None
    parameters = RACE.pack(
        alone.parameters,
        nx=task.alone.system.nx,
        n_seen=len(task.alone.observations),
        touch=(2.0 * task.duel.body) ** 2,
    )
    return TaskKernel(
        observe=KernelSource(observe_both, {"see": alone.observe}),
        advance=KernelSource(advance_both, {"go": alone.advance}),
        n_rows=TASK.own + 2 * OWN,
        rows=lambda task_state: _rows(alone, task_state),
        trial_data=lambda task_state: np.zeros((len(task_state.alive), 1)),
        state=lambda task_state, rows: _state(alone, task_state, rows),
        parameters=parameters,
        pose_row=TASK.own + TRACK.x,
        n_pose=task.system.n_pose,
    )


def _rows(alone: TaskKernel, task_state: TaskState) -> Array:
    here = cast("RaceState", task_state)
    head = np.stack([here.own.furthest - here.rival.furthest, here.alive, here.contacts])
    return np.concatenate([head, alone.rows(here.own), alone.rows(here.rival)])


def _state(alone: TaskKernel, task_state: TaskState, rows: Array) -> TaskState:
    here = cast("RaceState", task_state)
    own, rival = (alone.state(one, rows[TASK.own + i * OWN :]) for i, one in enumerate((here.own, here.rival)))
    contacts = rows[TASK.contacts].astype(np.int64)
    return here.of(cast("WalledTrackState", own), cast("WalledTrackState", rival), contacts)


def observe_both(task, state, observation, parameters):
    """Show each body the track, and where the other is."""
    nx, seen = int(parameters[RACE.nx]), int(parameters[RACE.n_seen])
    single = view(parameters, RACE.size)
    reach = single[SINGLE.reach]
    for body in range(2):
        mine, other = view(task, (TASK.own + body * OWN) * LANES), view(task, (TASK.own + (1 - body) * OWN) * LANES)
        shown = view(observation, body * seen * LANES)
        see(mine, view(state, body * nx * LANES), shown, single)
        ahead, left = view(shown, (seen - 2) * LANES), view(shown, (seen - 1) * LANES)
        for lane in range(LANES):
            heading = mine[TRACK.heading * LANES + lane]
            dx = other[TRACK.x * LANES + lane] - mine[TRACK.x * LANES + lane]
            dy = other[TRACK.y * LANES + lane] - mine[TRACK.y * LANES + lane]
            c, s = math.cos(heading), math.sin(heading)
            ahead[lane] = min(max(c * dx + s * dy, -reach), reach)
            left[lane] = min(max(c * dy - s * dx, -reach), reach)


def advance_both(task, before, after, control, trials, trial_data, parameters):
    """Let both go on, slow them where they touch, and measure the lead."""
    nx, single = int(parameters[RACE.nx]), view(parameters, RACE.size)
    for body in range(2):
        mine, at = view(task, (TASK.own + body * OWN) * LANES), body * nx * LANES
        go(mine, view(before, at), view(after, at), control, trials, trial_data, single)
    own, rival = view(task, TASK.own * LANES), view(task, (TASK.own + OWN) * LANES)
    lateral = int(single[SINGLE.lateral])
    forward, sideways = int(single[SINGLE.forward]) * LANES, max(lateral, 0) * LANES
    second = nx * LANES
    for lane in range(LANES):
        dx = own[TRACK.x * LANES + lane] - rival[TRACK.x * LANES + lane]
        dy = own[TRACK.y * LANES + lane] - rival[TRACK.y * LANES + lane]
        touching = 1.0 if dx * dx + dy * dy < parameters[RACE.touch] else 0.0
        kept = KEPT_IN_TOUCH if touching > 0.0 else 1.0
        kept_aside = kept if lateral >= 0 else 1.0
        after[forward + lane] *= kept
        after[second + forward + lane] *= kept
        after[sideways + lane] *= kept_aside
        after[second + sideways + lane] *= kept_aside
        task[TASK.contacts * LANES + lane] += touching
        task[lane] = min(max(own[lane] - rival[lane], -DECIDED), DECIDED)
