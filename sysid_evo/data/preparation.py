"""A raw log becomes episodes: row by row, or by clock, differentiation, filter and decimation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from sysid_evo.data.trajectory import Trajectory
from sysid_evo.errors import InvalidArgument, InvalidData, ShapeError
from sysid_evo.system import System
from sysid_evo.types import Array, BoolArray, IntArray, check_shape


@dataclass(frozen=True)
class RawLog:
    """N rows of one recording, before preparation.

    ``time`` (N,) in s; ``pose`` (N, n_pose) in the units of the system's motion; ``controls``
    (N, nu): the command in force from this row on; ``extra``: other columns (N,), by name; ``condition``: the name of
    the condition in which each row was recorded (N,), or None.
    """

    name: str
    time: Array
    pose: Array
    controls: Array
    extra: Mapping[str, Array] = field(default_factory=dict)
    condition: npt.NDArray[np.str_] | None = None

    def __post_init__(self) -> None:
        time = check_shape(f"time of {self.name!r}", self.time, (None,))
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "pose", check_shape(f"pose of {self.name!r}", self.pose, (len(time), None)))
        object.__setattr__(
            self, "controls", check_shape(f"controls of {self.name!r}", self.controls, (len(time), None))
        )
        for name, column in self.extra.items():
            check_shape(f"{name} of {self.name!r}", column, (len(time),))
        if self.condition is not None and self.condition.shape != time.shape:
            raise ShapeError(f"condition of {self.name!r}: expected shape {time.shape}, got {self.condition.shape}")

    @property
    def changes(self) -> BoolArray:
        """Where the next row is of another condition, (N - 1,)."""
        if self.condition is None:
            return np.zeros(len(self.time) - 1, dtype=bool)
        found: BoolArray = self.condition[1:] != self.condition[:-1]
        return found

    def condition_at(self, row: int) -> str:
        """Return the condition of a row, "" if none is known."""
        return "" if self.condition is None else str(self.condition[row])


@dataclass(frozen=True)
class PreparedLog:
    """The episodes of the log ``name``, and what was done to it, in sentences that do not name it."""

    name: str
    episodes: tuple[Trajectory, ...]
    notes: tuple[str, ...]


def episodes_of(log: RawLog, system: System) -> PreparedLog:
    """Return the episodes of ``log``: row by row if it is at the control rate, else filtered, see `prepare`."""
    return rows_as_episodes(log, system) if at_control_rate(log, system) else prepare(log, system)


RATE_TOLERANCE = 0.2
"""How far the rows of a log may be from ``dt``, as a share of it, to be taken one by one."""

SHORTEST, LONGEST = 0.5, 1.5
"""Steps that may stand for one ``dt``, in units of it. A lost row makes 2: taken as one step it would
teach two steps as one."""

TOLD = 1e-3
"""Steps off by less than this share of ``dt`` are not worth a word."""


def at_control_rate(log: RawLog, system: System) -> bool:
    """Return whether the log has every state and its rows are within 20 % of ``dt`` apart."""
    has_states = all(name in log.extra for name in system.state_names)
    return has_states and bool(abs(np.median(np.diff(log.time)) / system.dt - 1.0) <= RATE_TOLERANCE)


def rows_as_episodes(log: RawLog, system: System) -> PreparedLog:
    """Make episodes whose samples are the rows of ``log``, its clock replaced by ``system.dt``.

    ``log.extra`` must hold every state by its name. A step outside 0.5 to 1.5 dt or into another condition splits the
    log into pieces called ``name[first:last]`` (rows from 0); a piece of one row is left out. Raises
    `InvalidData`.
    """
    missing = [name for name in system.state_names if name not in log.extra]
    if missing:
        raise InvalidData(f"{log.name}: states {', '.join(missing)} are not among the columns of the log")
    pose = checked_pose(log, system)
    states = np.stack([log.extra[name] for name in system.state_names], axis=1)
    steps = np.diff(log.time)
    broken = (steps < SHORTEST * system.dt) | (steps > LONGEST * system.dt)
    runs = contiguous_rows(broken | log.changes)
    episodes = [
        Trajectory(
            states=states[rows],
            controls=log.controls[rows][:-1],
            dt=system.dt,
            pose=pose[rows] if pose.size else None,
            name=log.name if len(runs) == 1 else f"{log.name}[{rows.start}:{rows.stop - 1}]",
            condition=log.condition_at(rows.start),
        )
        for rows in runs
        if rows.stop - rows.start > 1
    ]
    if not episodes:
        raise InvalidData(
            f"{log.name}: expected rows {system.dt:g} s apart, but no two of them are within 0.5 to 1.5 of that; "
            f"the steps are {steps.min():.3g} to {steps.max():.3g} s"
        )
    kept = 1e3 * steps[~broken]
    measured = (
        f"; their stamps are {kept.min():.1f} to {kept.max():.1f} ms apart (mean {kept.mean():.2f} ms)"
        if np.abs(kept - 1e3 * system.dt).max() > TOLD * 1e3 * system.dt
        else ""
    )
    notes = [f"rows taken as samples every {system.dt * 1e3:g} ms{measured}"]
    if len(runs) > 1:
        changes = f" and {int(log.changes.sum())} changes of condition" if log.changes.any() else ""
        notes.append(
            f"{int(broken.sum())} steps outside {SHORTEST * system.dt * 1e3:g} to "
            f"{LONGEST * system.dt * 1e3:g} ms{changes} split it into {len(episodes)} pieces; "
            f"{len(runs) - len(episodes)} single rows left out"
        )
    return PreparedLog(log.name, tuple(episodes), tuple(notes))


CUTOFF = 0.3
"""Default cut-off (half amplitude), in units of the control rate: 6 Hz at 20 Hz.

