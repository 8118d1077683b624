"""The emulated car behind the connection of a robot."""

import numpy as np
import pytest

from hardware.emulation.held_control import HeldControl
from hardware.emulation.tracked_robots import EmulatedRobot
from hardware.robot import Robot
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import rollout
from sysid_evo.errors import IncompatibleSystem, InvalidArgument, LinkLost, ShapeError
from sysid_evo.models import Dynamics
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_robot
from sysid_evo.system import Channel, System
from sysid_evo.tasks import PointToPoint

FORWARD = np.array([1.0, 0.0])


@pytest.fixture(scope="module")
def robot():
    return make_robot("emulated_car")


def test_robot_of_the_registry_keeps_the_contract(robot, car):
    assert isinstance(robot, Robot)
    assert robot.name == "emulated_car"
    assert robot.system == car
    assert isinstance(robot.dynamics, HeldControl)
    assert robot.dynamics.system == robot.system


def test_seed_in_the_name_gives_another_car(robot):
    third, again = make_robot("emulated_car:3"), make_robot("emulated_car:3")
    assert third.name == "emulated_car:3"
    assert third.physics.parameters == again.physics.parameters != robot.physics.parameters
    assert make_robot("emulated_car:4").physics.parameters != third.physics.parameters


def test_frames_come_every_five_milliseconds_of_simulated_time(robot):
    with robot.connect(seed=1) as link:
        frames = [link.measure(1.0) for _ in range(5)]
    assert [frame.frame for frame in frames] == [0, 1, 2, 3, 4]
    assert [frame.source_time for frame in frames] == pytest.approx([0.0, 0.005, 0.01, 0.015, 0.02])
    assert all(frame.valid and frame.body == "emulated_car" for frame in frames)
    assert all(0.0 < frame.arrival_time - frame.source_time < 0.01 for frame in frames)


def test_no_frame_within_a_short_timeout_is_none(robot):
    with robot.connect(seed=1) as link:
        assert link.measure(0.001) is not None
        assert [link.measure(0.002) is None for _ in range(3)] == [True, True, False]


def test_driven_robot_moves_forward_and_is_seen_where_it_is(robot):
    with robot.connect(seed=1) as link:
        link.measure(1.0)
        for _ in range(200):
            link.send(FORWARD, valid_for=0.05)
            frame = link.measure(1.0)
        assert 0.4 < link.pose[0] < 1.2
        assert np.abs(frame.pose[:2] - link.pose[:2]).max() < 0.006
        assert np.abs(frame.pose[2] - link.pose[2]) < 0.03


def test_pose_is_the_integral_of_the_true_velocities(robot):
    pose = np.zeros(3)
    with robot.connect(seed=2) as link:
        link.measure(1.0)
        link.send(np.array([1.0, 1.0]), valid_for=10.0)
        for _ in range(400):
            before = link.state
            link.measure(1.0)
            pose = robot.system.motion.move(pose, before, link.state, 0.005, robot.system.state_names)
        assert pose == pytest.approx(link.pose, abs=1e-12)
        assert abs(pose[2]) > 2.0


def test_command_that_outlives_its_validity_becomes_neutral(robot):
    with robot.connect(seed=1) as link:
        link.measure(1.0)
        link.send(FORWARD, valid_for=0.1)
        for _ in range(20):
            link.measure(1.0)
            assert np.array_equal(link.control, FORWARD)
        link.measure(1.0)
        assert np.array_equal(link.control, [0.0, 0.0])
        for _ in range(800):
            link.measure(1.0)
        assert np.all(link.state == 0.0)


def test_robot_is_neutral_on_every_way_out(robot):
    with robot.connect(seed=1) as link:
        link.measure(1.0)
        link.send(FORWARD, valid_for=9.0)
    assert np.array_equal(link.control, [0.0, 0.0])
    link = robot.connect(seed=1)
    with pytest.raises(InvalidArgument), link:  # noqa: PT012  # the first command must be in force
        link.send(FORWARD, valid_for=9.0)
        link.send(FORWARD, valid_for=-1.0)
    assert np.array_equal(link.control, [0.0, 0.0])
    link.close()
    for use in (lambda: link.measure(1.0), lambda: link.send(FORWARD, valid_for=1.0)):
        with pytest.raises(LinkLost, match="closed"):
            use()


def test_illegal_commands_are_refused_and_not_sent(robot):
    with robot.connect(seed=1) as link:
        for control, error in (([0.5, 0.0], InvalidArgument), ([np.nan, 0.0], InvalidArgument), ([1.0], ShapeError)):
            with pytest.raises(error):
                link.send(np.array(control), valid_for=1.0)
        with pytest.raises(InvalidArgument, match="valid_for > 0"):
            link.send(FORWARD, valid_for=0.0)
        assert np.array_equal(link.control, [0.0, 0.0])


def test_same_seed_gives_the_same_session_and_another_seed_another(robot):
    def drive(seed):
        with robot.connect(seed=seed) as link:
            link.measure(1.0)
            link.send(np.array([1.0, -1.0]), valid_for=9.0)
            return np.array([link.measure(1.0).pose for _ in range(300)])

    assert np.array_equal(drive(5), drive(5))
    assert np.abs(drive(5) - drive(6))[-1].max() > 0.01
    assert not np.array_equal(drive(None), drive(None))


def test_controllers_run_on_the_car_and_trials_repeat(robot, rng):
    parameters = 0.3 * rng.standard_normal((3, 78))
    task, seeds = PointToPoint(horizon=60), trial_seeds(1, 4)
    first = rollout(robot.dynamics, RecurrentNetwork(), parameters, task, seeds, record=True)
    again = rollout(robot.dynamics, RecurrentNetwork(), parameters, task, seeds, record=True)
    assert np.all(first.survived == 60)
    assert np.array_equal(first.task_state.pose, again.task_state.pose)
    states = np.concatenate([episode.states for episode in first.trajectories])
    assert 0.2 < np.abs(states[:, 0]).max() < 2.2


def test_only_a_planar_body_can_be_tracked():
    class Tank(Dynamics):
        system = System((Channel("level", "m"),), (Channel("valve", low=0.0, high=1.0),), dt=0.01)
        n_carry = 1

        def start(self, states, controls, draws=None):
            return states[:, -1]

        def step(self, carry, control, noise=None):
            return carry + control

    with pytest.raises(IncompatibleSystem, match="planar body"):
        EmulatedRobot("tank", Tank(), repeats=5)
