"""Behaviour of a controller in recorded trials: numbers, differences between systems, sentences.

A `DrivingSummary` holds the numbers of all recorded trials of a controller on one system, named by channels and plain
words. Some apply to every system, others to planar bodies, targets or markers. A `BehaviourDifference` compares shares
of the time on two systems, which shows differences that no probe of single steps detects.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from evaluation.formatting import percent
from evaluation.transfer.matrix import Trace, TransferMatrix
from sysid_evo.angles import TURN
from sysid_evo.data import Trajectory
from sysid_evo.engine.results import above_and_below, behaviour_names
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System
from sysid_evo.types import Array, BoolArray
from sysid_evo.validation.estimates import paired


@dataclass(frozen=True)
class Measure:
    """Mean over the ``trials`` that have the number, and its interval (NaN for a single trial)."""

    value: float
    low: float
    high: float
    trials: int


@dataclass(frozen=True)
class DrivingSummary:
    """Behaviour of ``controller`` on ``column`` in ``trials`` recorded trials, as numbers with names."""

    controller: str
    column: str
    trials: int
    measures: Mapping[str, Measure]

    def value(self, name: str) -> float:
        """Return the mean of a measure, NaN if it is not there."""
        found = self.measures.get(name)
        return float("nan") if found is None else found.value


def driving_summaries(matrix: TransferMatrix) -> tuple[DrivingSummary, ...]:
    """Return a summary of every recorded controller on the robots and on the models it was evolved against."""
    system = next((champion.system for champion in matrix.champions if champion.system is not None), None)
    kept = {key: cell.traces for key, cell in matrix.cells.items() if cell.traces}
    if system is None or not kept:
        return ()
    states = [trace.trajectory.states for traces in kept.values() for trace in traces]
    fastest = np.quantile([np.quantile(np.abs(one), 0.99, axis=0) for one in states], SPEED_QUANTILE, axis=0)
    found = []
    for champion in matrix.champions:
        robots = [column for column in matrix.columns if column not in matrix.models]
        for column in dict.fromkeys((*champion.against, *robots) if champion.against else matrix.columns):
            traces = kept.get((champion.name, column), ())
            if traces:
                found.append(driving_summary(champion.name, column, traces, system, fastest))
    return tuple(found)


SPEED_QUANTILE = 0.75
"""Quantile of the trials that defines a high speed: a single exploited model may be faster than all others."""


def driving_summary(
    controller: str, column: str, traces: Sequence[Trace], system: System, fastest: Array
) -> DrivingSummary:
    """Return the summary of these trials; ``fastest`` (nx,) is the largest absolute value of each state anywhere."""
    found = [trial_measures(trace, system, fastest) for trace in traces]
    names = dict.fromkeys(name for one in found for name in one)
    measures = {}
    for name in names:
        values = np.array([one[name] for one in found if np.isfinite(one.get(name, np.nan))])
        if len(values):
            ends = paired(values).clipped(0.0, np.inf if unit_of(name) else 1.0).interval  # nothing is below 0
            measures[name] = Measure(float(values.mean()), *ends, len(values))
    return DrivingSummary(controller, column, len(traces), measures)


UNITS = (("per second", "1/s"), ("per minute", "1/min"), ("speed", "m/s"), ("settling time", "s"), ("miss in", "s"))
"""Unit by the end of a measure's name; all other measures are shares."""


def unit_of(name: str) -> str:
    """Return the unit of the measure ``name``, empty for a share."""
    return next((unit for end, unit in UNITS if name.endswith(end)), "")


SWITCH = 0.1
"""A control switches if it changes by more than this share of its range within one step."""
LIMIT = 0.01
"""A control is at a limit within this share of its range."""
MOVING = 0.1
"""A body moves above this share of its largest speed, and turns above this share of its largest yaw rate."""
STOP = 0.2
"""Duration at rest (s) that counts as a stop."""
SETTLED = 0.1
"""A trial has settled if no state leaves its tolerance in this last share of it."""


