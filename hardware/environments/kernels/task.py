"""The reward of an environment over lanes."""

from __future__ import annotations

import math

from sysid_evo.kernels import LANES, Layout, view

ROWS = Layout("fitness", "alive")
HEAD = Layout("nx")
STATE = Layout("periodic", "centre", "scale")


def observe(task, state, observation, parameters):
    """Bias, then each state in units of its scale; of a periodic one the sine and the cosine."""
    for lane in range(LANES):
        observation[lane] = 1.0
    row = 1
    for i in range(int(parameters[HEAD.nx])):
        at = HEAD.size + i * STATE.size
        centre, scale = parameters[at + STATE.centre], parameters[at + STATE.scale]
        value, shown = view(state, i * LANES), view(observation, row * LANES)
        if parameters[at + STATE.periodic] > 0.0:
            for lane in range(LANES):
                shown[lane] = math.sin(value[lane])
                shown[LANES + lane] = math.cos(value[lane])
            row += 2
        else:
            for lane in range(LANES):
                shown[lane] = (value[lane] - centre) / scale
            row += 1


def advance(task, before, after, control, trials, trial_data, parameters):
    """Add the reward of the step, and end the trial where the environment does."""
    for lane in range(LANES):
        task[ROWS.fitness * LANES + lane] += reward_of(before, control, after, lane)
        if is_over(after, lane) > 0.0:
            task[ROWS.alive * LANES + lane] = 0.0
