"""Emulated cars and models of them behind the connection of a robot."""

import numpy as np
import pytest

from hardware.emulation.tracked_robots import (
    CORRELATION,
    FRAMES,
    HEADING_ERROR,
    LEAD,
    POSITION_ERROR,
    ModelRobot,
    TrackedRobot,
    TrackerErrorModel,
)
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import rollout
from sysid_evo.errors import IncompatibleSystem, InvalidArgument, LinkLost, ShapeError
from sysid_evo.models import Dynamics
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_robot
from sysid_evo.system import Channel, System
from sysid_evo.tasks import PointToPoint

FORWARD, NEUTRAL = np.array([1.0, 0.0]), [0.0, 0.0]


@pytest.fixture
def link(emulated):
    """A session with the emulated car."""
    with emulated.connect(seed=1) as link:
        yield link


def frames(connection, count):
    return [connection.measure(1.0) for _ in range(count)]


def test_seed_in_the_name_gives_another_car_of_the_same_system(emulated, car):
    third, again = make_robot("emulated_car:3"), make_robot("emulated_car:3")
    assert third.name == "emulated_car:3"
    assert third.physics.parameters == again.physics.parameters != emulated.physics.parameters
    assert make_robot("emulated_car:4").physics.parameters != third.physics.parameters
    assert emulated.system == third.system == car


def test_frames_come_every_five_milliseconds_of_simulated_time(link):
    seen = frames(link, 5)
    assert [frame.frame for frame in seen] == [0, 1, 2, 3, 4]
    assert [frame.source_time for frame in seen] == pytest.approx([0.0, 0.005, 0.01, 0.015, 0.02])
    assert all(frame.valid and frame.body == "emulated_car" for frame in seen)
    assert all(0.0 < frame.arrival_time - frame.source_time < 0.01 for frame in seen)


def test_no_frame_within_a_short_timeout_is_none(link):
    assert link.measure(0.001) is not None
    assert [link.measure(0.002) is None for _ in range(3)] == [True, True, False]


def test_driven_robot_moves_forward_and_is_seen_where_it_is(link):
    link.measure(1.0)
    for _ in range(200):
        link.send(FORWARD, valid_for=0.05)
        frame = link.measure(1.0)
    assert 0.4 < link.pose[0] < 1.2
    assert np.abs(frame.pose[:2] - link.pose[:2]).max() < 0.006
    assert np.abs(frame.pose[2] - link.pose[2]) < 0.03


def test_pose_is_the_integral_of_the_true_velocities(emulated, link):
    pose = np.zeros(3)
    link.measure(1.0)
    link.send(np.array([1.0, 1.0]), valid_for=10.0)
    for _ in range(400):
        before = link.state
        link.measure(1.0)
        pose = emulated.system.motion.move(pose, before, link.state, 0.005, emulated.system.state_names)
    assert pose == pytest.approx(link.pose, abs=1e-12)
    assert abs(pose[2]) > 2.0


def test_command_that_outlives_its_validity_becomes_neutral(link):
    link.measure(1.0)
    link.send(FORWARD, valid_for=0.1)
    for _ in range(20):
        link.measure(1.0)
        assert np.array_equal(link.control, FORWARD)
    link.measure(1.0)
    assert np.array_equal(link.control, NEUTRAL)
    frames(link, 800)
    assert np.all(link.state == 0.0)


def test_robot_is_neutral_on_every_way_out(emulated):
    with emulated.connect(seed=1) as link:
        link.measure(1.0)
        link.send(FORWARD, valid_for=9.0)
    assert np.array_equal(link.control, NEUTRAL)
    link = emulated.connect(seed=1)
    with pytest.raises(InvalidArgument), link:  # noqa: PT012  # the first command must be in force
        link.send(FORWARD, valid_for=9.0)
        link.send(FORWARD, valid_for=-1.0)
    assert np.array_equal(link.control, NEUTRAL)
    link.close()
    for use in (lambda: link.measure(1.0), lambda: link.send(FORWARD, valid_for=1.0)):
        with pytest.raises(LinkLost, match="closed"):
            use()


def test_illegal_commands_are_refused_and_not_sent(link):
    wrong = ([0.5, 0.0], 1.0, "drive"), ([np.nan, 0.0], 1.0, "drive"), ([1.0], 1.0, "control"), (FORWARD, 0.0, "> 0")
    for control, valid_for, said in wrong:
        with pytest.raises((InvalidArgument, ShapeError), match=said):
            link.send(np.array(control), valid_for=valid_for)
    assert np.array_equal(link.control, NEUTRAL)


def test_same_seed_gives_the_same_session_and_another_seed_another(emulated):
    def drive(seed):
        with emulated.connect(seed=seed) as link:
            link.measure(1.0)
            link.send(np.array([1.0, -1.0]), valid_for=9.0)
            return np.array([frame.pose for frame in frames(link, 300)])

    assert np.array_equal(drive(5), drive(5))
    assert np.abs(drive(5) - drive(6))[-1].max() > 0.01
    assert not np.array_equal(drive(None), drive(None))


def test_controllers_run_on_the_car_and_trials_repeat(emulated, rng):
    given = RecurrentNetwork(), 0.3 * rng.standard_normal((3, 78)), PointToPoint(horizon=60), trial_seeds(1, 4)
    first, again = (rollout(emulated.dynamics, *given, record=True) for _ in range(2))
    assert np.all(first.survived == 60)
    assert np.array_equal(first.task_state.pose, again.task_state.pose)
    states = np.concatenate([episode.states for episode in first.trajectories])
    assert 0.2 < np.abs(states[:, 0]).max() < 2.2


