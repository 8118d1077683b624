"""Scripted recording: from manoeuvres to journals, logs and a prepared data set."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.emulation.car_physics import CarParameters
from hardware.emulation.cars import ToyCarDynamics
from hardware.emulation.tracked_robots import TrackedRobot
from hardware.recording.journal_reader import JournalReader
from hardware.recording.manoeuvres import Manoeuvre, excitation_manoeuvres
from hardware.recording.record import RecordingJob, prepare_logs, read_logs, record_journals, save_raw_log
from hardware.run_report import StopReason, StopRequest
from sysid_evo.data.columns import load_columns
from sysid_evo.data.dataset import Dataset
from sysid_evo.data.preparation import prepare
from sysid_evo.data.readers import CsvReader
from sysid_evo.errors import InvalidData, LinkLost
from sysid_evo.registry import make_robot
from tests.fixtures.loop import Faults, FaultyRobot, Through


class Watched(Through):
    """A connection that notes the true states; ``robot`` says which frames show no body, end, or show it elsewhere."""

    def __init__(self, connection, robot):
        super().__init__(connection, Faults())
        self.robot, self.states = robot, []

    def measure(self, timeout):
        frame = super().measure(timeout)
        if frame is None or frame.frame > self.robot.last_frame:
            return None
        self.states.append(self.connection.state)
        jumped = 0.4 * (frame.frame >= self.robot.jump)
        seen = frame.frame not in self.robot.hidden
        return replace(frame, valid=seen, pose=np.add(frame.pose, [jumped, 0.0, 0.0]))


class WatchedRobot(FaultyRobot):
    def __init__(self, robot, hidden=range(0), last_frame=np.inf, jump=np.inf):
        super().__init__(robot)
        self.hidden, self.last_frame, self.jump = hidden, last_frame, jump
        self.dynamics, self.sessions = robot.dynamics, []

    def connect(self, *, seed=None):
        self.sessions.append(Watched(self.robot.connect(seed=seed), self))
        return self.sessions[-1]


@pytest.fixture
def robot(emulated):
    return WatchedRobot(emulated)


def short(rng, steps=40, name="short"):
    return Manoeuvre(name, np.repeat(rng.integers(-1, 2, (steps // 4, 2)).astype(float), 4, axis=0))


@pytest.fixture
def recorded(tmp_path):
    """Record manoeuvres on a robot; give the logs, and leave the report of the last run in ``report``."""
    count = iter(range(99))

    def run(robot, manoeuvres, **options):
        folder = tmp_path / str(next(count))
        run.report = record_journals(robot, manoeuvres, folder, RecordingJob(**{"seed": 1, **options}))
        return read_logs(folder, [one.name for one in manoeuvres])

    return run


def test_rows_are_frames_with_the_command_in_force_from_them_on(robot, rng, recorded):
    manoeuvre = short(rng)
    (log,) = recorded(robot, [manoeuvre])
    assert log.time == pytest.approx(np.arange(401) * 0.005)
    assert np.array_equal(log.controls[:-1], np.repeat(manoeuvre.controls, 10, axis=0))
    assert log.pose.shape == (401, 3)


def test_recording_of_a_car_without_noise_is_its_20_hz_form(rng, recorded):
    quiet = CarParameters(force_noise=1e-12, yaw_noise=1e-12, battery_spread=1e-12)
    robot = WatchedRobot(TrackedRobot("quiet", ToyCarDynamics(quiet), repeats=10))
    manoeuvre = short(rng, 100)
    recorded(robot, [manoeuvre])
    car = robot.dynamics
    carry = car.start(np.zeros((1, 2, 3)), np.zeros((1, 1, 2)))
    states = [carry[0, :3]]
    for control in manoeuvre.controls:
        carry = car.step(carry, control[None])
        states.append(carry[0, :3])
    assert np.array(robot.sessions[0].states)[:1001:10] == pytest.approx(np.array(states), abs=1e-9)
    assert np.abs(states).max() > 0.3


def test_same_seed_gives_the_same_recording(rng, recorded):
    manoeuvres = [short(rng), short(rng, name="second")]
    one, same, other = (recorded(make_robot("emulated_car"), manoeuvres, seed=seed) for seed in (4, 4, 5))
    for a, b, c in zip(one, same, other, strict=True):
        assert np.array_equal(a.pose, b.pose)
        assert not np.array_equal(a.pose, c.pose)
    assert not np.array_equal(one[0].pose[:5], one[1].pose[:5])


def test_progress_counts_control_samples(robot, rng, recorded):
    calls = []
    both = [short(rng), short(rng, name="second")]
    recorded(robot, both, progress=lambda done, total: calls.append((done, total)))
    assert sorted(set(calls)) == [(i, 80) for i in range(81)]
    assert calls == sorted(calls)


def test_frames_that_lost_the_body_are_left_out(emulated, rng, recorded):
    (log,) = recorded(WatchedRobot(emulated, hidden=range(90, 101)), [short(rng)])
    assert len(log.time) == 401 - 11
    assert np.diff(log.time).max() == pytest.approx(0.06)
    (late,) = recorded(WatchedRobot(emulated, hidden=range(3)), [short(rng)])
    assert (late.time[0], len(late.time)) == (0.0, 401)


@pytest.mark.parametrize(
    "trouble, rows",
    [({"hidden": range(200, 9999)}, 200), ({"hidden": range(9999)}, None), ({"last_frame": 199}, 200)],
)
def test_lost_tracker_ends_the_recording_with_the_robot_neutral_and_keeps_what_there_is(
    trouble, rows, emulated, rng, recorded
):
    robot = WatchedRobot(emulated, **trouble)
    logs = recorded(robot, [short(rng, 80), short(rng, name="never begun")])
    assert recorded.report.reason is StopReason.TRACKER_LOST
    assert [len(log.time) for log in logs] == ([rows] if rows else [])
    assert len(robot.sessions) == 1
    assert np.array_equal(robot.sessions[0].connection.control, [0.0, 0.0])
    with pytest.raises(LinkLost, match="closed"):
        robot.sessions[0].measure(1.0)


def test_interrupted_recording_keeps_what_there_is(robot, rng, recorded):
    stops = StopRequest()

    def interrupt(done, total):
        if done == 30:
            stops.request(StopReason.SIGINT)

    (log,) = recorded(robot, [short(rng, 80), short(rng, name="second")], stop=stops, progress=interrupt)
    assert recorded.report.reason is StopReason.SIGINT
    assert log.time[-1] == pytest.approx(1.5, abs=0.06)
    assert prepare_logs([log], robot.system).duration > 0.5


def test_physical_robot_stays_connected_and_rests_between_manoeuvres(robot, rng, recorded):
    robot.dynamics = None
    logs = recorded(robot, [short(rng), short(rng, name="second")])
    assert [len(log.time) for log in logs] == [401, 401]
    (session,) = robot.sessions
    assert session.time == pytest.approx(2.0 + 2.0 + 2.0, abs=0.11)
    assert np.abs(session.states[600:800]).max() < np.abs(session.states[:400]).max()


def test_jump_after_a_gap_splits_the_recording(emulated, rng, recorded):
    robot = WatchedRobot(emulated, jump=400, hidden=range(400, 418))
    (log,) = recorded(robot, [short(rng, 80)])
    assert recorded.report.reason is StopReason.PILOT
    dataset = prepare_logs([log], robot.system)
    assert len(dataset) == 2
    assert all(np.abs(episode.states[:, :2]).max() < 1.5 for episode in dataset.episodes)


def test_jump_that_no_robot_can_make_ends_the_recording(emulated, rng, recorded):
    (log,) = recorded(WatchedRobot(emulated, jump=400), [short(rng, 80)])
    assert recorded.report.reason is StopReason.TRACKER_LOST
    assert "jumped" in recorded.report.sentence
    assert log.time[-1] == pytest.approx(1.995)


def test_prepared_recording_agrees_with_the_true_states(robot, recorded):
    manoeuvres = excitation_manoeuvres(robot.system, duration=120.0, rng=np.random.default_rng(2))[:3]
    logs = recorded(robot, manoeuvres, seed=2)
    errors = []
    for log, session in zip(logs, robot.sessions, strict=True):
        (episode,) = prepare(log, robot.system).episodes
        truth = np.array(session.states)[::10]
        first = (len(truth) - len(episode.states)) // 2
        errors.append(episode.states - truth[first : first + len(episode.states)])
        assert np.array_equal(log.controls[::10][first : first + len(episode)], episode.controls)
    rms = np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))
    assert np.all(rms < [0.01, 0.01, 0.07])


def test_registered_robot_gives_a_data_set(car):
    recorded = make_robot("emulated_car:1").record(seed=3, duration=18.0)
    logs, dataset = recorded.logs, recorded.dataset
    assert len(logs) == len(dataset) == 12
    assert dataset.system == car
    assert dataset.names == tuple(log.name for log in logs)
    assert dataset.duration == pytest.approx(18.0, abs=6.0)


def test_saved_log_is_read_back_by_its_column_map(robot, rng, tmp_path, recorded):
    (log,) = recorded(robot, [short(rng)])
    path = save_raw_log(log, robot.system, tmp_path / "log.csv")
    columns = load_columns("emulated_car")
    table = CsvReader().read(path, columns.columns)
    assert CsvReader().header(path) == ("t", "x", "y", "heading", "drive", "steer")
    assert columns.system({}) == robot.system
    assert table.columns["t"] == pytest.approx(log.time)
    pose = np.stack([table.columns[name] for name in ("x", "y", "heading")], axis=1)
    assert pose == pytest.approx(log.pose, abs=1e-8)
    assert np.array_equal(np.stack([table.columns[name] for name in ("drive", "steer")], axis=1), log.controls)


def test_journals_are_read_as_logs(robot, rng, tmp_path):
    manoeuvre = short(rng, 100)
    record_journals(robot, [manoeuvre], tmp_path / "journal", RecordingJob(1))
    (log,) = read_logs(tmp_path / "journal", ["short"])
    save_raw_log(log, robot.system, tmp_path / "raw" / "short.csv")
    (from_journal,) = Dataset.read(tmp_path / "journal").episodes
    (from_csv,) = Dataset.read(tmp_path / "raw").episodes
    assert from_journal.states == pytest.approx(from_csv.states, abs=1e-6)
    assert np.array_equal(from_journal.controls, from_csv.controls)
    with pytest.raises(InvalidData, match="Did you mean 'steer'"):
        JournalReader().read(tmp_path / "journal" / "short.rcj", ["ster"])
