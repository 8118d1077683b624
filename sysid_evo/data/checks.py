"""Checks of logs: limits, rate, units, frozen poses.

A log that cannot be used is an error; a possible fault is a remark.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sysid_evo.angles import TURN, wrap
from sysid_evo.data.columns import Column, ColumnMap, ControlColumn, StateColumn, TimeColumn
from sysid_evo.data.preparation import LONGEST, RATE_TOLERANCE, SHORTEST, RawLog
from sysid_evo.data.readers import LEAVE_OUT, Table, such_rows
from sysid_evo.data.units import to_si, units_of
from sysid_evo.errors import InvalidData
from sysid_evo.types import Array, IntArray

FROZEN_ROWS, FROZEN_TIME, FROZEN_JUMP = 5, 0.1, 0.02  # rows, s, m
STILL = 0.05  # rad/s: slower turns are not used to check the yaw rate
EXPLAINED = 0.5  # misfit if a rate is 1.6 times the change or the reverse, or if they correlate by 0.87
FAR_APART, SIZE_TOLERANCE = np.log(10.0), 0.15
"""A rate may belong to another state. Units are therefore inferred from its size only for degrees, cm and mm, whose
factors are large, and only if it agrees within the noise of a differentiated encoder."""
MIN_USED_RANGE = 0.02
"""A recorded range below this share of the limits suggests another unit: the factor is 0.017 for degrees, 0.001 for mA.
"""
TURNS = 2.0 * TURN
"""Larger angles (rad), or turns per second, suggest degrees: 13 degrees are a common value."""


def check_time(table: Table, column: str, time: Array) -> None:
    """Raise `InvalidData` unless every time stamp is later than the one before."""
    bad = np.flatnonzero(np.diff(time) <= 0)
    if len(bad):
        row = int(bad[0]) + 1
        same = time[row] == time[row - 1]
        restarted = (
            f"If the logger was restarted there, put the rows from {table.rows[row]} on into a file of their own, with "
            "the header. If single rows are out of order, leave them out; the log is then split there."
        )
        raise InvalidData(
            f"{table.where(column, row)}: expected rising time stamps, but {time[row]:.15g} s is "
            f"{'the same as' if same else 'before'} {time[row - 1]:.15g} s in row {table.rows[row - 1]}"
            f"{such_rows(len(bad))}. {LEAVE_OUT if same else restarted}"
        )


def check_control(table: Table, name: str, control: ControlColumn, values: Array) -> Array:
    """Return ``values`` (N,), or raise `InvalidData` if one lies outside the limits or off the levels.

    Values within 1e-6 of a level or limit (single precision) are set to it.
    """
    given = control.all_levels
    if given is not None:
        levels = np.asarray(given)
        nearest = levels[np.abs(values[:, None] - levels).argmin(axis=1)]
        legal, expected = nearest, "one of " + ", ".join(f"{level:g}" for level in given)
    elif control.low is not None and control.high is not None:
        legal, expected = np.clip(values, control.low, control.high), f"{control.low:g} to {control.high:g}"
    else:
        return values
    bad = np.flatnonzero(np.abs(values - legal) > 1e-6)
    if len(bad):
        row = int(bad[0])
        raise InvalidData(
            f"{table.where(control.column, row)}: control {name!r} is {values[row]:g}, expected {expected}"
            f"{such_rows(len(bad))}. Check unit and factor, or widen the limits in the column map."
        )
    return legal


def findings(log: RawLog, table: Table, columns: ColumnMap) -> list[str]:
    """Return remarks on possible faults of ``log``, read from ``table``. Raises `InvalidData` for certain faults."""
    found = _beyond_limits(log, table, columns)
    found += [
        f"{table.path.name}, rows {table.rows[0]} to {table.rows[-1]}, column {state.column!r}: "
        f"state {name!r} is constant at {log.extra[name][0]:g}; does the sensor work?"
        for name, state in columns.states.items()
        if state.column is not None and np.ptp(log.extra[name]) == 0.0
    ]
    if columns.pose:
        found += [*_frozen(log, table), *_heading_jumps(log, table, columns)]
        found += _course(log, table, columns)
    return [*found, *_turns(log, table, columns), *_rates(log, table, columns)]


def _beyond_limits(log: RawLog, table: Table, columns: ColumnMap) -> list[str]:
    found = []
    for name, state in columns.states.items():
        low, high = (-np.inf if state.low is None else state.low), (np.inf if state.high is None else state.high)
        if state.column is None:
            continue
        values = log.extra[name]
        bad = np.flatnonzero((values < low) | (values > high))
        if len(bad):
            found.append(
                f"{table.where(state.column, int(bad[0]))}: state {name!r} is {values[bad[0]]:g}, outside "
                f"{low:g} to {high:g}{such_rows(len(bad))}; not changed"
            )
    return found


def constant_controls(logs: Sequence[RawLog], tables: Sequence[Table], columns: ColumnMap) -> list[str]:
    """Return remarks on controls with one value in all logs; in one of several logs that is a manoeuvre."""
    found = []
    for i, (name, control) in enumerate(columns.controls.items()):
        values = np.concatenate([log.controls[:, i] for log in logs])
        if np.ptp(values) == 0.0:
            files = ", ".join(table.path.name for table in tables)
            found.append(
                f"{files}, every row, column {control.column!r}: control {name!r} is constant at {values[0]:g}; "
                "nothing can be learned about it"
            )
    return found


def unused_limits(logs: Sequence[RawLog], tables: Sequence[Table], columns: ColumnMap) -> list[str]:
    """Return remarks on limits that are so far from the recorded values that they seem to be in another unit.

    Limits of a state may be wide on purpose, so they are only remarked on if another unit explains them.
    """
    found = []
    seen = {name: [log.controls[:, i] for log in logs] for i, name in enumerate(columns.controls)}
    seen |= {n: [log.extra[n] for log in logs] for n, state in columns.states.items() if state.column is not None}
    for name, parts in seen.items():
        column = columns.controls.get(name) or columns.states[name]
        if column.low is None or column.high is None or not column.high > column.low:
            continue
        low, high = min(float(part.min()) for part in parts), max(float(part.max()) for part in parts)
        (si_unit, factor), share = to_si(column.unit), (high - low) / (column.high - column.low)
        meant = factor < MIN_USED_RANGE and column.low * factor <= low and high <= column.high * factor
        if not 0.0 < share < MIN_USED_RANGE or not (meant or name in columns.controls):
            continue
        converted = f"low = {column.low * factor:g}, high = {column.high * factor:g}"
        question = f"Are they in {column.unit}? Then give {converted}" if meant else "Are they right?"
        files = ", ".join(table.path.name for table in tables)
        found.append(
            f"{files}, column {column.column!r}: {name!r} goes from {low:g} to {high:g} {si_unit}, {share:.2g} of the "
            f"range of its limits, {column.low:g} to {column.high:g} {si_unit}: limits are in SI units. {question}"
        )
    return found


def _turns(log: RawLog, table: Table, columns: ColumnMap) -> list[str]:
    """Return remarks on angles declared in rad that seem to be in degrees; rates are checked by `_rates`."""
    yaw_rate = "" if columns.motion is None else columns.motion.yaw_rate
    found = []
    for name, state in columns.states.items():
        if state.column is None or state.unit not in ("rad", "rad/s") or (state.unit == "rad/s" and name != yaw_rate):
            continue
        far = float(np.abs(log.extra[name]).max())
        if far > TURNS:
            degrees = state.unit.replace("rad", "deg")
            found.append(
                f"{table.where(state.column, int(np.abs(log.extra[name]).argmax()))}: state {name!r} reaches {far:.4g} "
                f"{state.unit}, {far / TURN:.1f} full turns. Are these degrees? Then give unit = {degrees!r}"
            )
    return found


def _frozen(log: RawLog, table: Table) -> list[str]:
    """Return a remark on a pose that is exactly constant and then jumps, as if the tracker had lost the body."""
    same = (np.diff(log.pose, axis=0) == 0.0).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8))).reshape(-1, 2)
    first, last = edges[edges[:, 1] + 1 < len(log.time)].T
    jump = np.hypot(*(log.pose[last + 1, :2] - log.pose[last, :2]).T)
    long = (last - first + 1 >= FROZEN_ROWS) & (log.time[last] - log.time[first] >= FROZEN_TIME)
    return [
        f"{table.path.name}, rows {table.rows[first[i]]} to {table.rows[last[i]]}: the pose is constant for "
        f"{log.time[last[i]] - log.time[first[i]]:.2f} s and then jumps by {jump[i]:.2f} m, as if the tracker "
        "had lost the body; cut the file there"
        for i in np.flatnonzero(long & (jump > FROZEN_JUMP))
    ]


def _heading_jumps(log: RawLog, table: Table, columns: ColumnMap) -> list[str]:
    column, heading = columns.pose["heading"], log.pose[:, 2]
    step = np.diff(heading)
    full = np.flatnonzero((np.abs(step) > 300.0) & (np.abs(step) < 361.0))
    if len(full) and column.unit == "rad":
        row = int(full[0]) + 1
        raise InvalidData(
            f"{table.where(column.column, row)}: the heading jumps by {step[row - 1]:.1f}, a full turn in degrees, but "
            f'the column map declares rad; declare unit = "deg"'
        )
    jumps = np.flatnonzero(np.abs(wrap(step)) > 1.0)
    if not len(jumps):
        return []
    row = int(jumps[0]) + 1
    return [
        f"{table.where(column.column, row)}: the heading jumps by {wrap(step)[row - 1]:.2f} rad from one row to the "
        f"next{such_rows(len(jumps))}"
    ]


def _rates(log: RawLog, table: Table, columns: ColumnMap) -> list[str]:
    """Return remarks from a comparison of the yaw rate, and of possible rates of other states, with the derivative.

    A factor between them that another unit explains is an error, and so is a yaw rate of the opposite sign.
    """
    own = {name: (state, log.extra[name]) for name, state in columns.states.items() if state.column is not None}
    yaw_rate = own.get("" if columns.motion is None else columns.motion.yaw_rate)
    found = []
    if columns.pose and yaw_rate is not None:
        pair = _Pair(log.time, (columns.pose["heading"], log.pose[:, 2]), yaw_rate)
        if not pair.fits and max(_rms(pair.rate), _rms(pair.change(1.0))) >= STILL:
            clockwise = {"one of them is counted clockwise; give it factor = -1": (1.0, -1.0)}
            explained = pair.explained({**pair.units, **clockwise})
            where = pair.where(table)
            if explained:
                raise InvalidData(f"{where}: the yaw rate is not the derivative of the heading: {explained}")
            off = pair.misfit(1.0, 1.0)
            found.append(f"{where}: the yaw rate does not fit the differentiated heading (misfit {off:.1f})")
    pairs = [
        _Pair(log.time, other, rate)
        for rate in own.values()
        for other in own.values()
        if to_si(rate[0].unit)[0] == f"{to_si(other[0].unit)[0]}/s" and "[" not in rate[0].unit + other[0].unit
    ]
    settled = {column for pair in pairs if pair.fits for column in (pair.of.column, pair.by.column)}
    for pair in pairs:
        if not settled & {pair.of.column, pair.by.column}:  # of two joints each has a rate, which is not the other's
            far = {what: factors for what, factors in pair.units.items() if pair.is_near(*factors)}
            explained = pair.explained(far)
            if explained:
                raise InvalidData(
                    f"{pair.where(table)}: it is proportional to the change of column {pair.of.column!r}, but is "
                    f"not its derivative: {explained}. If it is not its rate, put the unit in brackets: "
                    f'unit = "[{pair.by.unit}]"'
                )
    return found


class _Pair:
    """A column that may be the ``rate`` of another one, in means over about 0.1 s."""

    def __init__(self, time: Array, of: tuple[Column | StateColumn, Array], by: tuple[StateColumn, Array]) -> None:
        (self.of, self._values), (self.by, values), self._time = of, by, time
        self._before, self._after = _baseline(time)
        self.rate: Array = sliding_window_view(values, int(self._after[0]) + 1).mean(axis=1)
        self.fits = self.misfit(1.0, 1.0) < 1.0

    def change(self, factor: float) -> Array:
        """Return the change per second of the other column times ``factor``; angles may wrap."""
        steps = np.diff(self._values * factor)
        moved = np.cumsum(np.concatenate([[0.0], wrap(steps) if to_si(self.of.unit)[0] == "rad" else steps]))
        return np.asarray(
            (moved[self._after] - moved[self._before]) / (self._time[self._after] - self._time[self._before])
        )

    def misfit(self, factor: float, rate_factor: float) -> float:
        """Return the misfit of change and rate, times these factors: 1 if one is 2.6 times the other."""
        a, b = self.change(factor), rate_factor * self.rate
        scale = _rms(a) * _rms(b)
        return _rms(a - b) / float(np.sqrt(scale)) if scale > 0.0 else np.inf

    @property
    def units(self) -> dict[str, tuple[float, float]]:
        """The factors of other units that one of the columns could be in, by the sentence that suggests the unit."""
        found = {}
        for column in (self.of, self.by):
            si_unit, declared = to_si(column.unit)
            for unit in units_of(si_unit):
                factor = to_si(unit)[1] / declared
                if factor != 1.0:
                    looks = f"column {column.column!r} looks like {unit}, but {column.unit} is declared: give it "
                    found[f"{looks}unit = {unit!r}"] = (factor, 1.0) if column is self.of else (1.0, factor)
        return found

    def is_near(self, factor: float, rate_factor: float) -> bool:
        """Whether change and rate have the same size with these factors, which are far from 1."""
        ratio = rate_factor * _rms(self.rate) / max(_rms(self.change(factor)), 1e-300)
        return abs(np.log(factor / rate_factor)) > FAR_APART and abs(ratio - 1.0) < SIZE_TOLERANCE

    def explained(self, factors: Mapping[str, tuple[float, float]]) -> str:
        """Return the sentences of the factors with the smallest misfit of rate and change; none if it is large."""
        off = {what: self.misfit(*pair) for what, pair in factors.items()}
        least = min(off.values(), default=np.inf)
        return "; or ".join(what for what, misfit in off.items() if misfit < min(EXPLAINED, least + 0.05))

    def where(self, table: Table) -> str:
        """Return the rows and the column of the rate as text."""
        return f"{table.path.name}, rows {table.rows[0]} to {table.rows[-1]}, column {self.by.column!r}"


def _course(log: RawLog, table: Table, columns: ColumnMap) -> list[str]:
    """Return remarks from a comparison of the heading with the direction of motion, forwards or backwards."""
    column = columns.pose["heading"]
    before, after = _baseline(log.time)
    moved = log.pose[after, :2] - log.pose[before, :2]
    length = np.hypot(moved[:, 0], moved[:, 1])
    moving = (length > 0.02) & (length > 0.2 * (log.time[after] - log.time[before]))
    if moving.sum() < 20:
        return []
    course = np.arctan2(moved[moving, 1], moved[moving, 0])
    heading = log.pose[(before + after) // 2, 2][moving]

    def agreement(factor: float) -> complex:
        return complex(np.mean(np.exp(2j * (course - factor * heading))))

    where = f"{table.path.name}, rows {table.rows[0]} to {table.rows[-1]}, column {column.column!r}"
    if abs(agreement(1.0)) < 0.6:
        if column.unit == "rad" and abs(agreement(np.pi / 180.0)) > 0.8:
            raise InvalidData(f"{where}: the heading follows the motion only if it is in degrees, but rad is declared")
        if column.unit == "deg" and abs(agreement(180.0 / np.pi)) > 0.8:
            raise InvalidData(f"{where}: the heading follows the motion only if it is in radians, but deg is declared")
        if abs(agreement(-1.0)) > 0.8:
            raise InvalidData(f"{where}: the heading is counted clockwise; give it factor = -1")
        return [f"{where}: the heading does not follow the direction of motion (agreement {abs(agreement(1.0)):.2f})"]
    offset = float(np.angle(agreement(1.0)) / 2.0)
    if abs(offset) > np.radians(20.0):
        return [
            f"{where}: the body moves {np.degrees(offset):.0f} degrees to the left of its heading on average; "
            "x must point forward"
        ]
    return []


def _baseline(time: Array) -> tuple[IntArray, IntArray]:
    """Return pairs of rows about 0.1 s apart, and at least two rows."""
    stride = min(max(2, round(0.1 / float(np.median(np.diff(time))))), len(time) - 1)
    before = np.arange(len(time) - stride, dtype=np.int64)
    return before, before + stride


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


UNITS = ("s", "ms", "us", "ns")

TIME_UNIT_RATIO = 20.0
"""A time between rows of at least this many ``dt`` suggests a wrong unit of time, a shorter one a wrong ``dt``."""

FASTEST = 200.0
"""Largest expected number of rows per ``dt``."""

MAX_IRREGULAR_SHARE = 0.05
"""With a larger share of irregular steps a log is refused instead of split at each of them."""


def check_rate(table: Table, column: TimeColumn, time: Array, dt: float, *, row_by_row: bool) -> None:
    """Raise `InvalidData`, with a remedy, if ``time`` (N,) in s cannot belong to samples every ``dt`` s.

    Three mistakes are distinguished: a wrong unit of time, a ``dt`` shorter than the log's steps, and
    scattered stamps. With ``row_by_row`` every state has a column, so that rows ``dt`` apart are samples; the scatter
    of rows that are closer together is removed by the filter.
    """
    steps = np.diff(time)
    period = float(np.median(steps))
    where = f"{table.path.name}, column {column.column!r}"
    if period > (1.0 + RATE_TOLERANCE) * dt:
        unit = _unit_of(column.unit, period, dt) if period >= TIME_UNIT_RATIO * dt else None
        if unit is not None:
            raise InvalidData(
                f"{where}: declared in {column.unit}, the rows are {period:.4g} s apart, {period / dt:.0f} times "
                f"dt = {dt:g} s. Are the stamps in {unit}? Then give [time] unit = {unit!r}; "
                f"if not, set dt = {period:.4g}"
            )
        raise InvalidData(
            f"{where}: the rows are {period:.4g} s apart, but dt is {dt:g} s, {period / dt:.3g} times shorter; "
            f"samples cannot be closer than the rows. Set dt = {period:.4g} in the column map, or log faster"
        )
    if time[-1] < 10.0 * dt and period * FASTEST < dt:
        unit = _unit_of(column.unit, period, dt)
        if unit is not None:
            raise InvalidData(
                f"{where}: declared in {column.unit}, {len(time)} rows last only {time[-1]:.3g} s, with dt = {dt:g} s. "
                f"Are the stamps in {unit}? Then give [time] unit = {unit!r}"
            )
    if row_by_row and abs(period / dt - 1.0) <= RATE_TOLERANCE:
        _check_scatter(where, steps, dt)


def _unit_of(declared: str, period: float, dt: float) -> str | None:
    """Return the unit of time with which the time between rows is a plausible part of ``dt``, or None."""
    for unit in UNITS:
        read = period * to_si(unit)[1] / to_si(declared)[1]
        if unit != declared and dt / FASTEST <= read <= (1.0 + RATE_TOLERANCE) * dt:
            return unit
    return None


def _check_scatter(where: str, steps: Array, dt: float) -> None:
    """Raise `InvalidData` if many steps are neither ``dt`` nor a whole number of lost rows."""
    broken = (steps < SHORTEST * dt) | (steps > LONGEST * dt)
    lost = (steps > LONGEST * dt) & (np.abs(steps / dt - np.round(steps / dt)) < RATE_TOLERANCE)
    stray = float(np.mean(broken & ~lost))
    if stray > MAX_IRREGULAR_SHARE:
        near = steps[steps < 3.0 * dt]
        raise InvalidData(
            f"{where}: the time between rows scatters by {1e3 * near.std():.3g} ms around {1e3 * dt:g} ms; "
            f"{stray:.0%} of the steps are under {SHORTEST:g} or over {LONGEST:g} dt. If the rows were measured every "
            f"{1e3 * dt:g} ms and only stamped late, leave [time] out of the column map; if not, stamp each row where "
            "the sensor is read, or log three or more rows for each dt, which are filtered onto a steady clock"
        )
