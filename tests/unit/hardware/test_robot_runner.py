"""Controllers on a robot, one trial at a time, by the control loop in simulated time."""

import numpy as np
import pytest

from hardware.driving.trials import RobotRunner, StandstillDetector, TrialLog
from hardware.estimator import StateEstimate
from hardware.run_report import StopReason, StopRequest
from sysid_evo.controllers import Controller
from sysid_evo.engine import DynamicsRunner
from sysid_evo.errors import InvalidArgument
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks import PointToPoint
from tests.fixtures.loop import Diary, FaultyRobot

REST = 0.5  # s before each trial
PLACED = (2.0, -1.0, 2.5)


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
        self.distances = []

    def bind(self, n_observations, n_outputs):
        return self

    def act(self, parameters, memory, view):
        self.distances.append(view.observation[0, :, 4].copy())
        drive = (memory < parameters[:, None]).astype(float)
        return np.concatenate([drive, np.zeros_like(drive)], axis=-1), memory + 1.0


def drive(robot, horizon, trials, controller=None, parameters=((1.0,),), **options):
    """Return what the trials gave, and the report of the run."""
    runner = RobotRunner(robot, seed=1, **options)
    task, seeds = PointToPoint(horizon=horizon), trial_seeds(1, trials)
    return runner.drive(controller or Chaser(), np.array(parameters), task, seeds)


def way(trajectory):
    return np.hypot(*np.diff(trajectory.pose[:, :2], axis=0).T).sum()


@pytest.mark.parametrize("horizon, trials", [(60, 6), pytest.param(300, 16, marks=pytest.mark.nightly)])
def test_controller_achieves_on_the_loop_what_it_does_on_the_same_car_in_process(emulated, horizon, trials):
    """Means of independent trials differ by chance: by three standard errors once in some 400 times."""
    driven, _ = drive(emulated, horizon, trials)
    simulated = DynamicsRunner(emulated.dynamics).bind(Chaser(), PointToPoint(horizon=horizon))(
        np.ones((1, 1)), trial_seeds(1, trials), record=True
    )
    ways = [np.mean([way(one) for one in ran.trajectories]) for ran in (driven, simulated)]
    assert ways[0] == pytest.approx(ways[1], rel=0.05)
    assert simulated.fitness.mean() > horizon / 100
    error = np.hypot(driven.fitness.std(), simulated.fitness.std()) / np.sqrt(trials)
    assert abs(driven.fitness.mean() - simulated.fitness.mean()) < 3.0 * error


def test_rollouts_hold_every_trial_with_its_trajectory(emulated):
    ran, _ = drive(emulated, 60, 3)
    assert ran.fitness.shape == ran.survived.shape == (1, 3)
    assert (ran.survived == 60).all()
    assert not ran.clipped.any()
    assert (ran.engine, ran.missing) == ("robot", ())
    assert [t.name for t in ran.trajectories] == [f"candidate-0-trial-{i}" for i in range(3)]
    for trajectory in ran.trajectories:
        assert (trajectory.states.shape, trajectory.controls.shape) == ((61, 3), (60, 2))
        assert way(trajectory) > 1.0


def test_the_first_trial_starts_in_the_origin_and_the_next_where_the_robot_is(emulated):
    first, second = drive(FaultyRobot(emulated, placed=PLACED), 60, 2)[0].trajectories
    np.testing.assert_allclose(first.pose[0], 0.0, atol=0.02)
    stopped = np.hypot(*(second.pose[0] - first.pose[-1])[:2])
    assert 0.1 < stopped < 1.5, "it coasts to a stop"
    assert np.abs(second.states[0]).max() < 0.4


def test_memory_is_reset_in_every_trial_and_lasts_for_it(emulated):
    ran, _ = drive(emulated, 12, 2, Spurt(), [[7.0], [3.0]])
    driven = [int(trajectory.controls[:, 0].sum()) for trajectory in ran.trajectories]
    assert driven == [7, 7, 3, 3]


def test_what_is_observed_and_scored_follows_the_measured_pose(emulated):
    spurt = Spurt()
    ran, _ = drive(FaultyRobot(emulated, placed=PLACED), 30, 2, spurt, [[30.0]])
    for trial, trajectory in enumerate(ran.trajectories):
        np.testing.assert_allclose(ran.task_state.pose[trial, :2], trajectory.pose[-1, :2], atol=1e-12)
        (first,) = spurt.distances[30 * trial]
        expected = np.hypot(*(ran.task_state.waypoints[trial, 0] - trajectory.pose[0, :2]))
        assert first == pytest.approx(expected)


def test_origin_of_the_tracker_is_kept_when_asked_for(emulated):
    ran, _ = drive(FaultyRobot(emulated, placed=(0.4, -0.3, 1.5)), 20, 1, tracker_frame=True)
    np.testing.assert_allclose(ran.trajectories[0].pose[0], [0.4, -0.3, 1.5], atol=0.02)


