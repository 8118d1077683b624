"""The loops over time, as kernel functions: closed loop with a controller, imagined trials, open loop over windows.

They know nothing about cars: kernels come as first-class functions, sizes in an integer array.
"""

from __future__ import annotations

from sysid_evo.engine.behaviour import EVERY
from sysid_evo.engine.compiled.kernel import ADVANCE, CONTROLLER, DYNAMICS, OBSERVE
from sysid_evo.engine.compiled.lanes import LANES, view
from sysid_evo.engine.compiled.layout import Layout
from sysid_evo.engine.compiled.signature import NUMBER, WHOLES, Signature

CLOSED = Layout(
    "trials", "horizon", "n_carry", "nx", "nu", "n_memory", "n_task", "n_noise", "n_theta", "rollouts", "record",
    "pose_row", "n_pose", "seen", "doubt_at",
)  # fmt: skip
OPEN = Layout("windows", "steps", "n_carry", "nx", "nu", "n_parameters")
IMAGINED = Layout("trials", "of_data", "steps", "n_carry", "nx", "nu", "n_task", "rollouts")
MIXED = Layout("trials", "nx", "nu", "n_memory", "n_task", "n_theta", "rollouts")


def closed_loop(
    dynamics, controller, observe, advance, sizes,
    dynamics_parameters, controller_parameters, task_parameters,
    theta_of, start, task_start, trial_data, noise_of, envelope, actuation, centre, first, last,
    carry, control, noise, memory, observation, raw, before, task, theta, kept, tally, scratch, controller_scratch,
    trials, dead,
    fitness, survived, clipped, diverged, final_task, counts, doubts, states, controls, poses,
):  # fmt: skip
    """Run blocks ``first`` to ``last`` of 64 rollouts each; candidate first, trial second."""
    horizon, nx, nu = sizes[CLOSED.horizon], sizes[CLOSED.nx], sizes[CLOSED.nu]
    n_carry, n_task, n_noise = sizes[CLOSED.n_carry], sizes[CLOSED.n_task], sizes[CLOSED.n_noise]
    n_trials, rollouts, n_theta = sizes[CLOSED.trials], sizes[CLOSED.rollouts], sizes[CLOSED.n_theta]
    n_pose, pose_row = sizes[CLOSED.n_pose], sizes[CLOSED.pose_row]
    for block in range(first, last):
        for lane in range(LANES):
            rollout = min(block * LANES + lane, rollouts - 1)
            trial = rollout % n_trials
            candidate = rollout // n_trials
            trials[lane] = trial
            dead[lane] = 0
            for row in range(n_carry):
                carry[row * LANES + lane] = start[trial * n_carry + row]
            for row in range(n_task):
                task[row * LANES + lane] = task_start[trial * n_task + row]
            for row in range(n_theta):
                theta[row * LANES + lane] = theta_of[candidate * n_theta + row]
        for i in range(sizes[CLOSED.n_memory] * LANES):
            memory[i] = 0.0
        for i in range(2 * (nx + nu) * LANES):
            tally[i] = 0.0
        n_dead, marks = 0, observation  # observed anew before it is read
        for lane in range(LANES):
            if task[LANES + lane] == 0.0:
                dead[lane] = 1
                n_dead += 1
        for k in range(horizon):
            if n_dead == LANES:
                break
            observe(task, view(carry, sizes[CLOSED.seen] * LANES), observation, task_parameters)
            controller(theta, memory, observation, raw, controller_parameters, controller_scratch)
            actuate(raw, control, actuation, nu)
            if k % EVERY == 0:
                count_sides(carry, view(task, LANES), view(centre, 0), nx, tally)
                count_sides(control, view(task, LANES), view(centre, nx), nu, view(tally, 2 * nx * LANES))
            if n_noise > 0:
                for lane in range(LANES):
                    drawn, column = view(noise_of, (trials[lane] * horizon + k) * n_noise), view(noise, lane)
                    for row in range(n_noise):
                        column[row * LANES] = drawn[row]
            for i in range(nx * LANES):
                before[i] = carry[i]
            if n_dead > 0:
                keep(carry, n_carry, task, n_task, kept)
            dynamics(carry, control, noise, dynamics_parameters, scratch)
            if suspicious(carry, envelope, n_carry, nx, marks) > 0:
                for lane in range(LANES):
                    if marks[lane] != marks[lane]:
                        rollout = block * LANES + lane
                        if dead[lane] == 0:
                            dead[lane] = 2
                            n_dead += 1
                            for row in range(n_task):
                                kept[(n_carry + row) * LANES + lane] = task[row * LANES + lane]
                            if rollout < rollouts:
                                diverged[rollout] = 1
                                survived[rollout] = k
                        if dead[lane] == 2:
                            for row in range(n_carry):
                                carry[row * LANES + lane] = 0.0
                                kept[row * LANES + lane] = 0.0
                clip(carry, envelope, nx)
                touched = view(clipped, block * LANES)
                for lane in range(min(LANES, rollouts - block * LANES)):
                    touched[lane] += 1 if (marks[lane] > 0.0) & (dead[lane] == 0) else 0
            advance(task, before, carry, control, trials, trial_data, task_parameters)
            if n_dead > 0:
                restore(carry, n_carry, task, n_task, kept, dead)
            if sizes[CLOSED.record] == 1:
                for lane in range(LANES):
                    rollout = block * LANES + lane
                    if dead[lane] == 0 and rollout < rollouts:
                        at = rollout * (horizon + 1) + k
                        for row in range(nx):
                            states[at * nx + row] = before[row * LANES + lane]
                            states[(at + 1) * nx + row] = carry[row * LANES + lane]
                        for row in range(nu):
                            controls[(rollout * horizon + k) * nu + row] = control[row * LANES + lane]
                        for row in range(n_pose):
                            poses[(at + 1) * n_pose + row] = task[(pose_row + row) * LANES + lane]
            ended = 0
            for lane in range(LANES):
                ended += 1 if task[LANES + lane] == 0.0 else 0
            if ended > 0:
                for lane in range(LANES):
                    if dead[lane] == 0 and task[LANES + lane] == 0.0:
                        dead[lane] = 1
                        n_dead += 1
                        if block * LANES + lane < rollouts:
                            survived[block * LANES + lane] = k + 1
        for lane in range(LANES):
            rollout = block * LANES + lane
            if rollout < rollouts:
                fitness[rollout] = task[lane]
                for row in range(n_task):
                    final_task[rollout * n_task + row] = task[row * LANES + lane]
                for row in range(2 * (nx + nu)):
                    counts[rollout * 2 * (nx + nu) + row] = tally[row * LANES + lane]
                if sizes[CLOSED.doubt_at] >= 0:
                    doubts[rollout] = carry[sizes[CLOSED.doubt_at] * LANES + lane]
                if dead[lane] == 0:
                    survived[rollout] = horizon


