"""Numbers that tell how a trial went, for any system; more of a body on a plane, of targets and of markers.

Names are those of channels and plain words; each number is of one trial, nan where the trial has none.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from evaluation.behaviour.chase import REACTIONS, chase
from evaluation.transfer import Trace
from sysid_evo.arrays import Array, BoolArray
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System

SWITCH = 0.1
"""A control switches where it changes by more than this share of its range within one step."""
LIMIT = 0.01
"""It is at a limit within this share of its range."""
MOVING = 0.1
"""A body moves above this share of its largest speed, and turns above this share of its largest yaw rate."""
STOP = 0.2
"""Seconds at rest that make a stop."""
SETTLED = 0.1
"""A trial has settled if nothing leaves the tolerance in this last share of it."""
NAN = float("nan")


def measured(trace: Trace, system: System, fastest: Array) -> Mapping[str, float]:
    """Return the numbers of one trial; ``fastest`` (nx,) is the largest size that each state has anywhere."""
    found: dict[str, float] = {}
    run = trace.trajectory
    for j, channel in enumerate(system.controls):
        found |= _control(channel, run.controls[:, j], run.dt)
    for i, channel in enumerate(system.states):
        if channel.bounded:
            found[f"{channel.name} at a limit"] = float(_at_limit(channel, run.states[1:, i]).mean())
    if trace.targets:
        found |= _targets(trace)
    if isinstance(system.motion, PlanarBody):
        found |= _on_a_plane(trace, system, system.motion, fastest)
    return found


def _control(channel: Channel, values: Array, dt: float) -> dict[str, float]:
    size = channel.high - channel.low if channel.bounded else np.ptp(values)
    switches = np.abs(np.diff(values)) > SWITCH * size if size > 0 else np.zeros(len(values) - 1, dtype=bool)
    found = {f"{channel.name} switches per second": float(switches.sum() / (len(values) * dt))}
    if channel.bounded and channel.levels is None:
        found[f"{channel.name} at a limit"] = float(_at_limit(channel, values).mean())
    off = values != channel.neutral
    found[f"{channel.name} above neutral"] = float((values[off] > channel.neutral).mean()) if off.any() else NAN
    return found


def _at_limit(channel: Channel, values: Array) -> BoolArray:
    band = LIMIT * (channel.high - channel.low)
    found: BoolArray = (values <= channel.low + band) | (values >= channel.high - band)
    return found


def _targets(trace: Trace) -> dict[str, float]:
    """How long all states took to come within their tolerances for good, and how much of the time they are there."""
    run = trace.trajectory
    outside = np.zeros(len(run.states), dtype=bool)
    for target in trace.targets:
        error = run.states[:, target.place] - target.values
        if target.channel.period is not None:
            error -= target.channel.period * np.round(error / target.channel.period)
        outside |= np.abs(error) > target.tolerance
    late = np.flatnonzero(outside)
    last = int(late[-1]) + 1 if len(late) else 0
    settled = last <= (1.0 - SETTLED) * len(outside)
    return {
        "within tolerance": float(1.0 - outside.mean()),
        "settled": float(settled),
        "settling time": last * run.dt if settled else NAN,
    }


def _on_a_plane(trace: Trace, system: System, motion: PlanarBody, fastest: Array) -> dict[str, float]:
    run = trace.trajectory
    forward, lateral, yaw = motion.indices(system.state_names)
    ahead = run.states[:, forward]
    speed = np.abs(ahead) if lateral is None else np.hypot(ahead, run.states[:, lateral])
    still = MOVING * fastest[forward]
    moving, turning = speed > still, np.abs(run.states[:, yaw]) > MOVING * fastest[yaw]
    found = {
        "speed": float(speed.mean()),
        "backwards": float((ahead[moving] < 0.0).mean()) if moving.any() else NAN,
        "turning left": float((run.states[turning, yaw] > 0.0).mean()) if turning.any() else NAN,
        "stops per minute": 60.0 * _stops(~moving, max(1, round(STOP / run.dt))) / run.duration,
        "standing": float((~moving).mean()),
    }
    if len(trace.waypoints) and run.pose is not None:
        found |= _markers(trace, run.pose[:, :2], ahead, still)
    return found


def _stops(standing: BoolArray, least: int) -> int:
    """Return how often it stands for ``least`` samples or more after it moved."""
    moved = np.flatnonzero(~standing)
    if not len(moved):
        return 0
    after = np.concatenate([[False], standing[moved[0] :], [False]]).astype(np.int64)
    begins, ends = np.flatnonzero(np.diff(after) == 1), np.flatnonzero(np.diff(after) == -1)
    return int((ends - begins >= least).sum())


def _markers(trace: Trace, place: Array, forward: Array, still: float) -> dict[str, float]:
    found = chase(place, trace.waypoints, trace.waypoint_radius, forward, trace.trajectory.dt, still=still)
    came_up = min(found.markers, found.reached + 1)
    misses = len(found.reactions)
    return {
        "missed at first": found.missed / came_up,
        "misses per minute": 60.0 * misses / trace.trajectory.duration,
        **{f"{what} after a miss": found.reactions.count(what) / misses if misses else NAN for what in REACTIONS},
        "reached after a miss in": float(np.median(found.after)) if found.after else NAN,
        "orbiting": found.orbiting,
    }
