"""Drives a robot through manoeuvres and writes down what the tracker sees."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hardware.measurement import Measurement
from hardware.recording.excitation import Manoeuvre, excitation
from hardware.robot import Connection, Robot
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.data.raw import RawLog
from sysid_evo.errors import LinkLost
from sysid_evo.files import write_atomically
from sysid_evo.progress import Progress
from sysid_evo.registry import make_robot
from sysid_evo.system import System

SILENCE = 1.0  # s without a valid frame after which a recording is given up
COMMAND_LIFE = 4  # samples for which a command stays valid, should the recorder hang
CLOCK_TOLERANCE = 1e-6  # s


def record(
    robot: Robot, manoeuvres: Sequence[Manoeuvre], *, seed: int, progress: Progress | None = None
) -> list[RawLog]:
    """Drive each manoeuvre in a session of its own and return one log for each.

    Rows are the tracker's frames, with the command in force from the frame on; frames that lost the
    body are left out. ``progress`` counts control samples. Raises `LinkLost`.
    """
    total = sum(len(manoeuvre.controls) for manoeuvre in manoeuvres)
    done, logs = 0, []
    for number, manoeuvre in enumerate(manoeuvres):
        session = int(np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(1, np.uint64)[0])
        with robot.connect(seed=session) as connection:
            log = _Log(connection, robot.system)
            for control in manoeuvre.controls:
                log.drive(control)
                done += 1
                if progress is not None:
                    progress(done, total)
        logs.append(log.finish(manoeuvre.name))
    return logs


def record_dataset(
    robot: str, *, seed: int, duration: float, progress: Progress | None = None
) -> tuple[list[RawLog], Dataset]:
    """Record the excitation of ``duration`` s on a registered robot; return the logs and the prepared data set.

    The same seed gives the same manoeuvres and, on an emulated robot, the same recording.
    """
    from sysid_evo.data.preparation import prepare

    machine = make_robot(robot)
    manoeuvres = excitation(machine.system, duration=duration, rng=np.random.default_rng(seed))
    logs = record(machine, manoeuvres, seed=seed, progress=progress)
    episodes: list[Trajectory] = []
    notes: list[str] = []
    for log in logs:
        prepared = prepare(log, machine.system)
        episodes.extend(prepared.episodes)
        notes.extend(note for note in prepared.notes if note not in notes)
    return logs, Dataset(machine.system, tuple(episodes), tuple(notes))


def save_raw(log: RawLog, system: System, path: str | Path) -> Path:
    """Write ``log`` as CSV: ``t`` in s, then the pose and the controls under the names of ``system``."""
    pose_names = () if system.motion is None else system.motion.pose_names
    header = ",".join(("t", *pose_names, *system.control_names))
    table = np.column_stack([log.time, log.pose, log.controls])

    def write(file: Path) -> None:
        np.savetxt(file, table, fmt="%.9g", delimiter=",", header=header, comments="")

    return write_atomically(Path(path), write)


class _Log:
    """The rows of one session while it is driven."""

    def __init__(self, connection: Connection, system: System) -> None:
        self._connection = connection
        self._system = system
        self._control = system.neutral_control
        self._rows: list[tuple[Measurement, Array]] = []
        self._ticks = 0
        self._last = self._frame()
        self._seen = self._last.source_time
        while not self._last.valid:
            self._advance()
        self._begin = self._seen

    def drive(self, control: Array) -> None:
        """Command ``control`` and take in frames until the next sample is due."""
        self._connection.send(control, valid_for=COMMAND_LIFE * self._system.dt)
        self._control = control
        self._ticks += 1
        due = self._begin + self._ticks * self._system.dt - CLOCK_TOLERANCE
        while self._last.source_time < due:
            self._append()
            self._advance()

    def finish(self, name: str) -> RawLog:
        """Return the log, with the frame at the end of the last command."""
        self._append()
        time = np.array([frame.source_time for frame, _ in self._rows]) - self._begin
        pose = np.array([frame.pose for frame, _ in self._rows])
        return RawLog(name, time, pose, np.array([control for _, control in self._rows]))

    def _append(self) -> None:
        if self._last.valid:
            self._rows.append((self._last, self._control))

    def _advance(self) -> None:
        self._last = self._frame()
        if self._last.valid:
            self._seen = self._last.source_time
        elif self._last.source_time - self._seen > SILENCE:
            raise LinkLost(
                f"the tracker has not seen {self._last.body!r} for {SILENCE} s: check its markers and the area"
            )

    def _frame(self) -> Measurement:
        frame = self._connection.measure(SILENCE)
        if frame is None:
            raise LinkLost(f"no frame from the tracker within {SILENCE} s: is it running and streaming?")
        return frame
