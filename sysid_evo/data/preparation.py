"""Preparation of raw logs: row by row, or by resampling, differentiation, filter and decimation."""

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
    the condition in which each row was recorded (N,), or None; ``rates``: the column that is differentiated for a state
    that has none, by the name of the state.
    """

    name: str
    time: Array
    pose: Array
    controls: Array
    extra: Mapping[str, Array] = field(default_factory=dict)
    condition: npt.NDArray[np.str_] | None = None
    rates: Mapping[str, str] = field(default_factory=dict)

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
        """A mask (N - 1,) of the rows whose next row has another condition."""
        if self.condition is None:
            return np.zeros(len(self.time) - 1, dtype=bool)
        found: BoolArray = self.condition[1:] != self.condition[:-1]
        return found

    def condition_at(self, row: int) -> str:
        """Return the condition of a row, "" without one."""
        return "" if self.condition is None else str(self.condition[row])


@dataclass(frozen=True)
class PreparedLog:
    """The episodes of the log ``name``, and notes on its preparation, which do not contain the name."""

    name: str
    episodes: tuple[Trajectory, ...]
    notes: tuple[str, ...]


def episodes_of(log: RawLog, system: System) -> PreparedLog:
    """Return the episodes of ``log``: row by row if it is at the control rate, else filtered, see `prepare`."""
    return rows_as_episodes(log, system) if at_control_rate(log, system) else prepare(log, system)


RATE_TOLERANCE = 0.2
"""Largest deviation of the time between rows from ``dt``, as a share of it, for a log that is used row by row."""

SHORTEST, LONGEST = 0.5, 1.5
"""Range of steps that count as one ``dt``, in units of it. A lost row makes a step of 2, which must not count as 1."""

REPORTED = 1e-3
"""Smaller deviations of steps from ``dt``, as a share of it, are not reported."""


def at_control_rate(log: RawLog, system: System) -> bool:
    """Return whether the log has every state and the time between its rows is within 20 % of ``dt``."""
    has_states = all(name in log.extra for name in system.state_names)
    return has_states and bool(abs(np.median(np.diff(log.time)) / system.dt - 1.0) <= RATE_TOLERANCE)


def rows_as_episodes(log: RawLog, system: System) -> PreparedLog:
    """Return episodes whose samples are the rows of ``log``, with its clock replaced by ``system.dt``.

    ``log.extra`` must hold every state by its name. A step outside 0.5 to 1.5 dt or into another condition splits the
    log into parts named ``name[first:last]`` (rows from 0); single rows are left out. Raises `InvalidData`.
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
            controls=system.controls_of_steps(log.controls[rows]),
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
    used = 1e3 * steps[~broken]
    measured = (
        f"; their stamps are {used.min():.1f} to {used.max():.1f} ms apart (mean {used.mean():.2f} ms)"
        if np.abs(used - 1e3 * system.dt).max() > REPORTED * 1e3 * system.dt
        else ""
    )
    notes = [f"rows taken as samples every {system.dt * 1e3:g} ms{measured}"]
    if len(runs) > 1:
        changes = f" and {int(log.changes.sum())} changes of condition" if log.changes.any() else ""
        notes.append(
            f"{int(broken.sum())} steps outside {SHORTEST * system.dt * 1e3:g} to "
            f"{LONGEST * system.dt * 1e3:g} ms{changes} split it into {len(episodes)} parts; "
            f"{len(runs) - len(episodes)} single rows left out"
        )
    return PreparedLog(log.name, tuple(episodes), tuple(notes))


CUTOFF = 0.3
"""Default cut-off (half amplitude), in units of the control rate: 6 Hz at 20 Hz.

Frequencies above half the control rate would cause aliasing. With a cut-off of 6 Hz the amplitude error is 0.5 % up to
2 Hz, 4 % at 3 Hz and 13 % at 4 Hz; the gain is below 0.4 % from 10 Hz on. A toy car (motor and steering lags of
60-80 ms) moves below 3 Hz; above 5 Hz a differentiated marker position is mostly noise.
"""
ATTENUATION = 50.0
"""Attenuation of frequencies above half the control rate, in dB."""

MAX_GAP = 0.025
"""Longest gap in a log that is bridged by linear interpolation, in s.

Over a gap g under an acceleration a the error is at most a g^2 / 8: 0.4 mm at 5 m/s2. In a log
slower than 100 Hz, 2.5 periods are bridged, so that one row may be missing.
"""
MIN_RATIO = 3
"""Least number of rows per control period of a log that is filtered."""