def trial_measures(trace: Trace, system: System, fastest: Array) -> Mapping[str, float]:
    """Return the numbers of one trial by their names, NaN where the trial has none.

    ``fastest`` (nx,) is the largest absolute value of each state in all trials.
    """
    found: dict[str, float] = {}
    run = trace.trajectory
    for j, channel in enumerate(system.controls):
        values, name = run.controls[:, j], channel.name
        size = channel.high - channel.low if channel.bounded else np.ptp(values)
        switches = np.abs(np.diff(values)) > SWITCH * size if size > 0 else np.zeros(len(values) - 1, dtype=bool)
        found[f"{name} switches per second"] = float(switches.sum() / (len(values) * run.dt))
        if channel.bounded and channel.levels is None:
            found[f"{name} at a limit"] = float(_at_limit(channel, values).mean())
        off = values != channel.neutral
        found[f"{name} above neutral"] = float((values[off] > channel.neutral).mean()) if off.any() else np.nan
    for i, channel in enumerate(system.states):
        if channel.bounded:
            found[f"{channel.name} at a limit"] = float(_at_limit(channel, run.states[1:, i]).mean())
    if trace.targets:
        found |= _targets(trace)
    if isinstance(system.motion, PlanarBody):
        found |= _on_a_plane(trace, system, system.motion, fastest)
    return found


def _at_limit(channel: Channel, values: Array) -> BoolArray:
    band = LIMIT * (channel.high - channel.low)
    found: BoolArray = (values <= channel.low + band) | (values >= channel.high - band)
    return found


def _targets(trace: Trace) -> dict[str, float]:
    """Return the time until all states stay within their tolerances, and the share of the time within them."""
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
        "settling time": last * run.dt if settled else np.nan,
    }


def _on_a_plane(trace: Trace, system: System, motion: PlanarBody, fastest: Array) -> dict[str, float]:
    run = trace.trajectory
    forward, lateral, yaw = motion.indices(system.state_names)
    ahead = run.states[:, forward]
    speed = np.abs(ahead) if lateral is None else np.hypot(ahead, run.states[:, lateral])
    rest_speed = MOVING * fastest[forward]
    moving, turning = speed > rest_speed, np.abs(run.states[:, yaw]) > MOVING * fastest[yaw]
    found = {
        "speed": float(speed.mean()),
        "backwards": float((ahead[moving] < 0.0).mean()) if moving.any() else np.nan,
        "turning left": float((run.states[turning, yaw] > 0.0).mean()) if turning.any() else np.nan,
        "stops per minute": 60.0 * _stops(~moving, max(1, round(STOP / run.dt))) / run.duration,
        "at rest": float((~moving).mean()),
    }
    if len(trace.waypoints) and run.pose is not None:
        hunt = chase(run.pose[:, :2], trace.waypoints, trace.waypoint_radius, ahead, run.dt, rest_speed=rest_speed)
        misses = len(hunt.reactions)
        found |= {
            "missed at first": hunt.missed / min(hunt.markers, hunt.reached + 1),
            "misses per minute": 60.0 * misses / run.duration,
            **{f"{what} after a miss": hunt.reactions.count(what) / misses if misses else np.nan for what in REACTIONS},
            "reached after a miss in": float(np.median(hunt.after)) if hunt.after else np.nan,
            "orbiting": hunt.orbiting,
        }
    return found


def _stops(resting: BoolArray, least: int) -> int:
    """Return the number of times that it rests for ``least`` samples or more after it moved."""
    moved = np.flatnonzero(~resting)
    if not len(moved):
        return 0
    after = np.concatenate([[False], resting[moved[0] :], [False]]).astype(np.int64)
    begins, ends = np.flatnonzero(np.diff(after) == 1), np.flatnonzero(np.diff(after) == -1)
    return int((ends - begins >= least).sum())


NEAR = 2.5
"""A marker is missed if a body that approached it passes within this distance (radii of the marker) and leaves."""
MIN_APPROACH = 0.5
"""Minimum distance (radii) by which it must have approached before, and have left afterwards."""
REACTION_TIME = 2.0
"""Time (s) after a miss in which the reaction is observed."""
MAX_ORBIT_TIME = 10.0
"""Longest time (s) of a full turn around a marker that counts as an orbit."""

