"""A journal as a raw log (plausible poses, command in force) and as a table for import."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hardware.connection import TIME_TO_LIVE, GateLimits, Measurement
from hardware.gate import PoseGate
from hardware.recording.journal import SUFFIX, Journal, TimedCommand, read_journal
from sysid_evo.data.preparation import MAX_GAP, RawLog
from sysid_evo.data.readers import Reader, Table
from sysid_evo.errors import InvalidData, did_you_mean
from sysid_evo.registry import register_reader
from sysid_evo.system import System
from sysid_evo.types import Array, IntArray


@register_reader("journal")
class JournalReader(Reader):
    """A recorder's journal as a table: ``t``, the pose and the controls under the names of its system.

    Rows are numbered by frame, from 1; frames that the gate rejects are left out.
    """

    suffixes = (SUFFIX,)

    def header(self, path: Path) -> tuple[str, ...]:
        return column_names(read_journal(path).system)

    def read(self, path: Path, columns: Sequence[str]) -> Table:
        journal = read_journal(path)
        names = column_names(journal.system)
        for name in columns:
            if name not in names:
                hint = did_you_mean(name, names)
                raise InvalidData(
                    f"{path.name}: column {name!r} is missing.{hint} The journal has: {', '.join(names)}."
                )
        log, rows = raw_log(journal)
        values = np.column_stack([log.time, log.pose, log.controls])
        data = {name: values[:, names.index(name)].copy() for name in columns}
        return Table(path, rows, data)


def column_names(system: System) -> tuple[str, ...]:
    """Return the columns of a raw log: ``t`` in s, the pose, the controls."""
    pose_names = () if system.motion is None else system.motion.pose_names
    return ("t", *pose_names, *system.control_names)


BREAK = 3.0
"""Periods of the tracker that are left out where a track breaks: the preparation bridges up to 2.5."""
CLOCK_TOLERANCE = 1e-6  # s


def raw_log(journal: Journal, limits: GateLimits | None = None) -> tuple[RawLog, IntArray]:
    """Return the run in ``journal``, from its first tick, as rows of poses and commands in force.

    Also return the numbers (N,) of its frames in the journal, counted from 1.

    The frames pass the same gate as in the loop, or one of other ``limits``; rejected ones are left out. Where a track
    breaks, enough further frames are left out for the preparation to split there. A command is in force from its time
    of sending until the next, for 150 ms at most. Raises `InvalidData` if there are fewer than two rows.
    """
    commands = [event.command for event in journal.commands]
    if commands and isinstance(journal.events[-1], TimedCommand):
        commands.pop()  # the neutral command at the end of a run acts on none of its frames
    begin = next((command.time for command in commands if command.tick >= 0), None)
    if begin is None:
        raise InvalidData(f"{journal.name}: expected a run, but no command was sent; the robot was never driven")
    frames, numbers, broke = _accepted(journal, begin, limits)
    if len(frames) < 2:
        raise InvalidData(f"{journal.name}: expected at least two plausible frames, got {len(frames)}")
    time = np.array([frame.source_time for frame in frames])
    kept = _apart(time, broke)
    time, numbers = time[kept], numbers[kept]
    pose = np.array([frame.pose for frame in frames])[kept]
    sent = np.array([command.time for command in commands])
    newest = np.searchsorted(sent, time + CLOCK_TOLERANCE, side="right") - 1
    controls = np.array([command.control for command in commands])[newest]
    controls[time - sent[newest] > TIME_TO_LIVE + CLOCK_TOLERANCE] = journal.system.neutral_control
    return RawLog(journal.name, time - time[0], pose, controls), numbers


def _accepted(
    journal: Journal, begin: float, limits: GateLimits | None
) -> tuple[list[Measurement], IntArray, list[bool]]:
    """Return the accepted frames from ``begin``, their numbers, and which of them begin a track."""
    gate = PoseGate(None, journal.limits if limits is None else limits)
    neutral = journal.system.neutral_control
    driving, number = False, 0
    frames: list[Measurement] = []
    numbers: list[int] = []
    broke: list[bool] = []
    for event in journal.events:
        if isinstance(event, TimedCommand):
            driving = not np.array_equal(event.command.control, neutral)
        elif isinstance(event, Measurement):
            number += 1
            verdict = gate.accept(event, driving=driving)
            if verdict.accepted and event.source_time >= begin - CLOCK_TOLERANCE:
                frames.append(event)
                numbers.append(number)
                broke.append(verdict.new_track)
    return frames, np.array(numbers, dtype=np.int64), broke


def _apart(time: Array, broke: list[bool]) -> IntArray:
    """Return the rows that leave a gap before each break that no preparation bridges."""
    hole = max(MAX_GAP, BREAK * float(np.median(np.diff(time)))) + CLOCK_TOLERANCE
    kept: list[int] = []
    barrier = -np.inf
    for row, new in enumerate(broke):
        if new and kept:
            barrier = time[kept[-1]] + hole
        if time[row] > barrier:
            kept.append(row)
    return np.array(kept, dtype=np.int64)
