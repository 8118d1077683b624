"""Ctrl-C and other signals: a clear sentence, nothing half-written, and the run goes on afterwards."""

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass, field

import pytest

from sysid_evo.data import Dataset
from sysid_evo.evolution.strategies.mu_plus_lambda import MuPlusLambda
from sysid_evo.registry import strategies
from tests.fixtures.commands import COMMAND, SMALL

FAMILIES = """
import os
import time
from pathlib import Path

import numpy as np

from sysid_evo import DynamicsModel, register_model

with open("ran", "a") as trace:
    trace.write("ran ")


@register_model("waiting")
class Waiting(DynamicsModel):
    def fit(self, dataset, *, rng, progress=None):
        self.half_ = np.zeros(3)
        progress(1, 2)
        if not Path("second").exists():
            Path("waits").write_text(str(os.getpid()))
            time.sleep(60.0)
        return self

    def next_state(self, carry, control):
        return carry
"""
ROBOTS = """
import time

from hardware.emulation.cars import emulated_car
from hardware.emulation.sensed_robot import Equations, SensedRobot
from hardware.emulation.tracked_robots import TrackedConnection
from sysid_evo import Channel, System, register_robot


class Slow(TrackedConnection):
    def measure(self, timeout):
        time.sleep(0.001)
        return super().measure(timeout)


@register_robot("slow_car")
def slow_car():
    robot = emulated_car()
    robot.connect = lambda *, seed=None: Slow(robot.name, robot.physics, seed=seed)
    return robot


class Stuck(Equations):
    system = System(["x"], [Channel("u", low=-1.0, high=1.0)], dt=0.05)
    steps = 0

    def rates_of_change(self, states, controls):
        Stuck.steps += 1
        if Stuck.steps > 200:
            open("stuck", "w").close()
        while Stuck.steps > 200:
            pass
        return controls - states


@register_robot("stuck")
def stuck():
    return SensedRobot("stuck", Stuck())
"""
PRESSED_EARLY = """
import sys
from sysid_evo.__main__ import main

class Pressed:
    def find_spec(self, name, path=None, target=None):
        if name == "typer":
            raise KeyboardInterrupt

sys.meta_path.insert(0, Pressed())
main()
"""
INTERRUPTIBLE = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
"""Put before a command: a job in the background ignores Ctrl-C."""
LIMIT = 60.0  # s, for what a process is to say