Reaction: TypeAlias = Literal["drives on", "stops", "turns back"]
REACTIONS: tuple[Reaction, ...] = ("drives on", "stops", "turns back")


@dataclass(frozen=True)
class WaypointApproach:
    """Markers of one trial: how many came up and were ``reached``, and the reaction to each miss (``reactions``).

    ``missed`` counts the markers that were missed at least once. ``after`` holds the time (s) to the marker for every
    miss whose marker was then reached. ``orbiting`` is the share of the time in full turns around a marker.
    """

    markers: int
    reached: int
    missed: int
    reactions: tuple[Reaction, ...]
    after: tuple[float, ...]
    orbiting: float


def chase(
    place: Array, markers: Array, radius: float, forward: Array, dt: float, *, rest_speed: float
) -> WaypointApproach:
    """Return how a body at ``place`` (T + 1, 2) m approached ``markers`` (k, 2), one after the other.

    ``forward`` (T + 1,) is its signed speed; below ``rest_speed`` (m/s) it is at rest.
    """
    begin, reached, missed = 0, 0, 0
    reactions: list[Reaction] = []
    after: list[float] = []
    around = np.zeros(len(place), dtype=bool)
    for marker in markers:
        off = place[begin:] - marker
        distance = np.hypot(off[:, 0], off[:, 1])
        inside = np.flatnonzero(distance[1:] < radius)
        there = bool(len(inside))
        end = begin + 1 + (int(inside[0]) if there else len(distance) - 2)
        leg = slice(begin, end + 1)
        misses = [begin + step for step in _misses(distance[: end - begin + 1], radius)]
        for step in misses:
            reactions.append(_reaction(forward[step : step + 1 + round(REACTION_TIME / dt)], rest_speed))
            if there:
                after.append((end - step) * dt)
        missed += bool(misses)
        around[leg] |= _orbits(off[: end - begin + 1], max(2, round(MAX_ORBIT_TIME / dt)))
        reached += there
        begin = end
        if not there or begin >= len(place) - 1:
            break
    return WaypointApproach(
        len(markers),
        reached,
        missed,
        tuple(reactions),
        tuple(after),
        float(around[:-1].mean()) if len(around) > 1 else 0.0,
    )


def _misses(distance: Array, radius: float) -> list[int]:
    """Return the steps at which a body that had approached passed by and left again."""
    found: list[int] = []
    farthest, nearest, step, coming = distance[0], distance[0], 0, False
    for k, now in enumerate(distance):
        if not coming:
            farthest = max(farthest, now)
            if now < farthest - MIN_APPROACH * radius:
                coming, nearest, step = True, now, k
        elif now < nearest:
            nearest, step = now, k
        elif now > nearest + MIN_APPROACH * radius:
            if radius <= nearest < NEAR * radius:
                found.append(step)
            coming, farthest = False, now
    return found


def _reaction(forward: Array, rest_speed: float) -> Reaction:
    """Return the reaction of a body with these speeds; it turns back if it moves in the other direction."""
    moving = forward[np.abs(forward) > rest_speed]
    if len(moving) and np.sign(moving[-1]) != np.sign(moving[0]):
        return "turns back"
    return "stops" if bool((np.abs(forward) <= rest_speed).any()) else "drives on"


def _orbits(off: Array, longest: int) -> BoolArray:
    """Return which samples lie within a full turn around the origin of at most ``longest`` steps."""
    angle = np.unwrap(np.arctan2(off[:, 1], off[:, 0]))
    marked = np.zeros(len(angle), dtype=bool)
    if np.ptp(angle) < TURN:
        return marked
    for first in range(len(angle)):
        turned = np.flatnonzero(np.abs(angle[first : first + longest] - angle[first]) >= TURN)
        if len(turned):
            marked[first : first + int(turned[0]) + 1] = True
    return marked


MENTIONED_SHARE, RARE_SHARE = 0.5, 0.1
"""Shares from which something is mentioned, and below which it is rare."""
ONE_SIDED_SHARE = 0.75
"""Share of the turns to one side from which it is mentioned."""
MENTIONED_DIFFERENCE = 0.15
"""Difference of two shares, or relative difference of two rates, that is mentioned between two systems."""


