"""Excitation of a simulator: that of a planar body varies in height, and begins again within a long episode."""

import numpy as np
import pytest

from hardware.recording.record import RecordingJob
from hardware.simulators.recording import RENEWED, SCRIPTS, record_simulator
from hardware.simulators.simulator import ExternalSimulator, SimulatorSession
from sysid_evo.motion import PlanarBody
from sysid_evo.rigid_body import RigidBody
from sysid_evo.system import Channel, System, rigid_body_states

PLANAR = tuple(Channel(name) for name in ("forward_speed", "lateral_speed", "yaw_rate"))
CONTROLS = (Channel("drive", low=-1.0, high=3.0, neutral=0.0), Channel("gear", levels=(-1.0, 0.0, 1.0)))


class Parked(ExternalSimulator):
    """A simulator whose state does not change in an episode, which never ends."""

    settable, rewarded = False, False

    def __init__(self, motion):
        states = rigid_body_states(motion, speed=9.0, rate=9.0) if isinstance(motion, RigidBody) else PLANAR
        self.name, self.system = "parked", System(states, CONTROLS, 0.1, motion)

    def open(self):
        return Session(self.system.nx)


class Session(SimulatorSession):
    def __init__(self, size):
        self.size = size

    def reset(self, seed, at=None):
        self.state = np.random.default_rng(seed).standard_normal(self.size)
        return self.state

    def step(self, control):
        return self.state, 0.0, False, False

    def close(self):
        pass


def recorded(motion, script):
    """The controls (blocks, RENEWED, 2) of ``script``."""
    seconds = 8 * RENEWED * len(SCRIPTS) * 0.1
    dataset = record_simulator(Parked(motion), seconds, RecordingJob(seed=0)).dataset
    found = [episode.controls for episode in dataset if episode.name == f"{script}-1"]
    return found[0].reshape(8, RENEWED, 2)


@pytest.mark.parametrize("motion", [None, RigidBody()])
def test_steps_of_anything_but_a_planar_body_reach_the_limits_all_the_time(motion):
    drive = recorded(motion, "steps-1")[:, :, 0]
    assert (drive.max(axis=1) == 3.0).all()
    assert (drive.min(axis=1) == -1.0).all()


def test_steps_of_a_planar_body_are_around_neutral_with_many_heights():
    drive = recorded(PlanarBody(), "steps-1")[:, :, 0]
    high, low = drive.max(axis=1), drive.min(axis=1)
    assert high.min() < 0.6
    assert high.max() > 1.5
    assert len(np.unique(high)) == 8
    np.testing.assert_allclose(low, -high / 3.0)  # the limits are -1 and 3


def test_a_control_with_levels_takes_all_of_them_whatever_the_height():
    assert all(set(block) == {-1.0, 0.0, 1.0} for block in recorded(PlanarBody(), "steps-1")[:, :, 1])


@pytest.mark.parametrize(("motion", "least", "most"), [(None, 1, 1), (RigidBody(), 1, 1), (PlanarBody(), 4, 8)])
def test_feedback_on_a_planar_body_alone_is_drawn_again_within_an_episode(motion, least, most):
    values, counts = np.unique(recorded(motion, "feedback-1")[:, :, 0], return_counts=True)
    often = counts[(values > -1.0) & (values < 3.0)] >= 0.5 * RENEWED  # others are random steps
    assert least <= often.sum() <= most
