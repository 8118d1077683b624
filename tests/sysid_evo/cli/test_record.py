"""`sysid-evo record`: what is on disk afterwards, also when it was cut short."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from sysid_evo.data import Dataset
from tests.fixtures.commands import run_here

COMMAND = [sys.executable, "-c", "from sysid_evo.__main__ import main; main()", "record"]
ENVIRONMENT = {**os.environ, "COLUMNS": "80", "TERM": "dumb"}

SLOW_ROBOT = '''
"""The emulated car in real time."""
import time

from hardware.emulation.cars import emulated_car
from hardware.emulation.tracked_robots import EmulatedConnection
from sysid_evo import register_robot


class Slow(EmulatedConnection):
    def measure(self, timeout):
        time.sleep(0.001)
        return super().measure(timeout)


@register_robot("slow_car")
def slow_car():
    robot = emulated_car()
    robot.connect = lambda *, seed=None: Slow(robot.name, robot.physics, seed=seed)
    return robot
'''

HUNG = '''
"""Robots whose step never returns after a while: equations, and a simulator that sleeps."""
import time

import numpy as np

from hardware.emulation.sensed_robot import Equations, SensedRobot
from hardware.simulators.simulator import ExternalSimulator, SimulatorSession
from hardware.simulators.simulator_robot import SimulatorRobot
from sysid_evo import Channel, System, register_robot

SYSTEM = System(["x"], [Channel("u", low=-1.0, high=1.0)], dt=0.05)


class Stuck(Equations):
    system = SYSTEM
    steps = 0

    def rates_of_change(self, states, controls):
        Stuck.steps += 1
        while Stuck.steps > 200:
            pass
        return controls - states


@register_robot("stuck")
def stuck():
    return SensedRobot("stuck", Stuck())


class Asleep(ExternalSimulator, SimulatorSession):
    name, system, settable, steps = "asleep", SYSTEM, False, 0

    def open(self):
        return self

    def reset(self, seed, at=None):
        return np.zeros(1)

    def step(self, control):
        self.steps += 1
        if self.steps > 150:
            time.sleep(1e6)
        return np.zeros(1), 0.0, self.steps % 50 == 0, False

    def close(self):
        pass


class Sleeper(SimulatorRobot):
    """Does not answer."""

    answers_within = 0.5


@register_robot("asleep")
def asleep():
    return Sleeper(Asleep())
'''


def test_a_robot_that_does_not_answer_any_more_is_a_sentence_and_what_was_recorded_is_kept(tmp_path: Path) -> None:
    (tmp_path / "hung.py").write_text(HUNG)
    hung = ("--plugin", "hung.py")
    checked = run_here("robots", "check", "asleep", *hung, cwd=tmp_path)
    assert (checked.returncode, "asleep: no answer for 0.5 s" in checked.stderr) == (4, True), checked.stderr
    recorded = run_here("record", "--robot", "asleep", "--minutes", "1", "--out", "kept", *hung, cwd=tmp_path)
    assert (recorded.returncode, "asleep: no answer for 0.5 s" in recorded.stderr) == (4, True), recorded.stderr
    assert len(Dataset.load(tmp_path / "kept")) == 3


@pytest.mark.parametrize("asked", [("robots", "check", "stuck"), ("record", "--robot", "stuck", "--out", "none")])
def test_a_signal_ends_a_command_whose_robot_does_not_answer(tmp_path: Path, asked: tuple[str, ...]) -> None:
    (tmp_path / "hung.py").write_text(HUNG + "\nopen('ready', 'w').close()\n")
    command = [*COMMAND[:-1], *asked, "--plugin", "hung.py"]
    running = subprocess.Popen(command, cwd=tmp_path, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True)
    while not (tmp_path / "ready").exists() and running.poll() is None:
        time.sleep(0.02)
    time.sleep(2.0)
    running.send_signal(signal.SIGTERM)
    said = running.communicate(timeout=60.0)[1]
    assert running.returncode == 143, said
    assert "no answer within 1 s of the signal" in " ".join(said.split())


def test_recording_leaves_journals_raw_logs_and_a_data_set_and_is_not_overwritten(tmp_path: Path) -> None:
    arguments = ("record", "--minutes", "0.4", "--seed", "3", "--out", "car")
    done = run_here(*arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "car"
    dataset = Dataset.load(folder)
    assert len(dataset) == len(list((folder / "journal").glob("*.rcj"))) == len(list((folder / "raw").glob("*.csv")))
    again = Dataset.read(folder / "journal")
    for name in dataset.names:
        one, other = (next(episode for episode in some.episodes if episode.name == name) for some in (dataset, again))
        assert np.array_equal(one.states, other.states)
        assert np.array_equal(one.controls, other.controls)
    second = run_here(*arguments, cwd=tmp_path)
    assert second.returncode == 2
    assert "expected a new or an empty folder" in " ".join(second.stderr.split())
    assert "Traceback" not in second.stderr


def test_interrupted_recording_is_kept_and_the_exit_code_says_so(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW_ROBOT)
    command = [*COMMAND, "--plugin", "slow.py", "--robot", "slow_car", "--minutes", "2", "--out", "car"]
    recording = subprocess.Popen(command, cwd=tmp_path, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60.0
    while len(list((tmp_path / "car" / "journal").glob("*.rcj"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)
    recording.send_signal(signal.SIGINT)
    said = recording.communicate(timeout=60.0)[1]
    assert recording.returncode == 130, said
    assert "the recording was cut short: interrupted" in said
    assert "loops-forward" in Dataset.load(tmp_path / "car").names


def test_a_robot_without_a_pose_is_recorded_by_what_its_sensors_say(tmp_path: Path) -> None:
    done = run_here("record", "--robot", "pendulum", "--minutes", "0.3", "--out", "swing", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    dataset = Dataset.load(tmp_path / "swing")
    assert dataset.system.state_names == ("angle", "angular_speed")
    log = next((tmp_path / "swing" / "raw").glob("*.csv"))
    assert log.read_text().splitlines()[0] == "t,torque,angle,angular_speed"
