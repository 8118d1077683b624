"""The classic environments of Gymnasium, each channel by its name and unit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from sysid_evo.angles import TURN
from sysid_evo.system import Channel


@dataclass(frozen=True)
class KnownEnvironment:
    """What the spaces of an environment do not say.

    ``states`` and ``controls`` are its channels, ``scale`` how far the states go; ``angle`` says which observations are
    angles, see `parse_angles`.
    Its own state, which ``env.unwrapped.state`` holds, are the same numbers in the same order, so that a trial can
    begin anywhere.
    """

    states: tuple[Channel, ...]
    controls: tuple[Channel, ...]
    scale: tuple[float, ...]
    angle: str = ""


CART = KnownEnvironment(
    states=(
        Channel("position", "m", -4.8, 4.8),
        Channel("speed", "m/s"),
        Channel("angle", "rad", -0.42, 0.42),
        Channel("angular_speed", "rad/s"),
    ),
    controls=(Channel("force", "N", levels=(-10.0, 10.0)),),
    scale=(2.4, 3.0, 0.21, 3.0),
)
HILL = (
    Channel("position", low=-1.2, high=0.6, neutral=-math.pi / 6.0),
    Channel("speed", low=-0.07, high=0.07),
)
HILL_SCALE = (0.9, 0.07)
PUSHES = (-1.0, 0.0, 1.0)

KNOWN: Mapping[str, KnownEnvironment] = {
    "Pendulum-v1": KnownEnvironment(
        states=(Channel("angle", "rad", neutral=math.pi, period=TURN), Channel("angular_speed", "rad/s", -8.0, 8.0)),
        controls=(Channel("torque", "N m", -2.0, 2.0),),
        scale=(1.0, 1.0),
        angle="0,1",
    ),
    "CartPole-v0": CART,
    "CartPole-v1": CART,
    "MountainCar-v0": KnownEnvironment(HILL, (Channel("force", levels=PUSHES),), HILL_SCALE),
    "MountainCarContinuous-v0": KnownEnvironment(HILL, (Channel("force", low=-1.0, high=1.0),), HILL_SCALE),
    "Acrobot-v1": KnownEnvironment(
        states=(
            Channel("angle_1", "rad", period=TURN),
            Channel("angle_2", "rad", period=TURN),
            Channel("angular_speed_1", "rad/s"),
            Channel("angular_speed_2", "rad/s"),
        ),
        controls=(Channel("torque", "N m", levels=PUSHES),),
        scale=(1.0, 1.0, 4.0 * math.pi, 9.0 * math.pi),
        angle="0,1; 2,3",
    ),
}
"""By the environment's id. The upright pendulum and cart-pole have angle 0; the hanging acrobot has."""
