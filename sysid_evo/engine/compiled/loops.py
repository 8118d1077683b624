"""The loops over time as kernel functions: closed loop, trials under given controls, recorded windows, one step.

Kernels are passed as first-class functions, sizes as an integer array. Every loop works on blocks of 64 rollouts (or
windows), one for each lane. Sets of lanes are integers with one bit for each lane; -1 has all bits set.
"""

from __future__ import annotations

import math

from sysid_evo.kernels import (
    ADVANCE,
    CONTROLLER,
    DYNAMICS,
    INTEGER,
    INTEGERS,
    LANES,
    OBSERVE,
    QUARTER,
    Arrays,
    Layout,
    Signature,
    first_lane,
    lanes_at_most,
    lanes_differ,
    load,
    load_quarter,
    look_up,
    splat,
    store,
    view,
    where_bits,
    where_less,
)

SAMPLE_EVERY = 5
"""Steps between two samples of the behaviour. It is odd, so that both values of a control that alternates are seen."""

CLOSED = Layout(
    "trials", "horizon", "n_carry", "nx", "nu", "n_memory", "n_task", "n_noise", "n_theta", "rollouts", "record",
    "pose_row", "n_pose", "observed_at", "outside_at",
)  # fmt: skip
SHARED = Arrays(
    "noise_of", "dynamics_parameters", "controller_parameters", "task_parameters", "theta_of", "start", "task_start",
    "trial_data", "state_bounds", "actuation", "centre",
)  # fmt: skip
WORK = Arrays(
    "carry", "control", "noise", "memory", "observation", "raw", "before", "task", "theta", "snapshot", "sign_counts",
    "trial_index", "scratch", "controller_scratch",
)  # fmt: skip
RESULTS = Arrays("fitness", "final_task", "counts", "outside", "states", "controls", "poses")
OUTCOMES = Arrays("survived", "clipped", "diverged", kind=INTEGERS)