def test_candidates_drive_in_turn_and_each_is_scored_for_itself(emulated):
    ran, _ = drive(emulated, 150, 2, parameters=[[1.0], [0.0]])
    assert ran.fitness.shape == (2, 2)
    assert (ran.fitness[0] > 0).all()
    standing = [t for t in ran.trajectories if t.name.startswith("candidate-1")]
    assert len(standing) == 2
    assert all(np.hypot(*(t.pose[-1] - t.pose[0])[:2]) < 0.02 for t in standing)
    assert np.array_equal(ran.task_state.passed.reshape(2, 2), ran.fitness)


def test_trial_cut_short_by_a_fault_is_missing_with_the_reason_and_those_before_it_count(emulated):
    faulty = FaultyRobot(emulated, lost=(1.0 + 40 * 0.05 + 2.5, 99.0))
    ran, report = drive(faulty, 40, 4)
    assert report.reason is StopReason.TRACKER_LOST
    assert (ran.fitness.shape, len(ran.missing)) == ((1, 1), 3)
    assert "tracker lost" in ran.missing[0]
    assert faulty.connection.closed


def test_controller_output_that_is_not_a_number_stops_the_robot_and_is_not_scored(emulated):
    diary = Diary()
    ran, report = drive(emulated, 60, 2, parameters=[[np.nan]], listeners=[diary])
    assert report.reason is StopReason.NOT_FINITE
    assert (ran.fitness.shape, len(ran.missing)) == ((1, 0), 2)
    assert not any(command.control.any() for command in diary.commands)


@pytest.mark.parametrize("trials, candidates", [(0, 1), (1, 0)])
def test_a_run_without_a_candidate_or_a_trial_is_refused(emulated, trials, candidates):
    with pytest.raises(InvalidArgument, match="at least one candidate and one trial seed, got none"):
        drive(emulated, 20, trials, parameters=np.ones((candidates, 1)))


def test_requested_stop_ends_the_trials(emulated):
    stops = StopRequest()
    ran, report = drive(emulated, 20, 5, stop=stops, progress=lambda done, total: stops.request(StopReason.SIGTERM))
    assert report.reason is StopReason.SIGTERM
    assert ran.fitness.shape == (1, 1)
    assert ran.missing == ("terminated",) * 4


def test_neutral_is_sent_until_the_robot_rests_and_between_trials(emulated):
    diary = Diary()
    drive(emulated, 20, 2, listeners=[diary])
    driving = np.array([command.control.any() for command in diary.commands])
    starts = np.flatnonzero(np.diff(driving.astype(int)) == 1)
    assert len(starts) == 2
    assert diary.commands[starts[0]].time > REST
    ends = np.flatnonzero(np.diff(driving.astype(int)) == -1)
    assert diary.commands[starts[1]].time - diary.commands[ends[0]].time > REST


def test_a_robot_that_never_comes_to_rest_is_a_fault_with_a_reason(emulated):
    class Rolling(FaultyRobot):
        def connect(self, *, seed=None):
            connection = super().connect(seed=seed)
            inner = connection.measure

            def measure(timeout):
                self.faults.placed = (connection.time, 0.0, 0.0)
                return inner(timeout)

            connection.measure = measure
            return connection

    ran, report = drive(Rolling(emulated), 20, 2)
    assert report.reason is StopReason.NOT_AT_REST
    assert ran.missing == ("the robot did not come to rest: it still moves after 10 s",) * 2


def test_rest_is_half_a_second_within_a_centimetre():
    watch = StandstillDetector()
    asked = [
        watch.at_rest(StateEstimate(0.05 * k, np.array([0.001 * (k % 2), 0.0, 3.2]), np.zeros(3), 0.0))
        for k in range(15)
    ]
    assert asked.index(True) == 10
    assert not watch.at_rest(StateEstimate(0.75, np.array([0.02, 0.0, 3.2]), np.zeros(3), 0.0))


def test_samples_that_are_missing_lie_on_the_line_between_their_neighbours():
    tape = TrialLog(
        ticks=[0, 1, 3],
        states=[np.zeros(1), np.ones(1), np.full(1, 5.0)],
        poses=[np.array([0.0, 0.0, 3.1]), np.array([1.0, 0.0, 3.2 - 2 * np.pi]), np.array([3.0, 0.0, 3.4 - 2 * np.pi])],
        controls=[np.zeros(2), np.ones(2)],
    )
    trajectory = tape.trajectory(0.05, "t")
    np.testing.assert_allclose(trajectory.states[:, 0], [0.0, 1.0, 3.0, 5.0])
    np.testing.assert_allclose(trajectory.controls[:, 0], [0.0, 1.0, 1.0])
    np.testing.assert_allclose(trajectory.pose[:, 2], [3.1, 3.2, 3.3, 3.4])
