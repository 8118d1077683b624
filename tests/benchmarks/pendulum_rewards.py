"""Plugin: rewards and ends of two MuJoCo pendulums of Gymnasium, as functions of their observations."""

import math

from sysid_evo.tasks.reward import register_reward

HORIZON = 1000


def leans(pole):
    """The pole leans by more than 0.2 rad."""
    return abs(pole) > 0.2


AT_START = (-0.01, 0.01)


@register_reward(
    "inverted_pendulum",
    min_reward=0.0,
    horizon=HORIZON,
    terminated=leans,
    start=dict.fromkeys(("cart", "pole", "cart_speed", "pole_speed"), AT_START),
)
def inverted_pendulum(cart, pole):
    """1 a step."""
    return 1.0


def low(pole, second):
    """The tip is at most 1 m above the cart."""
    return 0.6 * (math.cos(pole) + math.cos(pole + second)) <= 1.0


@register_reward(
    "inverted_double_pendulum",
    min_reward=0.0,
    horizon=HORIZON,
    terminated=low,
    start=dict.fromkeys(("cart", "pole", "second", "cart_speed", "pole_speed", "second_speed"), (-0.1, 0.1)),
)
def inverted_double_pendulum(cart, pole, second, pole_speed, second_speed):
    """10 a step, minus the distance of the tip from 2 m above the rail's middle, and small shares of the speeds."""
    across = cart + 0.6 * (math.sin(pole) + math.sin(pole + second))
    height = 0.6 * (math.cos(pole) + math.cos(pole + second))
    speeds = 0.001 * pole_speed**2 + 0.005 * second_speed**2
    return 10.0 - 0.01 * across**2 - (height - 2.0) ** 2 - speeds
