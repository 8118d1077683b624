"""Controllers on a robot, one trial at a time, by the control loop in simulated time."""

from __future__ import annotations

import numpy as np
import pytest

from hardware.driving.trials import RestWatch, RobotRunner, Tape
from hardware.estimator import StateEstimate
from hardware.run_report import Reason, Stops
from sysid_evo.controllers import Controller
from sysid_evo.engine import DynamicsRunner
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_robot
from sysid_evo.tasks import PointToPoint
from sysid_evo.tasks.point_to_point import PointToPointState
from sysid_evo.types import Array
from tests.fixtures.loop import Diary, FaultyRobot

REST = 0.5  # s before each trial


class Chaser(Controller):
    """Full throttle, and steers to the side on which the waypoint is; the parameter is the throttle."""

    n_parameters, n_memory = 1, 0

    def bind(self, n_observations, n_outputs):
        return self

    def act(self, parameters, memory, view):
        angle = view.observation[..., 3]
        raw = np.stack([np.broadcast_to(parameters[:, :1], angle.shape), 2.0 * angle], axis=-1)
        return raw, memory


class Spurt(Controller):
    """Full throttle for the first steps of a trial, as many as its parameter says; keeps the distances it was shown."""

    n_parameters, n_memory = 1, 1

    def __init__(self):
        self.distances: list[Array] = []

    def bind(self, n_observations, n_outputs):
        return self

    def act(self, parameters, memory, view):
        self.distances.append(view.observation[0, :, 4].copy())
        drive = (memory < parameters[:, None]).astype(float)
        return np.concatenate([drive, np.zeros_like(drive)], axis=-1), memory + 1.0


FULL = np.ones((1, 1))


@pytest.fixture
def robot():
    return make_robot("emulated_car")


def test_controller_achieves_on_the_loop_what_it_does_on_the_same_car_in_process(robot):
    """Means of independent trials differ by chance: by three standard errors once in some 400 times."""
    assert robot.dynamics is not None
    task, seeds = PointToPoint(horizon=300), trial_seeds(1, 16)
    driven = RobotRunner(robot, seed=1).run(Chaser(), FULL, task, seeds).fitness
    simulated = DynamicsRunner(robot.dynamics).run(Chaser(), FULL, task, seeds).fitness
    assert simulated.mean() > 3.0
    error = np.hypot(driven.std(), simulated.std()) / np.sqrt(len(seeds))
    assert abs(driven.mean() - simulated.mean()) < 3.0 * error


def test_rollouts_hold_every_trial_with_its_trajectory(robot):
    ran = RobotRunner(robot, seed=1).run(Chaser(), FULL, PointToPoint(horizon=60), trial_seeds(1, 3))
    assert ran.fitness.shape == ran.survived.shape == (1, 3)
    assert (ran.survived == 60).all()
    assert not ran.clipped.any()
    assert (ran.engine, ran.missing) == ("robot", ())
    assert [t.name for t in ran.trajectories] == [f"candidate-0-trial-{i}" for i in range(3)]
    for trajectory in ran.trajectories:
        assert trajectory.states.shape == (61, 3)
        assert trajectory.controls.shape == (60, 2)
        assert trajectory.pose is not None
        assert np.hypot(*np.diff(trajectory.pose[:, :2], axis=0).T).sum() > 1.0


def test_first_trial_starts_in_the_origin_and_the_next_where_the_robot_stands(robot):
    placed = FaultyRobot(robot, placed=(2.0, -1.0, 2.5))
    first, second = (
        RobotRunner(placed, seed=1).run(Chaser(), FULL, PointToPoint(horizon=60), trial_seeds(1, 2)).trajectories
    )
    assert first.pose is not None
    assert second.pose is not None
    np.testing.assert_allclose(first.pose[0], 0.0, atol=0.02)
    stopped = np.hypot(*(second.pose[0] - first.pose[-1])[:2])
    assert 0.1 < stopped < 1.5, "it coasts to a stop"
    assert np.abs(second.states[0]).max() < 0.4


def test_memory_begins_anew_in_every_trial_and_lasts_for_it(robot):
    steps = np.array([[7.0], [3.0]])
    ran = RobotRunner(robot, seed=1).run(Spurt(), steps, PointToPoint(horizon=12), trial_seeds(1, 2))
    driven = [int(trajectory.controls[:, 0].sum()) for trajectory in ran.trajectories]
    assert driven == [7, 7, 3, 3]


def test_what_is_observed_and_scored_follows_the_measured_pose(robot):
    placed, spurt, task = FaultyRobot(robot, placed=(2.0, -1.0, 2.5)), Spurt(), PointToPoint(horizon=30)
    ran = RobotRunner(placed, seed=1).run(spurt, np.full((1, 1), 30.0), task, trial_seeds(1, 2))
    state = ran.task_state
    assert isinstance(state, PointToPointState)
    for trial, trajectory in enumerate(ran.trajectories):
        assert trajectory.pose is not None
        np.testing.assert_allclose(state.pose[trial, :2], trajectory.pose[-1, :2], atol=1e-12)
        (first,) = spurt.distances[30 * trial]
        expected = np.hypot(*(state.waypoints[trial, 0] - trajectory.pose[0, :2]))
        assert first == pytest.approx(expected)


