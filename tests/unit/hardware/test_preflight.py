"""What is refused before a robot moves: in a sentence, and without a connection."""

import os
from dataclasses import replace

import numpy as np
import pytest

from hardware.control_loop import SLOWEST
from hardware.driving.hand_driving import HandPanel, check_driving_by_hand, hand_trials
from hardware.driving.keyboard import Keyboard
from hardware.driving.trials import RobotRunner
from hardware.preflight import check_driving, check_recording
from hardware.recording.manoeuvres import Manoeuvre
from hardware.recording.record import RecordingJob, record_journals
from hardware.robot import Robot, find_robot
from hardware.run_report import StopRequest
from hardware.self_test import self_test
from sysid_evo.controllers.networks import RecurrentNetwork
from sysid_evo.errors import (
    IncompatibleSystem,
    IncompatibleTask,
    InvalidArgument,
    InvalidSystem,
    LinkLost,
    MissingExtra,
    ShapeError,
)
from sysid_evo.motion import PlanarBody
from sysid_evo.registry import robots
from sysid_evo.system import Channel, System
from sysid_evo.tasks import PointToPoint
from tests.fixtures.loop import FaultyRobot


class Parked(Robot):
    """A physical robot that must not be connected to."""

    dynamics = None

    def __init__(self, system, missing=None):
        self.name, self.system, self.missing = "parked", system, missing

    def check(self):
        if self.missing is not None:
            raise self.missing

    def connect(self, *, seed=None):
        raise AssertionError("somebody connected to the robot")


PENDULUM = System((Channel("angle", "rad"),), (Channel("torque", "N m", low=-1.0, high=1.0),), dt=0.05)
MAST = System(
    (Channel("forward_speed"), Channel("yaw_rate"), Channel("roll", "rad")),
    (Channel("drive", low=-1.0, high=1.0),),
    dt=0.05,
    motion=PlanarBody(lateral=None),
)


def test_a_car_may_be_driven_recorded_and_driven_by_hand(car, tmp_path):
    robot, task, controller = Parked(car), PointToPoint(), RecurrentNetwork()
    check_driving(robot, task, controller, np.zeros((1, 78)))
    check_driving_by_hand(robot, task)
    check_recording(robot, tmp_path / "new" / "folder", duration=360.0)
    assert not (tmp_path / "new").exists()


def test_a_robot_that_is_too_slow_is_refused_by_everything_that_drives_before_it_connects(car, tmp_path):
    robot, task, keyboard = Parked(car.with_dt(0.2)), PointToPoint(), Keyboard(life=0.1)
    instruments = HandPanel(robot, task, keyboard)
    check_recording(Parked(car.with_dt(SLOWEST)), None, duration=360.0)
    for drive in (
        lambda: check_recording(robot, None, duration=360.0),
        lambda: check_driving(robot, task),
        lambda: record_journals(robot, [Manoeuvre("rest", np.zeros((9, 2)))], tmp_path, RecordingJob(0)),
        lambda: RobotRunner(robot).bind(RecurrentNetwork(), task)(np.zeros((1, 78)), np.zeros(1, dtype=np.uint64)),
        lambda: self_test(robot),
        lambda: next(hand_trials(robot, task, keyboard, instruments, seed_of=lambda index: index, stop=StopRequest())),
    ):
        with pytest.raises(IncompatibleSystem, match=r"dt of at most 0\.1 s, got 0\.2 s.*valid for 0\.15 s"):
            drive()


def test_a_task_that_a_robot_cannot_do_is_refused_before_it_moves(car, tmp_path):
    endless = replace(car, controls=(Channel("drive"), Channel("steer")))
    narrow = np.zeros((1, 5))
    for check, error, sentence in (
        (lambda: check_driving(Parked(PENDULUM), PointToPoint()), IncompatibleSystem, "planar pose.*got no motion"),
        (lambda: check_driving(Parked(MAST), PointToPoint()), IncompatibleSystem, "do not determine the states roll"),
        (lambda: check_driving(Parked(endless), PointToPoint()), InvalidSystem, "'drive' has no finite limits"),
        (
            lambda: check_driving(Parked(car), PointToPoint(), RecurrentNetwork(), narrow),
            ShapeError,
            r"parameters.*78.*5",
        ),
        (lambda: check_recording(Parked(replace(car, controls=())), None, duration=60.0), IncompatibleSystem, "none"),
        (lambda: check_recording(Parked(car), None, duration=5.0), InvalidArgument, "at least 12 s"),
        (lambda: check_driving_by_hand(Parked(endless), PointToPoint()), InvalidArgument, "no finite limits"),
    ):
        with pytest.raises(error, match=sentence):
            check()


