"""Recording: from manoeuvres to logs and a prepared data set."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hardware.emulation.car_parameters import CarParameters
from hardware.emulation.car_physics import CarPhysics
from hardware.emulation.emulated_robot import EmulatedRobot
from hardware.measurement import Measurement
from hardware.recording.excitation import Manoeuvre, excitation
from hardware.recording.recorder import record, record_dataset, save_raw
from hardware.robot import Connection, Robot
from sysid_evo.arrays import Array
from sysid_evo.data.columns import load_columns
from sysid_evo.data.preparation import prepare
from sysid_evo.data.tables import CsvReader
from sysid_evo.errors import LinkLost
from sysid_evo.registry import make_robot


class Watched(Connection):
    """A connection that notes the true states and loses sight of the body in some frames."""

    def __init__(self, link, hidden: range, last_frame: float) -> None:
        self.link, self.hidden, self.last_frame = link, hidden, last_frame
        self.states: list[Array] = []

    @property
    def time(self) -> float:
        return self.link.time

    def send(self, control: Array, *, valid_for: float) -> None:
        self.link.send(control, valid_for=valid_for)

    def measure(self, timeout: float) -> Measurement | None:
        frame = self.link.measure(timeout)
        if frame is None or frame.frame > self.last_frame:
            return None
        self.states.append(self.link.state)
        return replace(frame, valid=frame.frame not in self.hidden)

    def close(self) -> None:
        self.link.close()


class WatchedRobot(Robot):
    def __init__(self, robot: Robot, hidden: range = range(0), last_frame: float = np.inf) -> None:
        self.robot, self.hidden, self.last_frame = robot, hidden, last_frame
        self.name, self.system, self.dynamics = robot.name, robot.system, robot.dynamics
        self.sessions: list[Watched] = []

    def connect(self, *, seed: int | None = None) -> Connection:
        self.sessions.append(Watched(self.robot.connect(seed=seed), self.hidden, self.last_frame))
        return self.sessions[-1]


@pytest.fixture
def robot() -> WatchedRobot:
    return WatchedRobot(make_robot("emulated_car"))


def short(rng: np.random.Generator, steps: int = 40) -> Manoeuvre:
    return Manoeuvre("short", np.repeat(rng.integers(-1, 2, (steps // 4, 2)).astype(float), 4, axis=0))


def test_rows_are_frames_with_the_command_in_force_from_them_on(robot, rng):
    manoeuvre = short(rng)
    (log,) = record(robot, [manoeuvre], seed=1)
    assert log.time == pytest.approx(np.arange(401) * 0.005)
    assert np.array_equal(log.controls[:-1], np.repeat(manoeuvre.controls, 10, axis=0))
    assert log.pose.shape == (401, 3)


def test_recording_of_a_car_without_noise_is_its_20_hz_form(rng):
    quiet = CarParameters(force_noise=1e-12, yaw_noise=1e-12, battery_spread=1e-12)
    robot = WatchedRobot(EmulatedRobot("quiet", CarPhysics(quiet), repeats=10))
    manoeuvre = short(rng, 100)
    record(robot, [manoeuvre], seed=1)
    car = robot.dynamics
    carry = car.start(np.zeros((1, 2, 3)), np.zeros((1, 1, 2)))
    states = [carry[0, :3]]
    for control in manoeuvre.controls:
        carry = car.step(carry, control[None])
        states.append(carry[0, :3])
    assert np.array(robot.sessions[0].states)[::10] == pytest.approx(np.array(states), abs=1e-9)
    assert np.abs(states).max() > 0.3


def test_same_seed_gives_the_same_recording(rng):
    manoeuvres = [short(rng), replace(short(rng), name="second")]
    one, same, other = (record(make_robot("emulated_car"), manoeuvres, seed=seed) for seed in (4, 4, 5))
    for a, b, c in zip(one, same, other, strict=True):
        assert np.array_equal(a.pose, b.pose)
        assert not np.array_equal(a.pose, c.pose)
    assert not np.array_equal(one[0].pose[:5], one[1].pose[:5])


def test_progress_counts_control_samples(robot, rng):
    calls = []
    record(robot, [short(rng), short(rng)], seed=1, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(i + 1, 80) for i in range(80)]


def test_frames_that_lost_the_body_are_left_out(rng):
    (log,) = record(WatchedRobot(make_robot("emulated_car"), hidden=range(90, 101)), [short(rng)], seed=1)
    assert len(log.time) == 401 - 11
    assert np.diff(log.time).max() == pytest.approx(0.06)
    (late,) = record(WatchedRobot(make_robot("emulated_car"), hidden=range(3)), [short(rng)], seed=1)
    assert (late.time[0], len(late.time)) == (0.0, 401)


@pytest.mark.parametrize("trouble", [{"hidden": range(50, 9999)}, {"hidden": range(9999)}, {"last_frame": 100}])
def test_lost_tracker_ends_the_recording_with_the_robot_neutral(trouble, rng):
    robot = WatchedRobot(make_robot("emulated_car"), **trouble)
    with pytest.raises(LinkLost, match="tracker"):
        record(robot, [short(rng, 80)], seed=1)
    assert np.array_equal(robot.sessions[0].link.control, [0.0, 0.0])
    with pytest.raises(LinkLost, match="closed"):
        robot.sessions[0].measure(1.0)


def test_prepared_recording_agrees_with_the_true_states(robot):
    manoeuvres = excitation(robot.system, duration=120.0, rng=np.random.default_rng(2))[:4]
    logs = record(robot, manoeuvres, seed=2)
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
    logs, dataset = record_dataset("emulated_car:1", seed=3, duration=24.0)
    assert len(logs) == len(dataset) == 12
    assert dataset.system == car
    assert dataset.names == tuple(log.name for log in logs)
    assert dataset.duration == pytest.approx(24.0, abs=6.0)
    assert dataset.fingerprint == record_dataset("emulated_car:1", seed=3, duration=24.0)[1].fingerprint


def test_saved_log_is_read_back_by_its_column_map(robot, rng, tmp_path):
    (log,) = record(robot, [short(rng)], seed=1)
    path = save_raw(log, robot.system, tmp_path / "log.csv")
    columns = load_columns("emulated_car")
    table = CsvReader().read(path, columns.columns)
    assert CsvReader().header(path) == ("t", "x", "y", "heading", "drive", "steer")
    assert columns.system({}) == robot.system
    assert table.columns["t"] == pytest.approx(log.time)
    pose = np.stack([table.columns[name] for name in ("x", "y", "heading")], axis=1)
    assert pose == pytest.approx(log.pose, abs=1e-8)
    assert np.array_equal(np.stack([table.columns[name] for name in ("drive", "steer")], axis=1), log.controls)
