"""Whether the rows of a log are as far apart as the column map says, and which mistake it is if they are not."""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.data.columns import TimeColumn
from sysid_evo.data.sampled import LONGEST, RATE_TOLERANCE, SHORTEST
from sysid_evo.data.tables import Table
from sysid_evo.data.units import to_si
from sysid_evo.errors import InvalidData

UNITS = ("s", "ms", "us", "ns")

FAR = 20.0
"""Rows this many ``dt`` apart, or more, look like a wrong unit of time; nearer ones like a wrong ``dt``."""

FASTEST = 200.0
"""Most rows for each ``dt`` that a log is expected to have."""

STRAY = 0.05
"""Share of steps off the beat from which on a log is refused instead of split at each of them."""


def check_rate(table: Table, column: TimeColumn, time: Array, dt: float, *, row_by_row: bool) -> None:
    """Raise `InvalidData` if ``time`` (N,) in s cannot belong to samples every ``dt`` s, and say what to change.

    Three mistakes are told apart: a wrong unit of time, a ``dt`` shorter than the log's steps, and
    stamps that scatter. ``row_by_row`` says whether every state has a column, so that rows ``dt``
    apart are samples; rows closer together are filtered, which takes care of their scatter.
    """
    steps = np.diff(time)
    period = float(np.median(steps))
    where = f"{table.path.name}, column {column.column!r}"
    if period > (1.0 + RATE_TOLERANCE) * dt:
        unit = _unit_of(column.unit, period, dt) if period >= FAR * dt else None
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
    """Return the unit of time that makes the rows a likely part of ``dt`` apart, None if there is none."""
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
    if stray > STRAY:
        near = steps[steps < 3.0 * dt]
        raise InvalidData(
            f"{where}: the time between rows scatters by {1e3 * near.std():.3g} ms around {1e3 * dt:g} ms; "
            f"{stray:.0%} of the steps are under {SHORTEST:g} or over {LONGEST:g} dt. If the rows were taken every "
            f"{1e3 * dt:g} ms and only stamped late, leave [time] out of the column map; if not, stamp each row where "
            "the sensor is read, or log three or more rows for each dt, which are filtered onto a steady clock"
        )
