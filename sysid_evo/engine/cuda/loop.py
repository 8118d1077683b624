"""The closed loop of one rollout, as a kernel function of one lane: what `loops.closed_loop` does with 64."""

from __future__ import annotations

from sysid_evo.engine.behaviour import EVERY
from sysid_evo.engine.compiled.lanes import load, view, where_less
from sysid_evo.engine.compiled.loops import actuate, clear, copy_rows, count_sides


def one_rollout(
    rollout, rollouts, trial, trials_in_all, horizon,
    dynamics_parameters, controller_parameters, task_parameters, theta,
    start, task_start, trial_data, noise_of, envelope, actuation, centre,
    carry, control, noise, memory, observation, raw, before, task, tally, scratch, controller_scratch, trials,
    fitness, survived, clipped, diverged, final_task, counts, doubts, states, controls, poses,
):  # fmt: skip
    """Run one candidate in one trial. What is bound in capitals is known when this is compiled."""
    trials[0] = trial
    copy_rows(view(start, trial * N_CARRY), carry, N_CARRY)
    copy_rows(view(task_start, trial * N_TASK), task, N_TASK)
    clear(memory, N_MEMORY)
    clear(tally, 2 * (NX + NU))
    steps, lost, clippings = 0, 0, 0
    while steps < horizon and task[1] != 0.0:
        observe(task, view(carry, SEEN), observation, task_parameters)
        controller(theta, memory, observation, raw, controller_parameters, controller_scratch)
        actuate(raw, control, actuation, NU)
        if steps % EVERY == 0:
            count_sides(carry, view(task, 1), centre, NX, tally)
            count_sides(control, view(task, 1), view(centre, NX), NU, view(tally, 2 * NX))
        drawn = view(noise_of, steps * N_NOISE * trials_in_all + trial)
        for row in range(N_NOISE):
            noise[row] = drawn[row * trials_in_all]
        copy_rows(carry, before, NX)
        dynamics(carry, control, noise, dynamics_parameters, scratch)
        if not_finite(carry, N_CARRY):
            lost = 1
            break
        clippings += clip_counted(carry, envelope, NX)
        advance(task, before, carry, control, trials, trial_data, task_parameters)
        if RECORD == 1:
            at = rollout * (horizon + 1) + steps
            copy_rows(before, view(states, at * NX), NX)
            copy_rows(carry, view(states, (at + 1) * NX), NX)
            copy_rows(control, view(controls, (rollout * horizon + steps) * NU), NU)
            copy_rows(view(task, POSE_ROW), view(poses, (at + 1) * N_POSE), N_POSE)
        steps += 1
    fitness[rollout], survived[rollout], clipped[rollout], diverged[rollout] = task[0], steps, clippings, lost
    for row in range(N_TASK):
        final_task[row * rollouts + rollout] = task[row]
    for row in range(2 * (NX + NU)):
        counts[row * rollouts + rollout] = tally[row]
    if DOUBT_AT >= 0:
        doubts[rollout] = carry[DOUBT_AT]


def not_finite(carry, rows):
    """Return whether any number is infinite or none at all."""
    mark = 0.0
    for row in range(rows):
        mark += carry[row] * 0.0
    return mark != 0.0


def clip_counted(carry, envelope, nx):
    """Clip every state to the envelope (low, then high of each); return 1 if one was outside."""
    outside = 0.0
    for row in range(nx):
        value = load(carry, row)
        outside = outside + where_less(value, envelope[row], 1.0, 0.0) + where_less(envelope[nx + row], value, 1.0, 0.0)
        carry[row] = min(max(value, envelope[row]), envelope[nx + row])
    return 1 if outside > 0.0 else 0