def count_sides(values, alive, centre, rows, tally):
    """Count where each of ``rows`` values is above its centre, and where below, in the trials that are alive."""
    for row in range(rows):
        value, middle = view(values, row * LANES), centre[row]
        above, below = view(tally, 2 * row * LANES), view(tally, (2 * row + 1) * LANES)
        for lane in range(LANES):
            above[lane] += alive[lane] if value[lane] > middle else 0.0
            below[lane] += alive[lane] if value[lane] < middle else 0.0


def suspicious(carry, envelope, n_carry, nx, marks):
    """Count the lanes that need care; their mark is above 0 outside the envelope, nan if not finite."""
    for lane in range(LANES):
        marks[lane] = 0.0
    for row in range(nx):
        low, high = envelope[row], envelope[nx + row]
        for lane in range(LANES):
            value = carry[row * LANES + lane]
            inside = (value >= low) & (value <= high)
            marks[lane] += (value - value) + (0.0 if inside else 1.0)
    for row in range(nx, n_carry):
        for lane in range(LANES):
            value = carry[row * LANES + lane]
            marks[lane] += value - value
    count = 0
    for lane in range(LANES):
        count += 1 if marks[lane] != 0.0 else 0
    return count


def clip(carry, envelope, nx):
    """Clip every state to the envelope (low, then high of each state)."""
    for row in range(nx):
        low, high, value = envelope[row], envelope[nx + row], view(carry, row * LANES)
        for lane in range(LANES):
            value[lane] = min(max(value[lane], low), high)


def actuate(raw, control, actuation, nu):
    """Controller outputs to legal controls, as `System.actuate`; see `actuation_table`."""
    width = int(actuation[0])
    for row in range(nu):
        at = 1 + row * width
        count = int(actuation[at])
        if count == 0:
            low = actuation[at + 1]
            span = actuation[at + 2] - low
            for lane in range(LANES):
                share = (min(max(raw[row * LANES + lane], -1.0), 1.0) + 1.0) * 0.5
                control[row * LANES + lane] = low + share * span
        else:
            for lane in range(LANES):
                control[row * LANES + lane] = actuation[at + 3]
            for i in range(1, count):
                boundary = actuation[at + 3 + 2 * i]
                level = actuation[at + 2 + 2 * i]
                if boundary < 0.0:
                    for lane in range(LANES):
                        hit = raw[row * LANES + lane] >= boundary
                        control[row * LANES + lane] = level if hit else control[row * LANES + lane]
                else:
                    for lane in range(LANES):
                        hit = raw[row * LANES + lane] > boundary
                        control[row * LANES + lane] = level if hit else control[row * LANES + lane]