@contextmanager
def ctrl_c(condition):
    """Press Ctrl-C in this process as soon as ``condition`` holds."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
    over = threading.Event()

    def press():
        while not over.wait(0.01):
            if condition():
                os.kill(os.getpid(), signal.SIGINT)
                return

    thread = threading.Thread(target=press)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize(("jobs", "last", "kept"), [(1, "fit linear", 2), (2, "score linear", 3)])
def test_ctrl_c_ends_fits_in_good_order_and_the_same_command_goes_on(jobs, last, kept, call, stored_data, monkeypatch):
    """Side by side, the processes run the plugin that is given, unasked, and nothing else of the current folder."""
    monkeypatch.setenv("XDG_STATE_HOME", "/proc")  # no decision on a plugin can be remembered
    monkeypatch.setattr("sysid_evo.plan.executors.POLL_INTERVAL", 60.0)  # s; what has just begun is named as well
    for name in ("json.py", "numpy.py"):
        (call.folder / name).write_text("open('not_ours', 'w')\n")
    (call.folder / "mine.py").write_text(FAMILIES)
    waits, log = call.folder / "waits", call.folder / "out" / "log.jsonl"
    command = ("fit", stored_data, "--plugin", "mine.py", "--models", "linear,waiting", "--out", "out", "--jobs")

    def under_way():
        if not (waits.exists() and waits.read_text() and log.exists() and last in log.read_text()):
            return False
        if jobs > 1:
            os.kill(int(waits.read_text()), signal.SIGINT)  # as a terminal does to the whole group
        return True

    with ctrl_c(under_way):
        stopped = call(*command, str(jobs))
    assert stopped.code == 130
    assert "fit linear" in stopped.stderr
    assert "interrupted: fit waiting" in stopped.stderr
    assert "Unfinished work is not kept; to continue, repeat the command with --out out" in stopped.stderr
    assert "Traceback" not in stopped.stderr
    assert "do not know" not in stopped.stderr
    assert (call.folder / "ran").read_text().count("ran") == {1: 1, 2: 3}[jobs]
    assert not (call.folder / "not_ours").exists()
    files = sorted(file.name.partition("-")[0] for file in (call.folder / "out" / "models").iterdir())
    assert files == ["linear", "linear"]
    if jobs > 1:
        with pytest.raises(ProcessLookupError):
            os.kill(int(waits.read_text()), 0)
    (call.folder / "second").touch()
    assert f"{kept} of 6 steps are done already" in call.works(*command, "1").stderr
    assert len(list((call.folder / "out" / "models").glob("waiting-*.json"))) == 1


def test_ctrl_c_while_the_program_is_being_imported_is_no_traceback():
    ended = subprocess.run([sys.executable, "-c", PRESSED_EARLY], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "")


@pytest.mark.parametrize(
    "command",
    [
        ("record", "--robot", "stuck", "--out", "none"),
        pytest.param(("robots", "check", "stuck"), marks=pytest.mark.nightly),
    ],
)
def test_a_signal_ends_a_command_whose_robot_does_not_answer(command, tmp_path):
    (tmp_path / "mine.py").write_text(ROBOTS)
    running = subprocess.Popen(
        [*COMMAND, *command, "--plugin", "mine.py"], cwd=tmp_path, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + LIMIT
    while not (tmp_path / "stuck").exists():
        assert running.poll() is None, running.communicate()[1]
        assert time.monotonic() < deadline
        time.sleep(0.02)
    running.send_signal(signal.SIGTERM)
    said = running.communicate(timeout=LIMIT)[1]
    assert running.returncode == 143, said
    assert "no answer within 1 s of the signal" in " ".join(said.split())


def test_an_interrupted_recording_is_kept_and_the_exit_code_says_so(call):
    (call.folder / "mine.py").write_text(ROBOTS)
    with ctrl_c(lambda: len(list((call.folder / "car" / "journal").glob("*.rcj"))) == 2):
        done = call("record", "--robot", "slow_car", "--minutes", "2", "--out", "car", "--plugin", "mine.py")
    assert done.code == 130, done.stderr
    assert "the recording was cut short: interrupted" in done.stderr
    assert "loops-forward" in Dataset.load(call.folder / "car").names


@dataclass
class Diary:
    """Which generations were asked, and the one in which Ctrl-C is pressed."""

    asked: list[int] = field(default_factory=list)
    pressed_in: int | None = None


def test_an_interrupted_evolution_is_kept_and_the_same_command_goes_on_to_the_same_champion(
    call, stored_data, register
):
    diary = Diary()

    class Stopped(MuPlusLambda):
        def __init__(self, *, n_parameters: int, seed: int) -> None:
            super().__init__(n_parameters=n_parameters, seed=seed, parents=4, children=4)

        def ask(self):
            diary.asked.append(self.generation)
            if self.generation == diary.pressed_in:
                signal.raise_signal(signal.SIGINT)
            return super().ask()

    register(strategies, "stopped", Stopped)
    budget = (*SMALL, "--generations", "6", "--strategy", "stopped", "--procedure", "plain")
    assert call("fit", stored_data, "--models", "linear", "--out", "out").code == 0
    diary.pressed_in = 3
    stopped = call("evolve", "--run", "out", "--against", "linear", *budget)
    assert stopped.code == 130
    assert stopped.says(
        "interrupted: evolve linear. The 3 of 6 finished generations are kept; to continue, repeat the "
        "command with --run out"
    )
    champions = call.folder / "out" / "controllers"
    assert [file.suffix for file in champions.iterdir()] == [".checkpoint"]
    assert call("runs", "clean", "out").stdout.startswith("0 files")
    diary.pressed_in = None
    assert call("evolve", "--run", "out", "--against", "linear", *budget).code == 0
    assert diary.asked == [0, 1, 2, 3, 3, 4, 5]
    assert sorted(file.suffix for file in champions.iterdir()) == [".json", ".safetensors"]
    (model,) = (call.folder / "out" / "models").glob("linear-*.json")
    (call.folder / "another").mkdir()
    assert call("evolve", "--run", "another", "--against", model, *budget).code == 0
    (one,), (other,) = ((call.folder / run / "controllers").glob("*.safetensors") for run in ("out", "another"))
    assert one.read_bytes() == other.read_bytes()
