"""A real recording of a car on a slippery floor, and the split that every comparison uses."""

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System

TEST_EPISODE = "2025-04-16-17-36-01"


@pytest.fixture(scope="session")
def throttle_car():
    """A car with continuous throttle and steering at 20 Hz."""
    return System(
        states=(Channel("forward_speed", "m/s"), Channel("lateral_speed", "m/s"), Channel("yaw_rate", "rad/s")),
        controls=(Channel("drive", low=0.0, high=1.0), Channel("steer", low=-1.0, high=1.0)),
        dt=0.05,
        motion=PlanarBody(),
        name="slippery car",
    )


@pytest.fixture(scope="session")
def slippery(recordings, throttle_car):
    """Training and test set of the slippery recordings."""
    states, controls, poses, names = [], [], [], []
    for path in sorted((recordings / "dart" / "slippery_20hz").glob("*.csv")):
        log = np.genfromtxt(path, delimiter=",", names=True)
        states.append(np.stack([log["u"], log["v"], log["r"]], axis=1))
        controls.append(np.stack([np.maximum(log["throttle"], 0.0) * log["safety"], log["steering"]], axis=1))
        poses.append(np.stack([log["x"], log["y"], log["yaw"]], axis=1))
        names.append(path.stem)
    return Dataset.from_arrays(throttle_car, states, controls, poses=poses, names=names).split([TEST_EPISODE])