def test_origin_of_the_tracker_is_kept_when_asked_for(robot):
    placed = FaultyRobot(robot, placed=(0.4, -0.3, 1.5))
    ran = RobotRunner(placed, tracker_frame=True, seed=1).run(
        Chaser(), FULL, PointToPoint(horizon=20), trial_seeds(1, 1)
    )
    assert ran.trajectories[0].pose is not None
    np.testing.assert_allclose(ran.trajectories[0].pose[0], [0.4, -0.3, 1.5], atol=0.02)


def test_candidates_drive_in_turn_and_each_is_scored_for_itself(robot):
    throttles = np.array([[1.0], [0.0]])
    ran = RobotRunner(robot, seed=1).run(Chaser(), throttles, PointToPoint(horizon=200), trial_seeds(1, 2))
    assert ran.fitness.shape == (2, 2)
    assert (ran.fitness[0] > 0).all()
    standing = [t for t in ran.trajectories if t.name.startswith("candidate-1")]
    assert all(np.hypot(*(t.pose[-1] - t.pose[0])[:2]) < 0.02 for t in standing if t.pose is not None)
    assert np.array_equal(getattr(ran.task_state, "passed").reshape(2, 2), ran.fitness)  # noqa: B009  # of its own task


def test_trial_cut_short_by_a_fault_is_missing_with_the_reason_and_those_before_it_count(robot):
    faulty = FaultyRobot(robot, lost=(1.0 + 60 * 0.05 + 2.5, 99.0))
    ran, report = RobotRunner(faulty, seed=1).drive(Chaser(), FULL, PointToPoint(horizon=60), trial_seeds(1, 4))
    assert report.reason is Reason.TRACKER_LOST
    assert ran.fitness.shape == (1, 1)
    assert len(ran.missing) == 3
    assert "tracker lost" in ran.missing[0]
    assert faulty.connection is not None
    assert faulty.connection.closed


def test_controller_output_that_is_not_a_number_stops_the_robot_and_is_not_scored(robot):
    diary = Diary()
    ran, report = RobotRunner(robot, seed=1, listeners=[diary]).drive(
        Chaser(), np.full((1, 1), np.nan), PointToPoint(horizon=60), trial_seeds(1, 2)
    )
    assert report.reason is Reason.NOT_FINITE
    assert ran.fitness.shape == (1, 0)
    assert len(ran.missing) == 2
    assert not any(command.control.any() for command in diary.commands)


def test_requested_stop_ends_the_trials(robot):
    stops = Stops()
    runner = RobotRunner(robot, seed=1, stops=stops, progress=lambda done, total: stops.request(Reason.SIGTERM))
    ran, report = runner.drive(Chaser(), FULL, PointToPoint(horizon=20), trial_seeds(1, 5))
    assert report.reason is Reason.SIGTERM
    assert ran.fitness.shape == (1, 1)
    assert ran.missing == ("terminated",) * 4


def test_neutral_is_sent_until_the_robot_rests_and_between_trials(robot):
    diary = Diary()
    RobotRunner(robot, seed=1, listeners=[diary]).run(Chaser(), FULL, PointToPoint(horizon=20), trial_seeds(1, 2))
    driving = np.array([command.control.any() for command in diary.commands])
    starts = np.flatnonzero(np.diff(driving.astype(int)) == 1)
    assert len(starts) == 2
    assert diary.commands[starts[0]].time > REST
    ends = np.flatnonzero(np.diff(driving.astype(int)) == -1)
    assert diary.commands[starts[1]].time - diary.commands[ends[0]].time > REST


def test_robot_that_never_stands_is_a_fault_with_a_reason(robot):
    class Rolling(FaultyRobot):
        def connect(self, *, seed=None):
            connection = super().connect(seed=seed)
            inner = connection.measure

            def measure(timeout):
                self.faults.placed = (connection.time, 0.0, 0.0)
                return inner(timeout)

            connection.measure = measure  # type: ignore[method-assign]
            return connection

    ran, report = RobotRunner(Rolling(robot), seed=1).drive(Chaser(), FULL, PointToPoint(horizon=20), trial_seeds(1, 2))
    assert report.reason is Reason.RESTLESS
    assert ran.missing == ("the robot did not come to rest: it still moves after 10 s",) * 2


def test_rest_is_half_a_second_within_a_centimetre():
    watch = RestWatch()
    asked = [
        watch.at_rest(StateEstimate(0.05 * k, np.array([0.001 * (k % 2), 0.0, 3.2]), np.zeros(3), 0.0))
        for k in range(15)
    ]
    assert asked.index(True) == 10
    assert not watch.at_rest(StateEstimate(0.75, np.array([0.02, 0.0, 3.2]), np.zeros(3), 0.0))


def test_samples_that_are_missing_lie_on_the_line_between_their_neighbours():
    tape = Tape(
        ticks=[0, 1, 3],
        states=[np.zeros(1), np.ones(1), np.full(1, 5.0)],
        poses=[np.array([0.0, 0.0, 3.1]), np.array([1.0, 0.0, 3.2 - 2 * np.pi]), np.array([3.0, 0.0, 3.4 - 2 * np.pi])],
        controls=[np.zeros(2), np.ones(2)],
    )
    trajectory = tape.trajectory(0.05, "t")
    np.testing.assert_allclose(trajectory.states[:, 0], [0.0, 1.0, 3.0, 5.0])
    np.testing.assert_allclose(trajectory.controls[:, 0], [0.0, 1.0, 1.0])
    assert trajectory.pose is not None
    np.testing.assert_allclose(trajectory.pose[:, 2], [3.1, 3.2, 3.3, 3.4])