def driving_sentences(summaries: Sequence[DrivingSummary], robot: str | None) -> dict[str, str]:
    """Return sentences on each controller: on the robot, or else in its models, and the differences elsewhere."""
    found: dict[str, list[DrivingSummary]] = {}
    for summary in summaries:
        found.setdefault(summary.controller, []).append(summary)
    sentences = {}
    for controller, several in found.items():
        here = next((one for one in several if one.column == robot), several[0])
        place = "on the robot" if here.column == robot else f"in {here.column}"
        sentences[controller] = driving_sentence(here, [one for one in several if one is not here], place=place)
    return {controller: text for controller, text in sentences.items() if text}


def driving_sentence(here: DrivingSummary, there: Sequence[DrivingSummary] = (), *, place: str = "") -> str:
    """Return sentences on a controller: its behaviour on one system, and the differences on others.

    ``place`` are the words for the system ("on the robot").
    """
    parts = [*_driving(here), *_chasing(here), *_settling(here), *_switching(here)]
    text = f"{f'{place[0].upper()}{place[1:]}: ' if place else ''}{'; '.join(parts)}." if parts else ""
    others = [sentence for other in there if (sentence := _otherwise(here, other))]
    return " ".join(filter(None, (text, *others)))


def _driving(summary: DrivingSummary) -> list[str]:
    speed, back, left = (summary.value(name) for name in ("speed", "backwards", "turning left"))
    if not np.isfinite(speed):
        return []
    parts = []
    if np.isfinite(back):
        way = "backwards" if back > MENTIONED_SHARE else "forwards"
        parts.append(f"drives {way} {percent(max(back, 1.0 - back))} of the time at {speed:.2f} m/s")
    else:
        parts.append("hardly moves")
    if np.isfinite(left) and max(left, 1.0 - left) >= ONE_SIDED_SHARE:
        parts.append(
            f"turns {'left' if left > MENTIONED_SHARE else 'right'} in {percent(max(left, 1.0 - left))} of its turns"
        )
    stops, resting = summary.value("stops per minute"), summary.value("at rest")
    if stops >= 1.0:
        parts.append(f"stops {stops:.0f} times a minute")
    if resting >= RARE_SHARE:
        parts.append(f"is at rest {percent(resting)} of the time")
    return parts


def _chasing(summary: DrivingSummary) -> list[str]:
    missed, orbiting = summary.value("missed at first"), summary.value("orbiting")
    parts = []
    if np.isfinite(missed):
        if missed < RARE_SHARE / 2:
            parts.append("hardly ever misses a waypoint")
        else:
            parts.append(f"misses {percent(missed)} of the waypoints at first{_after(summary)}")
    if np.isfinite(orbiting) and orbiting > RARE_SHARE / 10:
        parts.append(f"orbits a waypoint {percent(orbiting)} of the time")
    return parts


def _after(summary: DrivingSummary) -> str:
    """Return the reactions to a miss, the most frequent first."""
    shares = {what: summary.value(f"{what} after a miss") for what in REACTIONS}
    known = {what: share for what, share in shares.items() if np.isfinite(share) and share >= RARE_SHARE}
    parts = [f"{what} ({percent(share)})" for what, share in sorted(known.items(), key=lambda pair: -pair[1])]
    delay = summary.value("reached after a miss in")
    back = f", and reaches it {delay:.1f} s later" if np.isfinite(delay) else ""
    return f", then {' or '.join(parts)}{back}" if parts else ""


def _settling(summary: DrivingSummary) -> list[str]:
    settled, seconds, within = (summary.value(name) for name in ("settled", "settling time", "within tolerance"))
    if not np.isfinite(settled):
        return []
    parts = [f"is within tolerance {percent(within)} of the time"]
    if settled < RARE_SHARE:
        return [*parts, "never settles" if settled == 0.0 else f"settles in only {percent(settled)} of the trials"]
    return [*parts, f"settles after {seconds:.1f} s in {percent(settled)} of the trials"]