STENCIL = np.array([-1.0, 8.0, 0.0, -8.0, 1.0]) / 12.0
"""Five-point central difference, to convolve with: amplitude error (omega h)^4 / 30, no delay."""
REACH = len(STENCIL) // 2


def prepare(log: RawLog, system: System, *, cutoff: float | None = None, max_gap: float | None = None) -> PreparedLog:
    """Return episodes of ``system`` from a log with at least three rows for each ``system.dt``.

    The pose is resampled to a uniform clock (linear interpolation), differentiated over five points, rotated into the
    body frame and low-pass filtered without phase delay; ``cutoff`` is in Hz (default 0.3 / dt). Then every n-th
    sample is used. States in ``log.extra`` are only filtered. Controls are held: each sample has the command of the
    last row up to half a row after it. A gap longer than ``max_gap`` seconds (default 0.025, or 2.5 rows if that is
    longer) splits the log, and so does a change of condition. Each part loses half a filter length at both ends.

    The rotation comes before the filter, so that steady turns are exact for any cut-off: their velocities are constant
    only in the body frame, and a filter in the world frame would reduce them. Source: paper, section 3 (200 Hz, FIR
    with compensated delay, 20 Hz).

    Raises `InvalidData`, `InvalidArgument`, or `ShapeError`.
    """
    pose = checked_pose(log, system)
    steps = np.diff(log.time)
    period = float(np.median(steps))
    ratio = round(system.dt / period)
    lacking = [name for name in system.state_names if name not in log.extra]
    if ratio < MIN_RATIO:
        columns = f"log {', '.join(lacking)} and set dt" if lacking else "set dt"
        raise InvalidData(
            f"{log.name}: expected at least {MIN_RATIO} rows for each control period of {system.dt:g} s, but rows are "
            f"{period:.4g} s apart. Log faster, raise dt to {MIN_RATIO * period:.3g} s, or {columns} to {period:.4g} s."
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
                controls=system.controls_of_steps(clock.hold(log.controls, rows, ticks)),
                dt=system.dt,
                pose=trace[ticks - samples[0]] if pose.size else None,
                name=log.name if len(runs) == 1 else f"{log.name}[{first}:{last}]",
                condition=log.condition_at(rows.start),
            )
        )
    if not episodes:
        raise InvalidData(
            f"{log.name}: expected more than {2 * margin * step + system.dt:.2f} s (the filter and one step) without "
            f"a gap over {max_gap * 1e3:.0f} ms; the longest gap is {steps.max():.3g} s"
        )
    derived = [name for name in lacking if name not in log.rates]
    how = f"{', '.join(derived)} from the pose (5-point differences in the body frame); " if derived else ""
    how += "".join(f"{name} from {log.rates[name]} (5-point differences); " for name in lacking if name in log.rates)
    notes = [
        f"{how}{len(taps)}-tap {FILTERED} at {cutoff:g} Hz without delay, {1 / step:g} Hz decimated to "
        f"{1 / system.dt:g} Hz; controls held; {margin * step:.2f} s left out at both ends of each part",
        *([clock.note] if clock.note else []),
        *_gaps(steps, period, max_gap, int(log.changes.sum()), len(runs) - len(episodes)),
    ]
    return PreparedLog(log.name, tuple(episodes), tuple(notes))


def _gaps(steps: Array, period: float, max_gap: float, changes: int, left_out: int) -> list[str]:
    bridged = steps[(steps > 1.5 * period) & (steps <= max_gap)]
    splits = int((steps > max_gap).sum())
    notes = []
    if len(bridged):
        notes.append(f"{len(bridged)} gaps of up to {bridged.max() * 1e3:.0f} ms bridged by linear interpolation")
    if splits or changes:
        short = f"; {left_out} parts shorter than the filter left out" if left_out else ""
        where = [f"{splits} gaps of up to {steps.max():.3g} s"] * bool(splits)
        where += [f"{changes} changes of condition"] * bool(changes)
        notes.append(f"split at {' and '.join(where)}{short}")
    return notes


