"""A log that carries the states at the control rate becomes episodes row by row."""

from __future__ import annotations

import numpy as np

from sysid_evo.data.clock import pieces
from sysid_evo.data.preparation import Prepared, checked_pose, prepare
from sysid_evo.data.raw import RawLog
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.errors import InvalidData
from sysid_evo.system import System

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


def episodes_of(log: RawLog, system: System) -> Prepared:
    """Return the episodes of ``log``: row by row if it is at the control rate, else filtered, see `prepare`."""
    return take_rows(log, system) if at_control_rate(log, system) else prepare(log, system)


def take_rows(log: RawLog, system: System) -> Prepared:
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
    runs = pieces(broken | log.changes)
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
    return Prepared(log.name, tuple(episodes), tuple(notes))