def _switching(summary: DrivingSummary) -> list[str]:
    ending = " switches per second"
    rates = {name.removesuffix(ending): one.value for name, one in summary.measures.items() if name.endswith(ending)}
    parts = [f"{name} {rate:.1f} times" for name, rate in rates.items() if rate >= RARE_SHARE]
    parts = [f"switches {' and '.join(parts)} a second"] if parts else []
    for name in rates:
        limit = summary.value(f"{name} at a limit")
        if RARE_SHARE <= limit < 1.0:
            parts.append(f"holds {name} at a limit {percent(limit)} of the time")
    return parts


def _otherwise(here: DrivingSummary, other: DrivingSummary) -> str:
    """Return the clear differences on another system, the largest first; empty if there are none."""
    found = []
    for name, one in other.measures.items():
        own = here.measures.get(name)
        if own is None or not (one.low > own.high or one.high < own.low):
            continue
        size = abs(one.value - own.value)
        if unit_of(name):
            size /= max(one.value, own.value)
        if size >= MENTIONED_DIFFERENCE:
            found.append((size, f"{name} {_value_text(name, one.value)} instead of {_value_text(name, own.value)}"))
    listed = [text for _, text in sorted(found, key=lambda pair: -pair[0])[:3]]
    return f"In {other.column}: {', '.join(listed)}." if listed else ""


def _value_text(name: str, value: float) -> str:
    unit = unit_of(name)
    if " per " in name:
        return f"{value:.1f}"
    return f"{value:.1f} {unit}" if unit else percent(value)


AT_REST = "are at rest"
QUIET = 0.05
"""A state is neutral within this share of its largest absolute value in the data."""

LEAST_DIFFERENCE = 0.25
"""Difference of two shares of the time that is reported."""


@dataclass(frozen=True)
class BehaviourDifference:
    """Share of the time of one behaviour in the model (``here``) and elsewhere (``there``)."""

    name: str
    here: float
    there: float

    @property
    def size(self) -> float:
        """Difference of the two shares."""
        return abs(self.here - self.there)

    def sentence(self, elsewhere: str) -> str:
        """Return the difference in words that follow "its controllers"; ``elsewhere`` names the other systems."""
        return f"{self.name} {percent(self.here)} of the time here, {percent(self.there)} {elsewhere}"


def behaviour(system: System, trajectories: Sequence[Trajectory], largest: Array) -> Mapping[str, float]:
    """Return the share of the time of each behaviour over all ``trajectories``, in [0, 1]; empty without any.

    Behaviours are each state and each control above and below neutral, and everything at rest, for any system and
    named by its channels; a task may add measures of its own (`Task.measures`). ``largest`` (nx,) is the largest
    deviation of each state from neutral in the training data.
    """
    if not trajectories:
        return {}
    states = np.concatenate([t.states[:-1] for t in trajectories])
    controls = np.concatenate([t.controls for t in trajectories])
    off = system.difference(states, np.broadcast_to(system.neutral_state, states.shape))
    quiet = np.abs(off) <= QUIET * largest
    centre = np.concatenate([np.zeros(system.nx), system.neutral_control])
    shares = above_and_below(np.where(quiet, 0.0, off), controls, centre).mean(axis=0)
    verbs = ["have"] * (2 * system.nx) + ["hold"] * (2 * system.nu)
    named = zip(verbs, behaviour_names(system), shares, strict=True)
    return {AT_REST: float(quiet.all(axis=1).mean())} | {
        f"{verb} {name} neutral": float(one) for verb, name, one in named
    }


def behaviour_differences(
    here: Mapping[str, float], there: Sequence[Mapping[str, float]]
) -> tuple[BehaviourDifference, ...]:
    """Return the behaviours that differ from the median of ``there`` by a quarter of the time or more, largest first.

    Of each channel only the side that differs more is returned.
    """
    known = [one for one in there if one]
    if not here or not known:
        return ()
    elsewhere = {name: float(np.median([one[name] for one in known])) for name in here}
    found = [BehaviourDifference(name, here[name], elsewhere[name]) for name in here]
    largest: dict[str, BehaviourDifference] = {}
    for difference in sorted(found, key=lambda one: -one.size):
        if difference.size >= LEAST_DIFFERENCE:
            largest.setdefault(difference.name.rsplit(" ", 2)[0], difference)
    return tuple(largest.values())