def low_pass(cutoff: float, rate: float, stop: float) -> Array:
    """Return an odd number of symmetric taps for a log at ``rate``, all in Hz.

    The gain is 0.5 at ``cutoff`` and below -50 dB from ``stop`` on: an ideal filter with a Kaiser window, whose
    length and shape follow from Kaiser's formulas (Oppenheim and Schafer, section 7.6). Raises `InvalidArgument`
    unless 0 < cutoff < stop. `scipy.signal` has the same, but its import takes a second.
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
    if time does not increase or a number is not finite.
    """
    if log.controls.shape[1] != system.nu or log.pose.shape[1] not in (0, system.n_pose):
        raise ShapeError(
            f"{log.name}: expected {system.nu} controls and {system.n_pose} pose coordinates, those of the system, "
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
        source = name if name in log.extra else log.rates.get(name, "")
        if source in log.extra:
            period, values = periods.get(source), log.extra[source]
            smooth = values if period is None else np.unwrap(values, period=period)
            even = clock.interpolate(smooth[:, None], rows, samples)[:, 0]
            columns.append(
                even[REACH:-REACH] if source == name else np.convolve(even, STENCIL, mode="valid") / clock.step
            )
        elif name in derived:
            columns.append(derived[name])
        else:
            raise InvalidData(
                f"{log.name}: state {name!r} is neither a velocity of the pose nor among the other columns "
                f"({', '.join(log.extra) or 'none'})"
            )
    return np.stack(columns, axis=1)


UNIFORM = 0.01
"""Smaller deviations of time stamps, as a share of a period, are interpolated without a note."""


@dataclass(frozen=True)
class Clock:
    """Sample s of the uniform clock is at ``times[0] + s * step`` (s); ``times`` (N,) are the log's rows.

    ``note`` explains times that are not the stamps of a uniform log.
    """

    times: Array
    step: float
    note: str = ""

    def samples(self, rows: slice) -> IntArray:
        """Return the samples within ``rows``."""
        place = (self.times[rows] - self.times[0]) / self.step
        return np.arange(np.ceil(place[0] - UNIFORM), np.floor(place[-1] + UNIFORM) + 1, dtype=np.int64)

    def interpolate(self, values: Array, rows: slice, samples: IntArray) -> Array:
        """Return ``values`` (N, c) at the samples, interpolated linearly between ``rows``."""
        at = self.times[0] + samples * self.step
        columns = [np.interp(at, self.times[rows], column) for column in values[rows].T]
        return np.stack(columns, axis=1) if columns else np.empty((len(samples), 0))

    def hold(self, values: Array, rows: slice, samples: IntArray) -> Array:
        """Return ``values`` (N, c) held until the samples: those of the last row up to half a step after each."""
        at = self.times[0] + (samples + 0.5) * self.step
        return values[rows][np.searchsorted(self.times[rows], at, side="right") - 1]


def fit_clock(stamps: Array, positions: Array, step: float) -> Clock:
    """Return the clock of a log: its time stamps, or a uniform clock fitted to them.

    A tracker measures at a uniform rate, but many loggers stamp frames on arrival. A late stamp then looks like a wrong
    position. The clock on which the ``positions`` (N, any) move more smoothly is used. ``stamps`` (N,) and ``step`` are
    in s.
    """
    since = (stamps - stamps[0]) / step
    if np.abs(since - np.round(since)).max() < UNIFORM:
        return Clock(stamps, step)
    period = float(np.median(np.diff(stamps)))
    frames = np.concatenate([[0.0], np.cumsum(np.maximum(1.0, np.round(np.diff(stamps) / period)))])
    rate, start = np.polyfit(frames, stamps, 1)
    steady = start + rate * frames
    scatter = stamps - steady
    scattered = f"time stamps scatter by {1e3 * scatter.std():.2g} ms around a steady {1.0 / rate:.1f} Hz"
    if np.abs(scatter).max() < 0.5 * period and _roughness(positions, steady) < _roughness(positions, stamps):
        return Clock(steady, step, f"{scattered} and the pose moves more smoothly on the steady clock, which is used")
    return Clock(stamps, step, f"{scattered}; the pose is interpolated linearly onto a uniform clock")


def contiguous_rows(breaks: BoolArray) -> list[slice]:
    """Return the runs of rows between ``breaks`` (N - 1,), true at k if row k + 1 begins a new run."""
    edges = [0, *(np.flatnonzero(breaks) + 1).tolist(), len(breaks) + 1]
    return [slice(first, last) for first, last in pairwise(edges)]


def _roughness(positions: Array, times: Array) -> float:
    velocities = np.diff(positions, axis=0) / np.diff(times)[:, None]
    return float(np.sum(np.diff(velocities, axis=0) ** 2))


FILTERED = "low-pass"


def is_filtered(notes: Sequence[str]) -> bool:
    """Return whether ``notes`` report that samples were filtered by `prepare`: a response may precede its cause."""
    return any(FILTERED in note for note in notes)


LISTED = 4
"""Largest number of logs that a note names."""


def merged_notes(prepared: Sequence[PreparedLog]) -> list[str]:
    """Return the distinct notes of all logs, each with the names of its logs before it."""
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
