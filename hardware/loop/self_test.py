"""Looks at a robot without moving it: link, tracker, loop, and how late its state will be known."""

from __future__ import annotations

import time

import numpy as np

from hardware.connection import Connectable, Connection
from hardware.finding import Finding
from hardware.listener import Listener, RobotStatus
from hardware.loop.control_loop import STALE, ControlLoop
from hardware.loop.delay import estimator_delays
from hardware.loop.demands import LATEST, check_loop
from hardware.loop.pilot import Estimate, Pilot
from hardware.loop.report import LoopReport
from hardware.loop.stops import Stops
from hardware.measurement import Measurement
from sysid_evo.arrays import Array
from sysid_evo.errors import LinkLost
from sysid_evo.system import System

SECONDS = 3.0
STILL_DISTANCE = 0.02  # m and
STILL_ANGLE = 0.1  # rad: the farthest that a robot in neutral may seem to move


def self_test(
    robot: Connectable, *, seconds: float = SECONDS, seed: int | None = None, stops: Stops | None = None
) -> tuple[Finding, ...]:
    """Connect to ``robot``, send neutral for ``seconds`` and say what was seen; nothing moves.

    Raises `IncompatibleSystem` if the control loop cannot drive its system.
    """
    check_loop(robot.system)
    began = time.perf_counter()
    try:
        connection = robot.connect(seed=seed)
    except LinkLost as error:
        return (Finding("handshake", False, f"Nothing answers: {error}"),)
    with connection:
        took = time.perf_counter() - began
        sitter = Sitter(connection, robot.system)
        loop = ControlLoop(connection, robot.system, listeners=[sitter], stops=stops)
        report = loop.run(sitter.pilot, samples=round(seconds / robot.system.dt))
        handshake = Finding("handshake", True, f"{robot.name} answered within {took:.2f} s.", {"seconds": took})
        return (handshake, sitter.link(), sitter.tracker(), _loop(report), *sitter.estimate())


class Sitter(Listener):
    """Writes down everything while nothing is done."""

    def __init__(self, connection: Connection, system: System) -> None:
        self.pilot = Idle(system)
        self._connection = connection
        self._system = system
        self._frames: list[Measurement] = []
        self._statuses: list[RobotStatus] = []
        self._round_trips: list[float] = []

    def measured(self, measurement: Measurement) -> None:
        self._frames.append(measurement)

    def reported(self, status: RobotStatus) -> None:
        self._statuses.append(status)
        if self._connection.round_trip is not None:
            self._round_trips.append(self._connection.round_trip)

    def link(self) -> Finding:
        """What the robot said of itself."""
        if not self._statuses:
            return Finding("link", True, "The robot says nothing of itself.")
        first, last = self._statuses[0], self._statuses[-1]
        risen = {
            name: count - first.counters.get(name, 0)
            for name, count in last.counters.items()
            if count > first.counters.get(name, 0)
        }
        driven = not np.array_equal(last.control, self._system.neutral_control)
        parts = [f"It is {last.state}, its outputs {'are not neutral' if driven else 'neutral'}"]
        figures: dict[str, float] = {f"risen_{name}": count for name, count in risen.items()}
        if self._round_trips:
            median, longest = float(np.median(self._round_trips)), max(self._round_trips)
            parts.append(f"a command is answered in {1e3 * median:.1f} ms (at most {1e3 * longest:.1f})")
            figures |= {"round_trip": median, "longest_round_trip": longest}
        if risen:
            parts.append("it counted " + ", ".join(f"{count} {name}" for name, count in risen.items()))
        return Finding("link", not risen and not driven, "; ".join(parts) + ".", figures)

    def tracker(self) -> Finding:
        """How often, how late and how reliably the body is seen, and whether it stays where it is."""
        seen = [frame for frame in self._frames if frame.valid]
        if len(seen) < 2:
            return Finding("tracker", False, f"Of {len(self._frames)} frames {len(seen)} show the body.")
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
        still = figures["moved"] <= STILL_DISTANCE and figures["turned"] <= STILL_ANGLE
        ms = {name: 1e3 * figures[name] for name in ("latency", "longest_latency", "longest_gap", "moved")}
        sentence = (
            f"{figures['rate']:.0f} frames/s of {seen[0].body}, {figures['valid_share']:.1%} of them valid, "
            f"{ms['latency']:.1f} ms after they were taken (at most {ms['longest_latency']:.1f}), "
            f"at most {ms['longest_gap']:.0f} ms apart; "
            f"it {'stays within' if still else 'moves by'} {ms['moved']:.1f} mm and "
            f"{np.degrees(figures['turned']):.1f} degrees."
        )
        return Finding("tracker", still and figures["longest_gap"] <= STALE, sentence, figures)

    def estimate(self) -> tuple[Finding, ...]:
        """How late the state is known: the age of the pose when a control is decided, and the estimator's delay."""
        ages, times = self.pilot.ages, [frame.source_time for frame in self._frames]
        if not ages or len(times) < 2:
            return ()
        age = float(np.mean(ages))
        delays = estimator_delays(self._system, frame_interval=(times[-1] - times[0]) / (len(times) - 1))
        estimator = max(delay.seconds for delay in delays)
        sentence = (
            f"Poses are {1e3 * age:.1f} ms old when a control is decided and the estimator adds "
            f"{1e3 * estimator:.1f} ms: evolve with --estimator-delay {1e3 * (age + estimator):.0f}."
        )
        return (Finding("estimate", True, sentence, {"age": age, "estimator": estimator, "delay": age + estimator}),)


class Idle(Pilot):
    """Decides on neutral and keeps the ages of the poses."""

    def __init__(self, system: System) -> None:
        self.ages: list[float] = []
        self._neutral = system.neutral_control

    def decide(self, tick: int, estimate: Estimate) -> Array | None:
        self.ages.append(estimate.age)
        return self._neutral


def _loop(report: LoopReport) -> Finding:
    """Say whether the loop ran to its end, and how punctual it was."""
    if report.reason.is_fault or not report.ticks:
        return Finding("loop", False, f"It was cut short: {report.sentence}.")
    figures = {
        "ticks": float(report.ticks),
        "lateness_p99": float(np.percentile(report.lateness, 99)),
        "longest_lateness": float(report.lateness.max()),
        "skipped": float(report.skipped),
    }
    sentence = (
        f"{report.ticks} commands, 99 % of them within {1e3 * figures['lateness_p99']:.1f} ms of when they were due "
        f"(all within {1e3 * figures['longest_lateness']:.1f}), {report.skipped} left out."
    )
    return Finding("loop", figures["longest_lateness"] <= LATEST and report.skipped == 0, sentence, figures)