Nothing may pass above half the control rate, or decimation folds it back. With a cut-off of 6 Hz
the amplitude is right to 0.5 % up to 2 Hz, 4 % low at 3 Hz, 13 % low at 4 Hz and below 0.4 % from
10 Hz on. A toy car (motor and steering lags of 60-80 ms) moves below 3 Hz; above 5 Hz a
differentiated marker position is mostly noise.
"""
ATTENUATION = 50.0
"""Of all that lies above half the control rate, in dB."""

MAX_GAP = 0.025
"""Longest hole in a log that is bridged by a straight line, in s.

A line over a hole g under an acceleration a is off by at most a g^2 / 8: 0.4 mm at 5 m/s2. In a
log slower than 100 Hz, 2.5 periods are bridged, so that it may miss one row.
"""
MIN_RATIO = 3
"""Rows that a log needs for each control period, so that there is something to filter."""

STENCIL = np.array([-1.0, 8.0, 0.0, -8.0, 1.0]) / 12.0
"""Five-point central difference, to convolve with: amplitude error (omega h)^4 / 30, no delay."""
REACH = len(STENCIL) // 2


def prepare(log: RawLog, system: System, *, cutoff: float | None = None, max_gap: float | None = None) -> PreparedLog:
    """Make episodes of ``system`` from a log with at least three rows for each ``system.dt``.

    The order matters. Turning before filtering keeps every steady turn exact, whatever the cut-off, because its
    velocities are constant only in the body frame; a filter in the world frame would slow down a turning body. Source:
    paper, section 3 (200 Hz, FIR with its delay taken out, 20 Hz).

    The pose is put on a uniform clock (linear interpolation), differentiated over five points,
    turned into the body frame and low-pass filtered with linear phase and no delay left; ``cutoff``
    is in Hz (default 0.3 / dt). Then every n-th sample is taken. States that stand in ``log.extra``
    under their names are not derived from the pose, only filtered. Controls are held: each tick has
    the command of the last row up to half a row after it. A hole longer than ``max_gap`` seconds
    (default 0.025, or 2.5 rows if that is longer) splits the log, and so does a change of condition. Each piece loses
    half a filter length at both ends, because nothing is made up beyond them.

    Raises `InvalidData`, `InvalidArgument`, or `ShapeError`.
    """
    pose = checked_pose(log, system)
    steps = np.diff(log.time)
    period = float(np.median(steps))
    ratio = round(system.dt / period)
    if ratio < MIN_RATIO:
        raise InvalidData(
            f"{log.name}: expected at least {MIN_RATIO} rows for each control period of {system.dt:g} s, but rows are "
            f"{period:.4g} s apart. Log faster, raise dt to {MIN_RATIO * period:.3g} s, or log every state and set dt "
            f"to {period:.4g} s."
        )
    step = system.dt / ratio
    cutoff = CUTOFF / system.dt if cutoff is None else cutoff
    max_gap = max(MAX_GAP, 2.5 * period) if max_gap is None else max_gap
    taps = low_pass(cutoff, 1.0 / step, 0.5 / system.dt)
    margin = REACH + len(taps) // 2
    clock = fit_clock(log.time, pose[:, :2], step) if pose.size else Clock(log.time, step)
    runs = contiguous_rows((steps > max_gap) | log.changes)
    episodes = []
    for rows in runs:
        samples = clock.samples(rows)
        first, last = -(-(samples[0] + margin) // ratio), (samples[-1] - margin) // ratio
        if last <= first:
            continue
        ticks = np.arange(first, last + 1) * ratio
        trace = clock.interpolate(pose, rows, samples)
        signals = _signals(log, system, trace, clock, rows, samples)
        smooth = np.stack([np.convolve(signal, taps, mode="valid") for signal in signals.T], axis=1)
        episodes.append(
            Trajectory(
                states=smooth[ticks - samples[0] - margin],
                controls=clock.hold(log.controls, rows, ticks[:-1]),
                dt=system.dt,
                pose=trace[ticks - samples[0]] if pose.size else None,
                name=log.name if len(runs) == 1 else f"{log.name}[{first}:{last}]",
                condition=log.condition_at(rows.start),
            )
        )
    if not episodes:
        raise InvalidData(
            f"{log.name}: expected a stretch of more than {2 * margin * step + system.dt:.2f} s (the filter and one "
            f"step) without a hole over {max_gap * 1e3:.0f} ms; the longest hole is {steps.max():.3g} s"
        )
    derived = [name for name in system.state_names if name not in log.extra]
    how = f"{', '.join(derived)} from the pose (5-point differences in the body frame); " if derived else ""
    notes = [
        f"{how}{len(taps)}-tap low-pass at {cutoff:g} Hz without delay, {1 / step:g} Hz taken down to "
        f"{1 / system.dt:g} Hz; controls held; {margin * step:.2f} s left out at both ends of each piece",
        *([clock.note] if clock.note else []),
        *_holes(steps, period, max_gap, int(log.changes.sum()), len(runs) - len(episodes)),
    ]
    return PreparedLog(log.name, tuple(episodes), tuple(notes))


def _holes(steps: Array, period: float, max_gap: float, changes: int, left_out: int) -> list[str]:
    bridged = steps[(steps > 1.5 * period) & (steps <= max_gap)]
    splits = int((steps > max_gap).sum())
    notes = []
    if len(bridged):
        notes.append(f"{len(bridged)} holes of up to {bridged.max() * 1e3:.0f} ms bridged by straight lines")
    if splits or changes:
        short = f"; {left_out} pieces shorter than the filter left out" if left_out else ""
        where = [f"{splits} holes of up to {steps.max():.3g} s"] * bool(splits)
        where += [f"{changes} changes of condition"] * bool(changes)
        notes.append(f"split at {' and '.join(where)}{short}")
    return notes


def low_pass(cutoff: float, rate: float, stop: float) -> Array:
    """Return an odd number of symmetric taps for a log at ``rate``, all in Hz.

    The gain is a half at ``cutoff`` and under -50 dB from ``stop`` on: the ideal filter under a Kaiser window, whose
    length and shape follow from Kaiser's formulas (Oppenheim and Schafer, section 7.6). Raises `InvalidArgument`
    unless 0 < cutoff < stop. Importing `scipy.signal`, which has the same, takes a second.
    """
    if not 0.0 < cutoff < stop:
        raise InvalidArgument(
            f"cutoff: expected more than 0 and less than half the control rate, {stop:g} Hz; got {cutoff:g} Hz"
        )
    width = min(2.0 * (stop - cutoff), 1.5 * cutoff)
    count = math.ceil((ATTENUATION - 7.95) / (2.285 * np.pi * width / (0.5 * rate))) + 1
    half = (count | 1) // 2
    shape = 0.5842 * (ATTENUATION - 21.0) ** 0.4 + 0.07886 * (ATTENUATION - 21.0)
    place, share = np.arange(-half, half + 1), cutoff / (0.5 * rate)
    taps: Array = share * np.sinc(share * place) * np.kaiser(len(place), shape)
    return taps / taps.sum()


def checked_pose(log: RawLog, system: System) -> Array:
    """Return the pose (N, n_pose) with continuous angles, after checking the log against ``system``.

    Raises `ShapeError` if the log has other controls or another pose than the system, `InvalidData`
    if time does not rise or a number is not finite.
    """
    if log.controls.shape[1] != system.nu or log.pose.shape[1] not in (0, system.n_pose):
        raise ShapeError(
            f"{log.name}: expected {system.nu} controls and {system.n_pose} pose coordinates as the system has, "
            f"got {log.controls.shape[1]} and {log.pose.shape[1]}"
        )
    if len(log.time) < 2 or not (np.diff(log.time) > 0).all():
        raise InvalidData(f"{log.name}: expected two or more rows with rising time stamps")
    if not (np.isfinite(log.pose).all() and np.isfinite(log.controls).all()):
        raise InvalidData(f"{log.name}: expected finite poses and controls")
    if not log.pose.shape[1] or system.motion is None:
        return log.pose
    units = system.motion.pose_units
    return np.stack(
        [np.unwrap(column) if unit == "rad" else column for column, unit in zip(log.pose.T, units, strict=True)], axis=1
    )


def _signals(log: RawLog, system: System, pose: Array, clock: Clock, rows: slice, samples: IntArray) -> Array:
    """Return every state (N - 4, nx) on the uniform clock, before the filter."""
    derived: dict[str, Array] = {}
    if system.motion is not None and pose.size and not log.extra.keys() >= set(system.state_names):
        rate = np.stack([np.convolve(column, STENCIL, mode="valid") for column in pose.T], axis=1) / clock.step
        derived = system.motion.velocities(pose[REACH:-REACH], rate)
    columns = []
    periods = {channel.name: channel.period for channel in system.states}
    for name in system.state_names:
        if name in log.extra:
            period, values = periods.get(name), log.extra[name]
            smooth = values if period is None else np.unwrap(values, period=period)
            columns.append(clock.interpolate(smooth[:, None], rows, samples)[REACH:-REACH, 0])
        elif name in derived:
            columns.append(derived[name])
        else:
            raise InvalidData(
                f"{log.name}: state {name!r} is neither a velocity of the pose nor among the other columns "
                f"({', '.join(log.extra) or 'none'})"
            )
    return np.stack(columns, axis=1)


UNIFORM = 0.01
"""Stamps off by less than this share of a period need no interpolation worth mentioning."""


@dataclass(frozen=True)
class Clock:
    """Sample s of the uniform clock is at ``times[0] + s * step`` (s); ``times`` (N,) are the log's rows.

    ``note`` says how the times came about if they are not simply the stamps of a uniform log.
    """

    times: Array
    step: float
    note: str = ""

    def samples(self, rows: slice) -> IntArray:
        """Return the samples that lie within these rows."""
        place = (self.times[rows] - self.times[0]) / self.step
        return np.arange(np.ceil(place[0] - UNIFORM), np.floor(place[-1] + UNIFORM) + 1, dtype=np.int64)

    def interpolate(self, values: Array, rows: slice, samples: IntArray) -> Array:
        """Return ``values`` (N, c) at the samples, on straight lines between these rows."""
        at = self.times[0] + samples * self.step
        columns = [np.interp(at, self.times[rows], column) for column in values[rows].T]
        return np.stack(columns, axis=1) if columns else np.empty((len(samples), 0))

    def hold(self, values: Array, rows: slice, samples: IntArray) -> Array:
        """Return ``values`` (N, c) as they are held at the samples: of the last row up to half a step after each."""
        at = self.times[0] + (samples + 0.5) * self.step
        return values[rows][np.searchsorted(self.times[rows], at, side="right") - 1]


def fit_clock(stamps: Array, positions: Array, step: float) -> Clock:
    """Return the clock of a log: its stamps as they are, or a steady clock through them.

    A tracker takes its frames at a steady rate, but many loggers stamp them when they arrive. A late
    stamp then looks like a wrong position. The ``positions`` (N, any) tell which clock is right: on it
    they move more smoothly. ``stamps`` (N,) and ``step`` are in s.
    """
    since = (stamps - stamps[0]) / step
    if np.abs(since - np.round(since)).max() < UNIFORM:
        return Clock(stamps, step)
    period = float(np.median(np.diff(stamps)))
    frames = np.concatenate([[0.0], np.cumsum(np.maximum(1.0, np.round(np.diff(stamps) / period)))])
    rate, start = np.polyfit(frames, stamps, 1)
    steady = start + rate * frames
    scatter = stamps - steady
    told = f"time stamps scatter by {1e3 * scatter.std():.2g} ms around a steady {1.0 / rate:.1f} Hz"
    if np.abs(scatter).max() < 0.5 * period and _roughness(positions, steady) < _roughness(positions, stamps):
        return Clock(steady, step, f"{told} and the pose moves more smoothly on the steady clock, which is used")
    return Clock(stamps, step, f"{told}; the pose is interpolated linearly onto a uniform clock")


def contiguous_rows(breaks: BoolArray) -> list[slice]:
    """Return the runs of rows between ``breaks`` (N - 1,), which are true where row k + 1 begins a new run."""
    edges = [0, *(np.flatnonzero(breaks) + 1).tolist(), len(breaks) + 1]
    return [slice(first, last) for first, last in pairwise(edges)]


def _roughness(positions: Array, times: Array) -> float:
    velocities = np.diff(positions, axis=0) / np.diff(times)[:, None]
    return float(np.sum(np.diff(velocities, axis=0) ** 2))


LISTED = 4
"""Logs that a note names."""


def said_once(prepared: Sequence[PreparedLog]) -> list[str]:
    """Return the notes of all logs, each once and with the names of its logs before it."""
    logs: dict[str, list[str]] = {}
    for one in prepared:
        for note in one.notes:
            logs.setdefault(note, []).append(one.name)
    return [f"{_listed(names, len(prepared))}: {note}" for note, names in logs.items()]


def _listed(names: Sequence[str], logs: int) -> str:
    if len(names) == logs > 1:
        return "both logs" if logs == 2 else f"all {logs} logs"
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return ", ".join(names[:LISTED]) + more