def closed_loop(dynamics, controller, observe, advance, sizes, shared, work, trials, results, outcomes, first, last):
    """Run blocks ``first`` to ``last`` of 64 rollouts; rollouts are ordered by candidate, then by trial."""
    horizon, nx, nu = sizes.horizon, sizes.nx, sizes.nu
    n_carry, n_task, n_noise = sizes.n_carry, sizes.n_task, sizes.n_noise
    n_trials, rollouts, n_theta = sizes.trials, sizes.rollouts, sizes.n_theta
    n_pose, pose_row = sizes.n_pose, sizes.pose_row
    for block in range(first, last):
        for lane in range(LANES):
            rollout = min(block * LANES + lane, rollouts - 1)
            trial = rollout % n_trials
            candidate = rollout // n_trials
            trials[lane] = trial
            work.trial_index[lane] = float(trial)
            for row in range(n_carry):
                work.carry[row * LANES + lane] = shared.start[trial * n_carry + row]
            for row in range(n_task):
                work.task[row * LANES + lane] = shared.task_start[trial * n_task + row]
            for row in range(n_theta):
                work.theta[row * LANES + lane] = shared.theta_of[candidate * n_theta + row]
        clear(work.memory, sizes.n_memory)
        clear(work.sign_counts, 2 * (nx + nu))
        used = min(LANES, rollouts - block * LANES)
        in_order = (block * LANES) % n_trials  # the lanes have consecutive trials, beginning with this one
        ended = ~lanes_differ(load(work.task, LANES), splat(0.0))  # lanes whose trial has ended
        diverged = 0  # lanes that diverged
        for k in range(horizon):
            if ended == -1:
                break
            observe(work.task, view(work.carry, sizes.observed_at * LANES), work.observation, shared.task_parameters)
            scratch = work.controller_scratch
            controller(work.theta, work.memory, work.observation, work.raw, shared.controller_parameters, scratch)
            actuate(work.raw, work.control, shared.actuation, nu)
            if k % SAMPLE_EVERY == 0:
                count_sides(work.carry, view(work.task, LANES), view(shared.centre, 0), nx, work.sign_counts)
                counts = view(work.sign_counts, 2 * nx * LANES)
                count_sides(work.control, view(work.task, LANES), view(shared.centre, nx), nu, counts)
            draw(shared.noise_of, k * n_noise, n_noise, n_trials, in_order, work.trial_index, work.noise)
            copy_rows(work.carry, work.before, nx)
            if ended != 0:
                copy_rows(work.carry, work.snapshot, n_carry)
                copy_rows(work.task, view(work.snapshot, n_carry * LANES), n_task)
            dynamics(work.carry, work.control, work.noise, shared.dynamics_parameters, work.scratch)
            suspicious = needs_care(work.carry, shared.state_bounds, n_carry, nx)
            if suspicious != 0:
                faulty = not_finite(work.carry, shared.state_bounds, n_carry, nx)
                newly_diverged, clipping = faulty & ~ended, suspicious & ~faulty & ~ended
                ended |= newly_diverged
                diverged |= newly_diverged
                clear_diverged(work.carry, work.snapshot, n_carry, work.task, n_task, newly_diverged, faulty & diverged)
                while newly_diverged != 0:
                    lane = first_lane(newly_diverged)
                    newly_diverged &= newly_diverged - 1
                    if lane < used:
                        outcomes.diverged[block * LANES + lane] = 1
                        outcomes.survived[block * LANES + lane] = k
                while clipping != 0:
                    lane = first_lane(clipping)
                    clipping &= clipping - 1
                    if lane < used:
                        outcomes.clipped[block * LANES + lane] += 1
                clip(work.carry, shared.state_bounds, nx)
            advance(work.task, work.before, work.carry, work.control, trials, shared.trial_data, shared.task_parameters)
            if ended != 0:
                undo_ended(work.carry, work.snapshot, n_carry, ended)
                undo_ended(work.task, view(work.snapshot, n_carry * LANES), n_task, ended)
            if sizes.record == 1:
                for lane in range(used):
                    rollout = block * LANES + lane
                    if (ended >> lane) & 1 == 0:
                        at = rollout * (horizon + 1) + k
                        for row in range(nx):
                            results.states[at * nx + row] = work.before[row * LANES + lane]
                            results.states[(at + 1) * nx + row] = work.carry[row * LANES + lane]
                        for row in range(nu):
                            results.controls[(rollout * horizon + k) * nu + row] = work.control[row * LANES + lane]
                        for row in range(n_pose):
                            results.poses[(at + 1) * n_pose + row] = work.task[(pose_row + row) * LANES + lane]
            newly_ended = ~lanes_differ(load(work.task, LANES), splat(0.0)) & ~ended
            ended |= newly_ended
            while newly_ended != 0:
                lane = first_lane(newly_ended)
                newly_ended &= newly_ended - 1
                if lane < used:
                    outcomes.survived[block * LANES + lane] = k + 1
        for lane in range(used):
            rollout = block * LANES + lane
            results.fitness[rollout] = work.task[lane]
            for row in range(n_task):
                results.final_task[rollout * n_task + row] = work.task[row * LANES + lane]
            for row in range(2 * (nx + nu)):
                results.counts[rollout * 2 * (nx + nu) + row] = work.sign_counts[row * LANES + lane]
            if sizes.outside_at >= 0:
                results.outside[rollout] = work.carry[sizes.outside_at * LANES + lane]
            if (ended >> lane) & 1 == 0:
                outcomes.survived[rollout] = horizon


CLOSED_LOOP = Signature.of(
    closed_loop,
    dynamics=DYNAMICS, controller=CONTROLLER, observe=OBSERVE, advance=ADVANCE,
    sizes=CLOSED, shared=SHARED, work=WORK, trials=INTEGERS, results=RESULTS, outcomes=OUTCOMES,
    first=INTEGER, last=INTEGER,
)  # fmt: skip
IMAGINED = Layout("trials", "n_data", "steps", "n_carry", "nx", "nu", "n_task", "rollouts")
IMAGINED_SHARED = Arrays(
    "dynamics_parameters", "task_parameters", "state_bounds", "start", "task_start", "trial_data", "controls"
)
IMAGINED_WORK = Arrays("carry", "control", "noise", "before", "task", "snapshot", "scratch")


