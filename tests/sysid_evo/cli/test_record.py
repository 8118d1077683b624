"""`sysid-evo record`: what is on disk afterwards, also when it was cut short."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from sysid_evo.data import Dataset
from tests.sysid_evo.cli.calling import run_here

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