class Pushed(Dynamics):
    """Accelerates by the drive, turns by the steering; ``drift`` moves it even in neutral."""

    def __init__(self, system, drift=0.0, end=np.inf):
        self.system, self.n_carry, self.drift, self.end = system, 3, drift, end

    def start(self, states, controls, draws=None):
        return states[:, -1].copy()

    def step(self, carry, control, noise=None):
        after = carry + self.system.dt * np.array([1.0, 0.2, 2.0]) * control[:, [0, 0, 1]] + self.drift
        return np.where(carry[:, :1] > self.end, np.nan, after)


def pushed(system, name="pushed", **options):
    return ModelRobot(name, Pushed(system, **options)).connect()


def test_poses_at_the_ends_of_samples_are_those_of_the_model(car):
    controls = [(1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (-1.0, -1.0), (0.0, 0.0)]
    model, state, pose, wanted = Pushed(car), np.zeros(3), np.zeros(3), []
    for control in controls:
        after = model.step(state[None], np.array([control]))[0]
        pose = car.motion.move(pose, state, after, car.dt, car.state_names)
        state = after
        wanted.append(pose)
    with pushed(car) as connection:
        frames(connection, 1)
        seen = []
        for control in controls:
            connection.send(np.array(control), valid_for=0.15)
            seen += frames(connection, FRAMES)
        seen += frames(connection, LEAD)
    ends = seen[LEAD + FRAMES - 1 :: FRAMES]
    np.testing.assert_array_equal([frame.pose for frame in ends], wanted)
    assert [frame.source_time for frame in ends] == pytest.approx(0.01 + car.dt * np.arange(1, 6))


def test_poses_between_samples_are_a_smooth_path(car):
    with pushed(car) as connection:
        connection.send(np.array([1.0, 1.0]), valid_for=9.0)
        path = np.array([frame.pose for frame in frames(connection, 20 * FRAMES)])
    assert np.abs(np.diff(path[:, 0], n=2)).max() < 2.0 * (car.dt / FRAMES) ** 2


def test_a_command_that_is_a_little_late_counts_for_its_own_sample(car):
    ends = []
    for late in (0, LEAD - 1):
        with pushed(car) as connection:
            connection.send(FORWARD, valid_for=0.15)
            frames(connection, 1 + FRAMES + late)
            connection.send(-FORWARD, valid_for=0.15)
            ends.append(frames(connection, FRAMES + LEAD - late)[-1].pose)
    np.testing.assert_array_equal(*ends)


def test_the_model_rests_until_the_first_command_that_is_not_neutral(car):
    with pushed(car, drift=0.1) as connection:
        connection.send(np.zeros(2), valid_for=0.15)
        assert not np.any([frame.pose for frame in frames(connection, 50)])
        connection.send(np.array([0.0, 1.0]), valid_for=0.15)
        assert np.any(frames(connection, FRAMES)[-1].pose)


def test_a_command_that_has_expired_is_neutral_from_the_next_sample_on(car):
    with pushed(car) as connection:
        frames(connection, 1)
        connection.send(FORWARD, valid_for=0.15)
        moving = np.array([frame.pose[0] for frame in frames(connection, LEAD + 6 * FRAMES)])
    speed = np.diff(moving[LEAD - 1 :: FRAMES]) / car.dt
    assert speed == pytest.approx([0.025, 0.075, 0.125, 0.15, 0.15, 0.15], abs=1e-3)


def test_a_model_that_diverges_is_lost_and_a_closed_session_raises(car):
    with pushed(car, end=0.04) as connection:
        connection.send(FORWARD, valid_for=9.0)
        seen = [frame.valid for frame in frames(connection, 5 * FRAMES)]
    assert seen[FRAMES]
    assert not seen[-1]
    with pytest.raises(LinkLost, match="pushed"):
        connection.measure(1.0)


def test_only_a_planar_body_can_be_tracked_and_only_a_model_with_a_motion_driven(car):
    still = Pushed(System(car.states, car.controls, car.dt))
    with pytest.raises(IncompatibleSystem, match="planar body"):
        TrackedRobot("tank", Pushed(System((Channel("level", "m"),), car.controls, car.dt)), repeats=5)
    with pytest.raises(IncompatibleSystem, match="motion"):
        ModelRobot("still", still)


def test_errors_have_the_stated_size_and_correlation(rng):
    tracker = TrackerErrorModel(rng)
    pose = np.array([1.0, -2.0, 0.5])
    errors = np.array([tracker.observe(pose) for _ in range(20_000)]) - pose
    assert errors.std(axis=0) == pytest.approx([POSITION_ERROR, POSITION_ERROR, HEADING_ERROR], rel=0.03)
    assert np.abs(errors.mean(axis=0) / errors.std(axis=0)).max() < 0.04
    for column in errors.T:
        assert np.corrcoef(column[:-1], column[1:])[0, 1] == pytest.approx(CORRELATION, abs=0.03)


def test_headings_wrap_and_the_true_pose_is_left_alone(rng):
    tracker, pose = TrackerErrorModel(rng), np.array([0.0, 0.0, 3.0 * np.pi])
    headings = np.array([tracker.observe(pose)[2] for _ in range(200)])
    assert np.all((headings >= -np.pi) & (headings < np.pi))
    assert np.ptp(headings) > 6.0
    assert pose.tolist() == [0.0, 0.0, 3.0 * np.pi]