def imagine(dynamics, advance, sizes, shared, work, trials, final_state, final_task, diverged_of):
    """Run blocks of 64 rollouts, ordered by sequence, then by trial, under ``controls`` (rollouts, steps, nu)."""
    steps, nx, nu, n_carry = sizes.steps, sizes.nx, sizes.nu, sizes.n_carry
    n_task, n_trials, rollouts = sizes.n_task, sizes.trials, sizes.rollouts
    for block in range((rollouts + LANES - 1) // LANES):
        for lane in range(LANES):
            trial = min(block * LANES + lane, rollouts - 1) % n_trials
            trials[lane] = trial % sizes.n_data
            for row in range(n_carry):
                work.carry[row * LANES + lane] = shared.start[trial * n_carry + row]
            for row in range(n_task):
                work.task[row * LANES + lane] = shared.task_start[trial * n_task + row]
        ended = ~lanes_differ(load(work.task, LANES), splat(0.0))  # lanes whose trial has ended
        diverged = 0  # lanes that diverged
        for k in range(steps):
            if ended == -1:
                break
            for lane in range(LANES):
                rollout = min(block * LANES + lane, rollouts - 1)
                given = view(shared.controls, (rollout * steps + k) * nu)
                for row in range(nu):
                    work.control[row * LANES + lane] = given[row]
            copy_rows(work.carry, work.before, nx)
            if ended != 0:
                copy_rows(work.carry, work.snapshot, n_carry)
                copy_rows(work.task, view(work.snapshot, n_carry * LANES), n_task)
            dynamics(work.carry, work.control, work.noise, shared.dynamics_parameters, work.scratch)
            suspicious = needs_care(work.carry, shared.state_bounds, n_carry, nx)
            if suspicious != 0:
                faulty = not_finite(work.carry, shared.state_bounds, n_carry, nx)
                newly_diverged = faulty & ~ended
                ended |= newly_diverged
                diverged |= newly_diverged
                clear_diverged(work.carry, work.snapshot, n_carry, work.task, n_task, newly_diverged, faulty & diverged)
                clip(work.carry, shared.state_bounds, nx)
            advance(work.task, work.before, work.carry, work.control, trials, shared.trial_data, shared.task_parameters)
            if ended != 0:
                undo_ended(work.carry, work.snapshot, n_carry, ended)
                undo_ended(work.task, view(work.snapshot, n_carry * LANES), n_task, ended)
            ended |= ~lanes_differ(load(work.task, LANES), splat(0.0))
        for lane in range(min(LANES, rollouts - block * LANES)):
            rollout = block * LANES + lane
            diverged_of[rollout] = (diverged >> lane) & 1
            for row in range(nx):
                final_state[rollout * nx + row] = work.carry[row * LANES + lane]
            for row in range(n_task):
                final_task[rollout * n_task + row] = work.task[row * LANES + lane]


IMAGINE = Signature.of(
    imagine,
    dynamics=DYNAMICS, advance=ADVANCE, sizes=IMAGINED, shared=IMAGINED_SHARED, work=IMAGINED_WORK, trials=INTEGERS,
    diverged_of=INTEGERS,
)  # fmt: skip

OPEN = Layout("windows", "steps", "n_carry", "nx", "nu", "n_parameters")
WINDOW = Arrays("carry", "control", "noise", "parameters", "scratch")
OPEN_SHARED = Arrays("parameters_of", "start", "controls", "truth", "weight")


def open_loop(dynamics, sizes, shared, work, first, last, error):
    """Simulate every window under recorded controls for candidates ``first`` to ``last``.

    The ``error`` of a candidate is the mean over windows and states of the squared difference after the last step times
    the state's ``weight``; it is not finite if a simulation diverged.
    """
    windows, steps, n_carry = sizes.windows, sizes.steps, sizes.n_carry
    nx, nu, n_parameters = sizes.nx, sizes.nu, sizes.n_parameters
    for candidate in range(first, last):
        for i in range(n_parameters):
            work.parameters[i] = shared.parameters_of[candidate * n_parameters + i]
        total = 0.0
        for block in range((windows + LANES - 1) // LANES):
            used = min(LANES, windows - block * LANES)
            for lane in range(LANES):
                window = min(block * LANES + lane, windows - 1)
                for row in range(n_carry):
                    work.carry[row * LANES + lane] = shared.start[window * n_carry + row]
            for k in range(steps):
                for lane in range(LANES):
                    window = min(block * LANES + lane, windows - 1)
                    for row in range(nu):
                        work.control[row * LANES + lane] = shared.controls[(window * steps + k) * nu + row]
                dynamics(work.carry, work.control, work.noise, work.parameters, work.scratch)
            for row in range(nx):
                for lane in range(used):
                    off = work.carry[row * LANES + lane] - shared.truth[(block * LANES + lane) * nx + row]
                    total += off * off * shared.weight[row]
        error[candidate] = total / float(windows * nx)


OPEN_LOOP = Signature.of(
    open_loop, dynamics=DYNAMICS, sizes=OPEN, shared=OPEN_SHARED, work=WINDOW, first=INTEGER, last=INTEGER
)
FREE_SHARED = Arrays("parameters_of", "start", "controls", "state_bounds")


def free_runs(dynamics, sizes, shared, work, first, last, states):
    """Simulate every window for candidates ``first`` to ``last``, each from its own carries; store all states.

    ``start`` is (candidates, windows, n_carry), ``states`` (candidates, windows, steps, nx), clipped to the
    state_bounds.
    """
    windows, steps, n_carry = sizes.windows, sizes.steps, sizes.n_carry
    nx, nu, n_parameters = sizes.nx, sizes.nu, sizes.n_parameters
    for candidate in range(first, last):
        for i in range(n_parameters):
            work.parameters[i] = shared.parameters_of[candidate * n_parameters + i]
        for block in range((windows + LANES - 1) // LANES):
            used = min(LANES, windows - block * LANES)
            for lane in range(LANES):
                window = min(block * LANES + lane, windows - 1)
                for row in range(n_carry):
                    work.carry[row * LANES + lane] = shared.start[(candidate * windows + window) * n_carry + row]
            for k in range(steps):
                for lane in range(LANES):
                    window = min(block * LANES + lane, windows - 1)
                    for row in range(nu):
                        work.control[row * LANES + lane] = shared.controls[(window * steps + k) * nu + row]
                dynamics(work.carry, work.control, work.noise, work.parameters, work.scratch)
                clip(work.carry, shared.state_bounds, nx)
                for lane in range(used):
                    at = ((candidate * windows + block * LANES + lane) * steps + k) * nx
                    for row in range(nx):
                        states[at + row] = work.carry[row * LANES + lane]


FREE_RUNS = Signature.of(
    free_runs, dynamics=DYNAMICS, sizes=OPEN, shared=FREE_SHARED, work=WINDOW, first=INTEGER, last=INTEGER
)


def one_step(dynamics, carry, control, noise, parameters, scratch):
    """Run one step of one block."""
    dynamics(carry, control, noise, parameters, scratch)


ONE_STEP = Signature.of(one_step, dynamics=DYNAMICS)


def actuate(raw, control, actuation, nu):
    """Convert controller outputs to legal controls, as `System.actuate`; see `actuation_table`."""
    width = int(actuation[0])
    for row in range(nu):
        at, value = 1 + row * width, load(raw, row * LANES)
        count = int(actuation[at])
        if count <= 0:
            low, value = actuation[at + 1], math.tanh(value) if count < 0 else value
            share = (min(max(value, -1.0), 1.0) + 1.0) * 0.5
            store(control, row * LANES, low + share * (actuation[at + 2] - low))
        else:
            chosen = splat(actuation[at + 3])
            for i in range(1, count):
                level, boundary = actuation[at + 2 + 2 * i], actuation[at + 3 + 2 * i]
                chosen = where_less(boundary, value, level, chosen)
            store(control, row * LANES, chosen)


def draw(noise_of, first, n_noise, n_trials, in_order, trial_index, noise):
    """Write the noise of a step for every lane, selected by ``trial_index``; see `noise_table`."""
    if n_trials <= QUARTER:
        drawn = view(noise_of, first * QUARTER)
        for lane in range(0, LANES, QUARTER):
            trial, target = load_quarter(trial_index, lane), view(noise, lane)
            for row in range(n_noise):
                store(target, row * LANES, look_up(load_quarter(drawn, row * QUARTER), trial))
    else:
        drawn = view(noise_of, first * (n_trials + LANES) + in_order)
        for row in range(n_noise):
            store(noise, row * LANES, load(drawn, row * (n_trials + LANES)))


def count_sides(values, alive, centre, rows, sign_counts):
    """Count, for each of ``rows`` values, the samples above and below its centre in trials that are alive."""
    counted = load(alive, 0)
    for row in range(rows):
        value, middle, above = load(values, row * LANES), centre[row], 2 * row * LANES
        store(sign_counts, above, load(sign_counts, above) + where_less(middle, value, counted, 0.0))
        store(sign_counts, above + LANES, load(sign_counts, above + LANES) + where_less(value, middle, counted, 0.0))


def needs_care(carry, state_bounds, n_carry, nx):
    """Return the lanes with a state outside the state bounds or a number that is not finite."""
    fine = -1
    for row in range(nx):
        value = load(carry, row * LANES)
        fine &= lanes_at_most(splat(state_bounds[row]), value) & lanes_at_most(value, splat(state_bounds[nx + row]))
    for row in range(nx, n_carry):
        fine &= lanes_at_most(abs(load(carry, row * LANES)), splat(state_bounds[2 * nx]))
    return ~fine


def not_finite(carry, state_bounds, n_carry, nx):
    """Return the lanes with a number that is not finite."""
    finite = -1
    for row in range(n_carry):
        finite &= lanes_at_most(abs(load(carry, row * LANES)), splat(state_bounds[2 * nx]))
    return ~finite


def clip(carry, state_bounds, nx):
    """Clip every state to the state bounds, see `bounds_table`."""
    for row in range(nx):
        store(carry, row * LANES, min(max(load(carry, row * LANES), state_bounds[row]), state_bounds[nx + row]))


def clear_diverged(carry, snapshot, n_carry, task, n_task, newly_diverged, diverged):
    """Write zeros into the carry of the ``diverged`` lanes; the ``newly_diverged`` lanes keep their task."""
    for row in range(n_carry):
        store(carry, row * LANES, where_bits(diverged, splat(0.0), load(carry, row * LANES)))
        store(snapshot, row * LANES, where_bits(diverged, splat(0.0), load(snapshot, row * LANES)))
    for row in range(n_carry, n_carry + n_task):
        current = load(task, (row - n_carry) * LANES)
        store(snapshot, row * LANES, where_bits(newly_diverged, current, load(snapshot, row * LANES)))


def undo_ended(array, snapshot, rows, ended):
    """Undo a step in the lanes whose trial has ended."""
    for row in range(rows):
        store(array, row * LANES, where_bits(ended, load(snapshot, row * LANES), load(array, row * LANES)))


def clear(array, rows):
    """Write zeros."""
    for row in range(rows):
        store(array, row * LANES, splat(0.0))


def copy_rows(source, target, rows):
    """Copy rows one by one, which needs no test whether the arrays overlap."""
    for row in range(rows):
        store(target, row * LANES, load(source, row * LANES))