def keep(carry, n_carry, task, n_task, kept):
    """Copy carry and task, so that lanes whose trial is over can be put back."""
    for i in range(n_carry * LANES):
        kept[i] = carry[i]
    for i in range(n_task * LANES):
        kept[n_carry * LANES + i] = task[i]


def restore(carry, n_carry, task, n_task, kept, dead):
    """Undo the step of the lanes whose trial is over."""
    for lane in range(LANES):
        if dead[lane] != 0:
            for row in range(n_carry):
                carry[row * LANES + lane] = kept[row * LANES + lane]
            for row in range(n_task):
                task[row * LANES + lane] = kept[(n_carry + row) * LANES + lane]


def open_loop(
    dynamics, sizes, parameters_of, start, controls, truth, first, last,
    weight, carry, control, noise, parameters, scratch, error,
):  # fmt: skip
    """Simulate every window under recorded controls for candidates ``first`` to ``last``.

    ``error`` of a candidate is the mean over windows and states of the square difference
    after the last step times the state's ``weight``; not a number where a simulation diverged.
    """
    windows, steps, n_carry = sizes[OPEN.windows], sizes[OPEN.steps], sizes[OPEN.n_carry]
    nx, nu, n_parameters = sizes[OPEN.nx], sizes[OPEN.nu], sizes[OPEN.n_parameters]
    for candidate in range(first, last):
        for i in range(n_parameters):
            parameters[i] = parameters_of[candidate * n_parameters + i]
        total = 0.0
        for block in range((windows + LANES - 1) // LANES):
            used = min(LANES, windows - block * LANES)
            for lane in range(LANES):
                window = min(block * LANES + lane, windows - 1)
                for row in range(n_carry):
                    carry[row * LANES + lane] = start[window * n_carry + row]
            for k in range(steps):
                for lane in range(LANES):
                    window = min(block * LANES + lane, windows - 1)
                    for row in range(nu):
                        control[row * LANES + lane] = controls[(window * steps + k) * nu + row]
                dynamics(carry, control, noise, parameters, scratch)
            for row in range(nx):
                for lane in range(used):
                    off = carry[row * LANES + lane] - truth[(block * LANES + lane) * nx + row]
                    total += off * off * weight[row]
        error[candidate] = total / float(windows * nx)


def imagine(
    dynamics, advance, sizes, dynamics_parameters, task_parameters,
    start, task_start, trial_data, controls, envelope,
    carry, control, noise, before, task, kept, marks, scratch, trials, dead,
    lost, final_state, final_task,
):  # fmt: skip
    """Run blocks of 64 rollouts each, sequence first, trial second, under ``controls`` (rollouts, steps, nu)."""
    steps, nx, nu, n_carry = sizes[IMAGINED.steps], sizes[IMAGINED.nx], sizes[IMAGINED.nu], sizes[IMAGINED.n_carry]
    n_task, n_trials, rollouts = sizes[IMAGINED.n_task], sizes[IMAGINED.trials], sizes[IMAGINED.rollouts]
    for block in range((rollouts + LANES - 1) // LANES):
        n_dead = 0
        for lane in range(LANES):
            trial = min(block * LANES + lane, rollouts - 1) % n_trials
            trials[lane] = trial % sizes[IMAGINED.of_data]
            for row in range(n_carry):
                carry[row * LANES + lane] = start[trial * n_carry + row]
            for row in range(n_task):
                task[row * LANES + lane] = task_start[trial * n_task + row]
            dead[lane] = 1 if task[LANES + lane] == 0.0 else 0
            n_dead += dead[lane]
        for k in range(steps):
            if n_dead == LANES:
                break
            for lane in range(LANES):
                rollout = min(block * LANES + lane, rollouts - 1)
                given = view(controls, (rollout * steps + k) * nu)
                for row in range(nu):
                    control[row * LANES + lane] = given[row]
            for i in range(nx * LANES):
                before[i] = carry[i]
            if n_dead > 0:
                keep(carry, n_carry, task, n_task, kept)
            dynamics(carry, control, noise, dynamics_parameters, scratch)
            if suspicious(carry, envelope, n_carry, nx, marks) > 0:
                for lane in range(LANES):
                    if marks[lane] != marks[lane]:
                        if dead[lane] == 0:
                            dead[lane] = 2
                            n_dead += 1
                            for row in range(n_task):
                                kept[(n_carry + row) * LANES + lane] = task[row * LANES + lane]
                        if dead[lane] == 2:
                            for row in range(n_carry):
                                carry[row * LANES + lane] = 0.0
                                kept[row * LANES + lane] = 0.0
                clip(carry, envelope, nx)
            advance(task, before, carry, control, trials, trial_data, task_parameters)
            if n_dead > 0:
                restore(carry, n_carry, task, n_task, kept, dead)
            for lane in range(LANES):
                if dead[lane] == 0 and task[LANES + lane] == 0.0:
                    dead[lane] = 1
                    n_dead += 1
        for lane in range(min(LANES, rollouts - block * LANES)):
            rollout = block * LANES + lane
            lost[rollout] = 1 if dead[lane] == 2 else 0
            for row in range(nx):
                final_state[rollout * nx + row] = carry[row * LANES + lane]
            for row in range(n_task):
                final_task[rollout * n_task + row] = task[row * LANES + lane]


def decide(
    controller, observe, sizes, controller_parameters, task_parameters, actuation,
    state, theta_of, memory_of, task_of, control_of, carry, control, observation, raw, scratch,
):  # fmt: skip
    """One control for every rollout: ``state`` and ``control_of`` (rollouts, n), the others block by block."""
    nx, nu, n_memory, n_task, n_theta = (
        sizes[MIXED.nx],
        sizes[MIXED.nu],
        sizes[MIXED.n_memory],
        sizes[MIXED.n_task],
        sizes[MIXED.n_theta],
    )
    rollouts = sizes[MIXED.rollouts]
    for block in range((rollouts + LANES - 1) // LANES):
        for lane in range(LANES):
            rollout = min(block * LANES + lane, rollouts - 1)
            for row in range(nx):
                carry[row * LANES + lane] = state[rollout * nx + row]
        task = view(task_of, block * n_task * LANES)
        observe(task, carry, observation, task_parameters)
        theta = view(theta_of, block * n_theta * LANES)
        memory = view(memory_of, block * n_memory * LANES)
        controller(theta, memory, observation, raw, controller_parameters, scratch)
        actuate(raw, control, actuation, nu)
        for lane in range(min(LANES, rollouts - block * LANES)):
            for row in range(nu):
                control_of[(block * LANES + lane) * nu + row] = control[row * LANES + lane]


def settle(
    advance, sizes, task_parameters, trial_data, state, reached, control_of, task_of, dead_of,
    before, carry, control, kept, trials,
):  # fmt: skip
    """Advance the task of every rollout that is not over; ``reached`` (rollouts, nx) may be altered."""
    nx, nu, n_task, rollouts = sizes[MIXED.nx], sizes[MIXED.nu], sizes[MIXED.n_task], sizes[MIXED.rollouts]
    for block in range((rollouts + LANES - 1) // LANES):
        for lane in range(LANES):
            rollout = min(block * LANES + lane, rollouts - 1)
            trials[lane] = rollout % sizes[MIXED.trials]
            for row in range(nx):
                before[row * LANES + lane] = state[rollout * nx + row]
                carry[row * LANES + lane] = reached[rollout * nx + row]
            for row in range(nu):
                control[row * LANES + lane] = control_of[rollout * nu + row]
        task = view(task_of, block * n_task * LANES)
        for i in range(n_task * LANES):
            kept[i] = task[i]
        advance(task, before, carry, control, trials, trial_data, task_parameters)
        for lane in range(min(LANES, rollouts - block * LANES)):
            rollout = block * LANES + lane
            if dead_of[rollout] != 0:
                for row in range(n_task):
                    task[row * LANES + lane] = kept[row * LANES + lane]
            else:
                for row in range(nx):
                    reached[rollout * nx + row] = carry[row * LANES + lane]


def one_step(dynamics, carry, control, noise, parameters, scratch):
    """Step one block."""
    dynamics(carry, control, noise, parameters, scratch)


CLOSED_LOOP = Signature.of(
    closed_loop,
    dynamics=DYNAMICS, controller=CONTROLLER, observe=OBSERVE, advance=ADVANCE,
    sizes=WHOLES, first=NUMBER, last=NUMBER, trials=WHOLES, dead=WHOLES,
    survived=WHOLES, clipped=WHOLES, diverged=WHOLES,
)  # fmt: skip
OPEN_LOOP = Signature.of(open_loop, dynamics=DYNAMICS, sizes=WHOLES, first=NUMBER, last=NUMBER)
IMAGINE = Signature.of(
    imagine, dynamics=DYNAMICS, advance=ADVANCE, sizes=WHOLES, trials=WHOLES, dead=WHOLES, lost=WHOLES
)
DECIDE = Signature.of(decide, controller=CONTROLLER, observe=OBSERVE, sizes=WHOLES)
SETTLE = Signature.of(settle, advance=ADVANCE, sizes=WHOLES, dead_of=WHOLES, trials=WHOLES)
ONE_STEP = Signature.of(one_step, dynamics=DYNAMICS)