class Elsewhere(PointToPoint):
    def bind(self, system):
        raise IncompatibleTask("this task needs a beach")


def test_a_task_that_does_not_fit_and_what_a_robot_itself_misses_are_refused(car):
    with pytest.raises(IncompatibleTask, match="beach"):
        check_driving(Parked(car), Elsewhere())
    robot = Parked(car, LinkLost("port /dev/rcb: no such device; is the robot plugged in?"))
    for check in (
        lambda: check_driving(robot, PointToPoint()),
        lambda: check_driving_by_hand(robot, PointToPoint()),
        lambda: check_recording(robot, None, duration=60.0),
    ):
        with pytest.raises(LinkLost, match="no such device"):
            check()


def test_a_missing_package_of_the_page_is_an_error_with_its_installation(car, monkeypatch):
    monkeypatch.setattr("hardware.driving.server.PACKAGES", ("no_such_package",))
    with pytest.raises(MissingExtra, match="driving by hand needs the package 'no_such_package'"):
        check_driving_by_hand(Parked(car), PointToPoint())


def test_folders_that_cannot_take_the_journals_are_refused_before_the_first_manoeuvre(car, tmp_path):
    (tmp_path / "weaving.rcj").touch()
    file = tmp_path / "file"
    file.touch()
    for folder, sentence in (
        (tmp_path, r"weaving\.rcj: a recording exists already"),
        (file / "journal", "expected a folder for journals, but .*file is a file"),
    ):
        with pytest.raises(InvalidArgument, match=sentence):
            check_recording(Parked(car), folder, duration=60.0)
    manoeuvres = [Manoeuvre(name, np.zeros((9, 2))) for name in ("rest", "weaving")]
    with pytest.raises(InvalidArgument, match=r"weaving\.rcj: a recording exists already"):
        record_journals(Parked(car), manoeuvres, tmp_path, RecordingJob(0))


@pytest.mark.skipif(os.geteuid() == 0, reason="everything is permitted to root")
def test_a_folder_without_permission_is_refused(car, tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InvalidArgument, match="expected a folder that can be written"):
        check_recording(Parked(car), tmp_path / "journal", duration=60.0)


def test_a_robot_is_found_by_name_and_what_is_none_is_refused(register):
    assert isinstance(find_robot("emulated_car:3"), Robot)
    register(robots, "a_text", lambda: "a text")
    with pytest.raises(InvalidArgument, match=r"robot 'a_text': expected a hardware\.robot\.Robot, got a str"):
        find_robot("a_text")


@pytest.mark.parametrize(
    ("faults", "wrong"),
    [
        ({}, set()),
        ({"moved": (0.5, (0.05, 0.0, 0.0))}, {"tracker", "loop"}),
        ({"lost": (0.3, 0.5)}, {"tracker"}),
        ({"lost": (-1.0, 99.0)}, {"tracker", "loop"}),
        ({"broken_at": 0.5}, {"loop"}),
        ({"tripped_at": 0.5}, {"loop"}),
        ({"slow": {0.5: 30}}, {"loop"}),
    ],
)
def test_each_fault_is_found_where_it_is_and_the_robot_closed_without_having_been_driven(emulated, faults, wrong):
    robot = FaultyRobot(emulated, **faults)
    assert {finding.check for finding in self_test(robot, seconds=1.0, seed=1) if not finding.ok} == wrong
    assert robot.connection.closed
    assert not robot.connection.driven, "nothing but neutral was sent"
