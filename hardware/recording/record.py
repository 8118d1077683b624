"""Drives a robot, emulated or real, through manoeuvres into journals, and makes a data set of them."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from hardware.connection import Connectable, Connection, GateLimits
from hardware.control_loop import ControlLoop, Pilot, check_loop
from hardware.estimator import NewestPoseEstimator, StateEstimate
from hardware.recording.journal import JOURNALS, SUFFIX, Recorder, check_journals, read_journal
from hardware.recording.journal_reader import column_names, raw_log
from hardware.recording.manoeuvres import Manoeuvre
from hardware.run_report import LoopReport, StopRequest
from sysid_evo.data import Dataset
from sysid_evo.data.preparation import PreparedLog, RawLog, episodes_of, merged_notes
from sysid_evo.errors import InvalidArgument, InvalidData, LinkLost
from sysid_evo.files import write_atomically
from sysid_evo.progress import Progress
from sysid_evo.system import System
from sysid_evo.types import Array

PAUSE = 2.0  # s in neutral between manoeuvres of a physical robot, so that each begins at rest


@dataclass(frozen=True)
class RecordingResult:
    """Result of a recording: its logs and data set, and the report of its last run."""

    logs: tuple[RawLog, ...]
    dataset: Dataset
    report: LoopReport


@dataclass(frozen=True)
class RecordingJob:
    """Settings of one recording: its seed, the folder of its journals, its stop request, its progress.

    Without a ``folder`` journals are temporary. The same seed gives the same recording on an emulated robot.
    """

    seed: int
    folder: Path | None = None
    stop: StopRequest = field(default_factory=StopRequest)
    progress: Progress | None = None


def record_through_loop(robot: Connectable, manoeuvres: Sequence[Manoeuvre], job: RecordingJob) -> RecordingResult:
    """Drive these manoeuvres through the control loop, and prepare the recording, complete or not.

    Raises `LinkLost` or `InvalidData` if it is too short for a data set.
    """
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary) if job.folder is None else job.folder
        report = record_journals(robot, manoeuvres, place, job)
        logs = read_logs(place, [manoeuvre.name for manoeuvre in manoeuvres])
    try:
        return RecordingResult(tuple(logs), prepare_logs(logs, robot.system), report)
    except InvalidData as error:
        if report.reason.is_fault:
            raise LinkLost(f"{robot.name}: {report.sentence}; {error}") from error
        raise


def record_journals(robot: Connectable, manoeuvres: Sequence[Manoeuvre], folder: Path, job: RecordingJob) -> LoopReport:
    """Drive each manoeuvre through the control loop into a journal of its own, ``folder/NAME.rcj``.

    An emulated robot begins each in a session of its own, drawn from the seed; a physical one stays connected and is at
    rest in neutral for 2 s in between. The first fault ends the recording: the report names it, and the journals keep
    the data up to it. Progress counts control samples. Raises `LinkLost` if the robot cannot be reached; before it
    connects, `InvalidArgument` if one of the journals exists or cannot be created, `IncompatibleSystem` if the loop
    cannot drive the system.
    """
    if not manoeuvres:
        raise InvalidArgument("record: expected at least one manoeuvre, got none")
    check_loop(robot.system)
    check_journals(folder, [manoeuvre.name for manoeuvre in manoeuvres])
    total = sum(len(manoeuvre.controls) for manoeuvre in manoeuvres)
    done, stop = 0, job.stop

    def count(samples: int) -> None:
        if job.progress is not None:
            job.progress(done + samples, total)

    # Journals wait for the disk when they close, which may take longer than the time to live of a command.
    with ExitStack() as journals, ExitStack() as stack:
        connection: Connection | None = None
        for number, manoeuvre in enumerate(manoeuvres):
            if connection is None or robot.dynamics is not None:
                stack.close()
                own = np.random.SeedSequence(job.seed, spawn_key=(number,)).generate_state(1, np.uint64)
                with stop.answer(robot.name, math.inf):
                    connection = stack.enter_context(robot.connect(seed=int(own[0])))
            else:
                rest = Manoeuvre("rest", np.tile(robot.system.neutral_control, (round(PAUSE / robot.system.dt), 1)))
                report = _run(connection, robot, ManoeuvrePilot(rest), (), stop)
                if report.reason.is_fault:
                    return report
            path = folder / f"{manoeuvre.name}{SUFFIX}"
            recorder = journals.enter_context(
                Recorder(path, robot.system, robot=robot.name, limits=connection.gate_limits)
            )
            report = _run(connection, robot, ManoeuvrePilot(manoeuvre, count), (recorder,), stop)
            if recorder.problem is not None:
                raise InvalidData(f"the recording has gaps, {recorder.lost} records are lost: {recorder.problem}")
            if report.reason.is_fault:
                return report
            done += len(manoeuvre.controls)
    return report


class ManoeuvrePilot(Pilot):
    """Sends the controls of a manoeuvre one by one, whatever the robot does."""

    def __init__(self, manoeuvre: Manoeuvre, on_decision: Callable[[int], None] | None = None) -> None:
        self._controls = manoeuvre.controls
        self._on_decision = on_decision

    def decide(self, tick: int, estimate: StateEstimate) -> Array | None:
        if self._on_decision is not None:
            self._on_decision(min(tick, len(self._controls)))
        return self._controls[tick] if tick < len(self._controls) else None


def _run(
    connection: Connection, robot: Connectable, pilot: Pilot, listeners: Sequence[Recorder], stop: StopRequest
) -> LoopReport:
    estimator = NewestPoseEstimator(robot.system)
    return ControlLoop(connection, robot.system, listeners=listeners, estimator=estimator, stop=stop).run(pilot)


def read_logs(folder: Path, names: Iterable[str], limits: GateLimits | None = None) -> list[RawLog]:
    """Return the raw logs of the journals of these manoeuvres, without those that contain no run.

    ``limits`` are those of another gate than the one in a journal.
    """
    logs = []
    for name in names:
        path = folder / f"{name}{SUFFIX}"
        if path.is_file():
            try:
                logs.append(raw_log(read_journal(path), limits)[0])
            except InvalidData:
                continue
    return logs


def prepare_logs(logs: Sequence[RawLog], system: System) -> Dataset:
    """Return the data set of ``logs``; a note names each that is too short. Raises `InvalidData` if all are."""
    made: list[PreparedLog] = []
    left_out: list[str] = []
    for log in logs:
        try:
            made.append(episodes_of(log, system))
        except InvalidData as error:
            left_out.append(f"left out: {error}")
    episodes = [episode for one in made for episode in one.episodes]
    notes = [*left_out, *merged_notes(made)]
    if not episodes:
        raise InvalidData("\n".join(["the recording is too short for a data set:", *notes]))
    return Dataset(system, tuple(episodes), tuple(notes))


def store_journals(folder: Path, runs: Iterable[tuple[str, GateLimits | None]], system: System) -> Dataset | None:
    """Store the journals of these runs in ``folder`` as CSV (``raw/``) and as a data set, which is returned.

    Each run has a name, and limits of another gate than the one in its journal. None if no journal contains a run.
    Raises `InvalidData` if all are too short.
    """
    logs = [log for name, limits in runs for log in read_logs(folder / JOURNALS, [name], limits)]
    if not logs:
        return None
    for log in logs:
        save_raw_log(log, system, folder / "raw" / f"{log.name}.csv")
    dataset = prepare_logs(logs, system)
    dataset.save(folder)
    return dataset


def save_raw_log(log: RawLog, system: System, path: str | Path) -> Path:
    """Write ``log`` as CSV: ``t`` in s, then pose, controls and other columns under the names of ``system``."""
    header = ",".join((*column_names(system), *log.extra))
    table = np.column_stack([log.time, log.pose, log.controls, *log.extra.values()])

    write = partial(np.savetxt, X=table, fmt="%.9g", delimiter=",", header=header, comments="")
    return write_atomically(Path(path), write)
