"""Kernel functions: rewards and ends of the classic environments over lanes.

``before``, ``control`` and ``after`` are rows of 64 trials, of which ``lane`` is one. The rules are those of the
environments, as documented by Gymnasium.
"""

from __future__ import annotations

import math

from sysid_evo.angles import TURN
from sysid_evo.kernels import LANES, Layout, nearest, view
from sysid_evo.motion_kernels import PER_TURN
from sysid_evo.tasks.learned_reward import judge_lanes

FASTEST_SWING = 8.0  # rad/s, beyond which the pendulum does not turn
CART_REACH, POLE_REACH = 2.4, 24.0 * math.pi / 360.0  # m, rad
CONTINUOUS_GOAL, GOAL = 0.45, 0.5


def pendulum(before, control, after, lane):
    """Minus the square of the angle from upright, and small shares of the squares of speed and torque."""
    angle = before[lane] - TURN * nearest(before[lane] * PER_TURN)
    speed = min(max(before[LANES + lane], -FASTEST_SWING), FASTEST_SWING)
    return -(angle * angle + 0.1 * speed * speed + 0.001 * control[lane] * control[lane])


def never(after, lane):
    """The pendulum continues until its time is up."""
    return 0.0


def one(before, control, after, lane):
    """The cart gets 1 for every step."""
    return 1.0


def fallen(after, lane):
    """The cart has left its rail, or the pole leans by more than 12 degrees."""
    return 1.0 if (abs(after[lane]) > CART_REACH) | (abs(after[2 * LANES + lane]) > POLE_REACH) else 0.0


def continuous_hill(before, control, after, lane):
    """100 at the goal, minus a tenth of the square of every force."""
    return 100.0 * on_continuous_hill(after, lane) - 0.1 * control[lane] * control[lane]


def on_continuous_hill(after, lane):
    """The car has reached the goal and does not roll back."""
    return 1.0 if (after[lane] >= CONTINUOUS_GOAL) & (after[LANES + lane] >= 0.0) else 0.0


def hill(before, control, after, lane):
    """Every step costs 1."""
    return -1.0


def on_hill(after, lane):
    """The car has reached the goal and does not roll back."""
    return 1.0 if (after[lane] >= GOAL) & (after[LANES + lane] >= 0.0) else 0.0


def acrobot(before, control, after, lane):
    """Every step costs 1, except the one that reaches the height."""
    return raised(after, lane) - 1.0


def raised(after, lane):
    """The free end is above the line, one link over the hinge."""
    height = -math.cos(after[lane]) - math.cos(after[lane] + after[LANES + lane])
    return 1.0 if height > 1.0 else 0.0


ROWS = Layout("fitness", "alive", "steps")
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
        task[ROWS.steps * LANES + lane] += 1.0
        if is_over(after, lane) > 0.0:
            task[ROWS.alive * LANES + lane] = 0.0


LEARNED = Layout("least", "late", "limit")
"""After the table of the states; the parameters of the learned reward follow.

Those of the reward at the time limit begin at ``late``; ``limit`` is its step, 0 if it is paid as others are.
"""


def advance_learned(task, before, after, control, trials, trial_data, parameters):
    """Add the learned reward of the step, and end the trial where an episode was learned to end."""
    own = view(parameters, HEAD.size + int(parameters[HEAD.nx]) * STATE.size)
    scratch = view(task, ROWS.size * LANES)
    fitness, steps = view(task, ROWS.fitness * LANES), view(task, ROWS.steps * LANES)
    least, late, limit = own[LEARNED.least], int(own[LEARNED.late]), own[LEARNED.limit]
    judge_lanes(before, control, after, scratch, view(own, LEARNED.size))
    at_limit = 0
    for lane in range(LANES):
        steps[lane] += 1.0
        reward = scratch[lane] if scratch[lane] >= least else least
        if steps[lane] == limit:
            at_limit, reward = 1, 0.0
        fitness[lane] += reward
        if scratch[LANES + lane] > 0.0:
            task[ROWS.alive * LANES + lane] = 0.0
    if at_limit > 0:
        judge_lanes(before, control, after, scratch, view(own, late))
        for lane in range(LANES):
            if steps[lane] == limit:
                fitness[lane] += scratch[lane] if scratch[lane] >= least else least
