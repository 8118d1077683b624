"""Self-test of a robot before it moves: link, tracker, loop, sensors, equations; one finding a line."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hardware.connection import Connectable, Connection, Listener, Measurement, RobotStatus
from hardware.control_loop import LATEST, STALE, ControlLoop, Pilot, check_loop
from hardware.estimator import StateEstimate, estimator_delays
from hardware.run_report import LoopReport, StopRequest
from sysid_evo.carry import clip_state
from sysid_evo.data.units import spelled_range
from sysid_evo.errors import LinkLost
from sysid_evo.models.dynamics import Dynamics, started
from sysid_evo.processors import ENGINE_VARIABLE, resolve
from sysid_evo.system import Channel, System
from sysid_evo.types import Array


@dataclass(frozen=True)
class SelfTestFinding:
    """Result of one check: whether it passed, a sentence, and its figures."""

    check: str
    ok: bool
    sentence: str
    figures: Mapping[str, float] = field(default_factory=dict)


SECONDS = 3.0
STILL_DISTANCE = 0.02  # m and
STILL_ANGLE = 0.1  # rad: the largest apparent motion of a robot in neutral


def self_test(
    robot: Connectable, *, seconds: float = SECONDS, seed: int | None = None, stop: StopRequest | None = None
) -> tuple[SelfTestFinding, ...]:
    """Connect to ``robot``, send neutral for ``seconds`` and return the findings; nothing moves.

    Raises `IncompatibleSystem` if the control loop cannot drive its system.
    """
    check_loop(robot.system)
    began = time.perf_counter()
    stop = StopRequest() if stop is None else stop
    try:
        with stop.answer(robot.name, math.inf):
            connection = robot.connect(seed=seed)
    except LinkLost as error:
        return (SelfTestFinding("handshake", False, f"No answer: {error}"),)
    with connection:
        took = time.perf_counter() - began
        sitter = NeutralObserver(connection, robot.system)
        loop = ControlLoop(connection, robot.system, listeners=[sitter], stop=stop)
        report = loop.run(sitter, samples=round(seconds / robot.system.dt))
        handshake = SelfTestFinding("handshake", True, f"{robot.name} answered within {took:.2f} s.", {"seconds": took})
        return (handshake, sitter.link(), sitter.tracker(), _loop(report), *sitter.estimate())


class NeutralObserver(Listener, Pilot):
    """Decides on neutral and records all events meanwhile."""

    def __init__(self, connection: Connection, system: System) -> None:
        self._ages: list[float] = []
        self._connection = connection
        self._system = system
        self._frames: list[Measurement] = []
        self._statuses: list[RobotStatus] = []
        self._round_trips: list[float] = []

    def decide(self, tick: int, estimate: StateEstimate) -> Array | None:
        self._ages.append(estimate.age)
        return self._system.neutral_control

    def on_measurement(self, measurement: Measurement) -> None:
        self._frames.append(measurement)

    def on_status(self, status: RobotStatus) -> None:
        self._statuses.append(status)
        if self._connection.round_trip is not None:
            self._round_trips.append(self._connection.round_trip)

    def link(self) -> SelfTestFinding:
        """Status messages of the robot."""
        if not self._statuses:
            return SelfTestFinding("link", True, "The robot sends no status.")
        first, last = self._statuses[0], self._statuses[-1]
        risen = {
            name: count - first.counters.get(name, 0)
            for name, count in last.counters.items()
            if count > first.counters.get(name, 0)
        }
        driven = not np.array_equal(last.control, self._system.neutral_control)
        parts = [f"Its state is {last.state}, its outputs are {'not ' if driven else ''}neutral"]
        figures: dict[str, float] = {f"risen_{name}": count for name, count in risen.items()}
        if self._round_trips:
            median, longest = float(np.median(self._round_trips)), max(self._round_trips)
            parts.append(f"a command is answered in {1e3 * median:.1f} ms (at most {1e3 * longest:.1f})")
            figures |= {"round_trip": median, "longest_round_trip": longest}
        if risen:
            parts.append("its counters rose by " + ", ".join(f"{count} {name}" for name, count in risen.items()))
        return SelfTestFinding("link", not risen and not driven, "; ".join(parts) + ".", figures)

    def tracker(self) -> SelfTestFinding:
        """Rate, delay and reliability of the tracker, and whether the body is at rest."""
        seen = [frame for frame in self._frames if frame.valid]
        if len(seen) < 2:
            sentence = f"The body is visible in {len(seen)} of {len(self._frames)} frames."
            return SelfTestFinding("tracker", False, sentence)
        times = np.array([frame.source_time for frame in seen])
        latency = np.array([frame.arrival_time - frame.source_time for frame in seen])
        poses = np.array([frame.pose for frame in seen])
        poses[:, 2] = np.unwrap(poses[:, 2])
        moved = np.ptp(poses, axis=0)
        figures = {
            "rate": (len(seen) - 1) / float(times[-1] - times[0]),
            "valid_share": len(seen) / len(self._frames),
            "latency": float(np.median(latency)),
            "longest_latency": float(latency.max()),
            "longest_gap": float(np.diff(times).max()),
            "moved": float(np.hypot(moved[0], moved[1])),
            "turned": float(moved[2]),
        }
        at_rest = figures["moved"] <= STILL_DISTANCE and figures["turned"] <= STILL_ANGLE
        ms = {name: 1e3 * figures[name] for name in ("latency", "longest_latency", "longest_gap", "moved")}
        sentence = (
            f"{figures['rate']:.0f} frames/s of {seen[0].body}, {figures['valid_share']:.1%} of them valid, "
            f"latency {ms['latency']:.1f} ms (at most {ms['longest_latency']:.1f}), "
            f"gaps of at most {ms['longest_gap']:.0f} ms; "
            f"it {'stays within' if at_rest else 'moves by'} {ms['moved']:.1f} mm and "
            f"{np.degrees(figures['turned']):.1f} degrees."
        )
        return SelfTestFinding("tracker", at_rest and figures["longest_gap"] <= STALE, sentence, figures)

    def estimate(self) -> tuple[SelfTestFinding, ...]:
        """Delay of the state: the age of the pose when a control is decided, plus that of the estimator."""
        ages, times = self._ages, [frame.source_time for frame in self._frames]
        if not ages or len(times) < 2:
            return ()
        age = float(np.mean(ages))
        delays = estimator_delays(self._system, frame_interval=(times[-1] - times[0]) / (len(times) - 1))
        estimator = max(delays)
        sentence = (
            f"Poses are {1e3 * age:.1f} ms old when a control is decided and the estimator adds "
            f"{1e3 * estimator:.1f} ms: evolve with --estimator-delay {1e3 * (age + estimator):.0f}ms."
        )
        return (
            SelfTestFinding("estimate", True, sentence, {"age": age, "estimator": estimator, "delay": age + estimator}),
        )


def _loop(report: LoopReport) -> SelfTestFinding:
    """Return whether the loop ran to its end, and its punctuality."""
    if report.reason.is_fault or not report.ticks:
        return SelfTestFinding("loop", False, f"It was ended early: {report.sentence}.")
    figures = {
        "ticks": float(report.ticks),
        "lateness_p99": float(np.percentile(report.lateness, 99)),
        "longest_lateness": float(report.lateness.max()),
        "skipped": float(report.skipped),
    }
    sentence = (
        f"{report.ticks} commands, 99 % of them at most {1e3 * figures['lateness_p99']:.1f} ms late "
        f"(all at most {1e3 * figures['longest_lateness']:.1f}), {report.skipped} skipped."
    )
    return SelfTestFinding("loop", figures["longest_lateness"] <= LATEST and report.skipped == 0, sentence, figures)


STEPS = 300
"""Number of steps for which the equations are run under each control."""
BATCH = 64
"""Number of trials whose step is timed."""
MAX_TIMING = 2.0
"""Time (s) after which the timing is ended."""


def equation_findings(
    dynamics: Dynamics, sensors: SelfTestFinding, *, stop: StopRequest
) -> tuple[SelfTestFinding, ...]:
    """Return findings on the equations after that of the ``sensors``; a stop from outside ends it."""
    findings = [system_finding(dynamics.system), sensors, _rest(dynamics, stop)]
    findings += [_answer(dynamics, place, stop) for place in range(dynamics.system.nu) if stop.reason is None]
    return (*findings, _speed(dynamics, stop))


def system_finding(system: System) -> SelfTestFinding:
    """Return states, controls and sampling time in a sentence."""
    states, controls = (
        ", ".join(map(describe_channel, channels)) or "none" for channels in (system.states, system.controls)
    )
    sentence = f"States: {states}. Controls: {controls}. One sample every {system.dt:g} s; no pose, so no tracker."
    return SelfTestFinding("system", True, sentence, {"dt": system.dt})


def describe_channel(channel: Channel) -> str:
    """Return the name and, in brackets, period, levels or limits with the unit, and the description."""
    unit, facts = f" {channel.unit}" if channel.unit else "", channel.unit
    if channel.period is not None:
        facts = f"period {channel.period:g}{unit}"
    elif channel.levels is not None:
        facts = f"{', '.join(f'{level:g}' for level in channel.levels)}{unit}"
    elif channel.bounded:
        facts = f"{channel.low:g} to {channel.high:g}{unit}"
    details = "; ".join(filter(None, (facts, channel.description)))
    return f"{channel.name} ({details})" if details else channel.name


def sensors_finding(
    system: System, names: Sequence[str], readings: Array, rates: Mapping[str, str], period: float
) -> SelfTestFinding:
    """Return what was read in neutral: ``readings`` (n, names) every ``period`` s; ``rates`` are estimated states."""
    mean, spread = np.mean(readings, axis=0), np.std(readings, axis=0)
    units = {channel.name: channel.unit for channel in system.states}
    parts = [
        f"{name} {middle:.3g}{f' ± {wide:.2g}' if wide > 0.0 else ''} {units[name]}".rstrip()
        for name, middle, wide in zip(names, mean, spread, strict=True)
    ]
    estimated = ", ".join(f"{name} from {of}" for name, of in rates.items())
    more = f"; estimated: {estimated}" if estimated else ""
    seconds = len(readings) * period
    sentence = f"Read every {period:g} s in neutral for {seconds:g} s: {', '.join(parts)}{more}."
    return SelfTestFinding("sensors", bool(np.isfinite(readings).all()), sentence)


def _rest(dynamics: Dynamics, stop: StopRequest) -> SelfTestFinding:
    path = constant_control_response(dynamics, dynamics.system.neutral_control, stop)
    finite = bool(np.isfinite(path).all())
    moved = f"covers {_ranges(dynamics.system, path)}" if np.ptp(path, axis=0).any() else "does not move"
    sentence = (
        f"Without a command for {_duration(dynamics):g} s it {moved if finite else _lost(dynamics.system, path)}."
    )
    return SelfTestFinding("rest", finite, sentence)


def _answer(dynamics: Dynamics, place: int, stop: StopRequest) -> SelfTestFinding:
    """Return the effect of one control at its two ends: with the others neutral, or full if it has none then."""
    system, channel = dynamics.system, dynamics.system.controls[place]
    if not all(control.bounded for control in system.controls):
        return SelfTestFinding(
            channel.name, channel.bounded, "Controls must have finite limits: give low and high, or levels."
        )
    for others, how in ((system.neutral_control, ""), (full_controls(system), " with the other controls full")):
        here = np.arange(system.nu) == place
        paths = {
            end: constant_control_response(dynamics, np.where(here, end, others), stop)
            for end in (channel.low, channel.high)
        }
        low, high = paths.values()
        if low.shape != high.shape or not np.array_equal(low, high):
            ok = all(np.isfinite(path).all() for path in paths.values())
            effects = "; ".join(_effect(dynamics, channel, end, path) for end, path in paths.items())
            return SelfTestFinding(channel.name, ok, f"For {_duration(dynamics):g} s from rest{how}, {effects}.")
    sentence = f"It has no effect in {_duration(dynamics):g} s from rest: is it in the equations?"
    return SelfTestFinding(channel.name, False, sentence)


def full_controls(system: System) -> Array:
    """Return every control at the limit farther from neutral, (nu,)."""
    return np.array([c.high if c.high - c.neutral >= c.neutral - c.low else c.low for c in system.controls])


def _effect(dynamics: Dynamics, channel: Channel, end: float, path: Array) -> str:
    at = f"at {end:g} {channel.unit}".rstrip()
    if not np.isfinite(path).all():
        return f"{at}: it {_lost(dynamics.system, path)}"
    return f"{at}: {_ranges(dynamics.system, path)}{_clipped(dynamics, path)}"


def constant_control_response(dynamics: Dynamics, control: Array, stop: StopRequest) -> Array:
    """Return the states (STEPS + 1, nx) from rest under a constant ``control`` (nu,), without noise."""
    system = dynamics.system
    carry = started(dynamics, system.neutral_state[None])
    states = [carry[0, : system.nx].copy()]
    with np.errstate(all="ignore"):
        for _ in range(STEPS if stop.reason is None else 0):
            with stop.answer("the robot's equations"):
                carry = dynamics.step(carry, control[None], np.zeros((1, dynamics.n_noise)))
            if not np.isfinite(carry[0, : system.nx]).all():
                states.append(carry[0, : system.nx].copy())
                break
            carry, _ = clip_state(carry, dynamics.state_bounds)
            states.append(carry[0, : system.nx].copy())
    return np.array(states)


def _duration(dynamics: Dynamics) -> float:
    return STEPS * dynamics.system.dt


def _ranges(system: System, path: Array) -> str:
    parts = []
    for channel, values in zip(system.states, path.T, strict=True):
        low, high = float(values.min()), float(values.max())
        parts.append(f"{channel.name} {spelled_range(low, high)} {channel.unit}".rstrip())
    return ", ".join(parts)


def _clipped(dynamics: Dynamics, path: Array) -> str:
    if dynamics.state_bounds is None:
        return ""
    rest = dynamics.system.neutral_state
    held = [
        channel.name
        for channel, values, least, most, start in zip(
            dynamics.system.states, path.T, *dynamics.state_bounds, rest, strict=True
        )
        if (values.max() >= most > start) or (values.min() <= least < start)
    ]
    return f" ({', '.join(held)} held at the limit)" if held else ""


def _lost(system: System, path: Array) -> str:
    """Return the states that are no longer finite, and when."""
    names = [channel.name for channel, value in zip(system.states, path[-1], strict=True) if not np.isfinite(value)]
    return (
        f"leaves all bounds: {', '.join(names)} is not finite after {(len(path) - 1) * system.dt:g} s. Check "
        "the equations, or use a shorter dt"
    )


def _speed(dynamics: Dynamics, stop: StopRequest) -> SelfTestFinding:
    system = dynamics.system
    carry = started(dynamics, np.tile(system.neutral_state, (BATCH, 1)))
    control, noise = np.tile(system.neutral_control, (BATCH, 1)), np.zeros((BATCH, dynamics.n_noise))
    began, steps = time.perf_counter(), 0
    for _ in range(STEPS):
        with stop.answer("the robot's equations"):
            dynamics.step(carry, control, noise)
        steps += 1
        if stop.reason is not None or time.perf_counter() - began > MAX_TIMING:
            break
    seconds = (time.perf_counter() - began) * STEPS / steps
    form = "NumPy (a kernel() makes it ten times as fast)" if dynamics.kernel() is None else "compiled"
    form = f"NumPy ({ENGINE_VARIABLE} names the reference)" if resolve() == "reference" else form
    sentence = f"Rollouts are {form}; in NumPy {BATCH} trials of {STEPS} steps take {seconds:.2f} s."
    return SelfTestFinding("speed", True, sentence, {"seconds": seconds})
