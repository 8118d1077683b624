"""A model behind a robot's connection."""

import numpy as np
import pytest

from hardware.emulation.tracked_robots import FRAMES, LEAD, ModelledRobot
from sysid_evo.errors import IncompatibleSystem, InvalidArgument, LinkLost
from sysid_evo.models import Dynamics
from sysid_evo.system import System


class Pushed(Dynamics):
    """Accelerates by the drive, turns by the steering; ``drift`` moves it even in neutral."""

    def __init__(self, system, drift=0.0, end=np.inf):
        self.system, self.n_carry, self.drift, self.end = system, 3, drift, end

    def start(self, states, controls, draws=None):
        return states[:, -1].copy()

    def step(self, carry, control, noise=None):
        after = carry + self.system.dt * np.array([1.0, 0.2, 2.0]) * control[:, [0, 0, 1]] + self.drift
        return np.where(carry[:, :1] > self.end, np.nan, after)


CONTROLS = [(1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (-1.0, -1.0), (0.0, 0.0)]


def frames(connection, count):
    return [connection.measure(1.0) for _ in range(count)]


def test_poses_at_the_ends_of_samples_are_those_of_the_model(car):
    model = Pushed(car)
    state, pose, wanted = np.zeros(3), np.zeros(3), []
    for control in CONTROLS:
        after = model.step(state[None], np.array([control]))[0]
        pose = car.motion.move(pose, state, after, car.dt, car.state_names)
        state = after
        wanted.append(pose)
    with ModelledRobot("pushed", model).connect() as connection:
        frames(connection, 1)
        seen = []
        for control in CONTROLS:
            connection.send(np.array(control), valid_for=0.15)
            seen += frames(connection, FRAMES)
        seen += frames(connection, LEAD)
    ends = seen[LEAD + FRAMES - 1 :: FRAMES]
    np.testing.assert_array_equal([frame.pose for frame in ends], wanted)
    assert [frame.source_time for frame in ends] == pytest.approx(0.01 + car.dt * np.arange(1, 6))


def test_poses_between_samples_are_a_smooth_path(car):
    with ModelledRobot("pushed", Pushed(car)).connect() as connection:
        connection.send(np.array([1.0, 1.0]), valid_for=9.0)
        path = np.array([frame.pose for frame in frames(connection, 20 * FRAMES)])
    assert np.abs(np.diff(path[:, 0], n=2)).max() < 2.0 * (car.dt / FRAMES) ** 2


def test_a_command_that_is_a_little_late_counts_for_its_own_sample(car):
    ends = []
    for late in (0, LEAD - 1):
        with ModelledRobot("pushed", Pushed(car)).connect() as connection:
            connection.send(np.array([1.0, 0.0]), valid_for=0.15)
            frames(connection, 1 + FRAMES + late)
            connection.send(np.array([-1.0, 0.0]), valid_for=0.15)
            ends.append(frames(connection, FRAMES + LEAD - late)[-1].pose)
    np.testing.assert_array_equal(*ends)


def test_the_model_rests_until_the_first_command_that_is_not_neutral(car):
    with ModelledRobot("drifting", Pushed(car, drift=0.1)).connect() as connection:
        connection.send(np.zeros(2), valid_for=0.15)
        assert not np.any([frame.pose for frame in frames(connection, 50)])
        connection.send(np.array([0.0, 1.0]), valid_for=0.15)
        assert np.any(frames(connection, FRAMES)[-1].pose)


def test_a_command_that_has_expired_is_neutral_from_the_next_sample_on(car):
    with ModelledRobot("pushed", Pushed(car)).connect() as connection:
        frames(connection, 1)
        connection.send(np.array([1.0, 0.0]), valid_for=0.15)
        moving = np.array([frame.pose[0] for frame in frames(connection, LEAD + 6 * FRAMES)])
    speed = np.diff(moving[LEAD - 1 :: FRAMES]) / car.dt
    assert speed == pytest.approx([0.025, 0.075, 0.125, 0.15, 0.15, 0.15], abs=1e-3)


def test_a_model_that_diverges_is_lost_from_sight(car):
    with ModelledRobot("diverging", Pushed(car, end=0.04)).connect() as connection:
        connection.send(np.array([1.0, 0.0]), valid_for=9.0)
        seen = [frame.valid for frame in frames(connection, 5 * FRAMES)]
    assert seen[FRAMES]
    assert not seen[-1]


def test_commands_are_checked_and_a_closed_session_says_so(car):
    connection = ModelledRobot("pushed", Pushed(car)).connect()
    with pytest.raises(InvalidArgument, match="drive"):
        connection.send(np.array([0.5, 0.0]), valid_for=0.15)
    connection.close()
    with pytest.raises(LinkLost, match="pushed"):
        connection.measure(1.0)


def test_a_model_without_a_motion_has_no_pose_to_drive(car):
    with pytest.raises(IncompatibleSystem, match="motion"):
        ModelledRobot("still", Pushed(System(car.states, car.controls, car.dt)))
