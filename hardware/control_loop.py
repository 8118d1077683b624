"""The loop that drives a robot: frames in, estimate, decision of a pilot, command out, at a fixed rate."""

from __future__ import annotations

import gc
import math
import os
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path

import numpy as np

from hardware.connection import TIME_TO_LIVE, Command, Connection, Listener, Measurement, RobotStatus
from hardware.estimator import PoseEstimator, StateEstimate, StateEstimator
from hardware.gate import PoseGate
from hardware.run_report import LoopReport, StopReason, StopRequest
from sysid_evo.errors import IncompatibleSystem, LinkLost
from sysid_evo.system import System
from sysid_evo.types import Array

STALE = 0.1  # s: with an older pose the command is neutral
LOST = 0.5  # s: an older pose ends the run
FIRST_POSE = 1.0  # s within which the first estimate must exist
POLL = 0.02  # s: the longest time that the loop waits at once
SHORTEST = 0.001  # s: the shortest time that it waits for a pose to become stale
CLOCK_TOLERANCE = 1e-9  # s
ON_THE_CLOCK = 1.0  # s between a session's clock and the host's, if they are the same; simulated time begins at 0
AHEAD = -10  # nice value of the threads of a loop that may not run in real time


class ControlLoop:
    """Drives ``connection`` by a pilot, one decision every ``system.dt``, and notifies the listeners.

    Deadlines are absolute: tick k is due k dt after the first, and one that is late by dt or more is skipped, so that
    the loop neither drifts nor catches up. Time passes only in `Connection.measure`, so it runs unchanged in simulated
    time, all in the calling thread. A run starts in neutral until poses give an estimate. A tick whose newest pose is
    older than 100 ms sends neutral without asking the pilot (and neutral does not wait for the tick); a pose older than
    500 ms ends the run. Every command is checked and valid for 150 ms. The loop follows the body of the first frame
    within the connection's ``gate_limits``. Raises `IncompatibleSystem` for a system that it cannot drive
    (`check_loop`).

    A run that ends normally leaves the robot in neutral, the connection open, poses and gate unchanged. Any other exit,
    exceptions included, closes the connection first.
    """

    def __init__(
        self,
        connection: Connection,
        system: System,
        *,
        listeners: Sequence[Listener] = (),
        estimator: StateEstimator | None = None,
        stop: StopRequest | None = None,
    ) -> None:
        check_loop(system)
        self.connection = connection
        self.system = system
        self.stop = StopRequest() if stop is None else stop
        self._listeners = tuple(listeners)
        self._estimator: StateEstimator = PoseEstimator(system) if estimator is None else estimator
        self._gate: PoseGate | None = None
        self._driving = False
        self._status: RobotStatus | None = None
        self._rejected: Counter[str] = Counter()
        self._ticks: list[tuple[float, float]] = []
        self._skipped = self._stale = self._tick = 0
        self._opened = 0.0
        self._seen: float | None = None

    def run(self, pilot: Pilot, *, samples: int | None = None) -> LoopReport:
        """Drive until ``samples`` are over or ``pilot`` or a fault ends it, and return the report.

        Raises errors of ``pilot`` and listeners, and `InvalidArgument` if the pilot decides on an illegal control.
        """
        self._rejected.clear()
        self._ticks, self._skipped, self._stale = [], 0, 0
        gc.freeze()  # a collection over everything ever imported takes up to a tenth of a second
        in_real_time = abs(self.connection.time - time.monotonic()) < ON_THE_CLOCK
        try:
            try:
                with before_others() if in_real_time else nullcontext():
                    reason, detail = self._drive(pilot, samples)
                if not reason.is_fault:
                    self._send(self.system.neutral_control, self.connection.time)
            except LinkLost as error:
                reason, detail = self.stop.reason or StopReason.LINK_LOST, str(error)
        except BaseException:
            self.connection.close()
            raise
        finally:
            gc.unfreeze()
        if reason.is_fault:
            self.connection.close()
        sent = np.array(self._ticks).reshape(-1, 2)
        return LoopReport(
            reason=reason,
            detail=detail,
            lateness=sent[:, 1] - sent[:, 0],
            gaps=np.diff(sent[:, 1]),
            skipped=self._skipped,
            stale=self._stale,
            rejected=dict(self._rejected),
        )

    def _drive(self, pilot: Pilot, samples: int | None) -> tuple[StopReason, str]:
        """Send a command for every tick until something ends the run; return the reason."""
        neutral, dt = self.system.neutral_control, self.system.dt
        self._opened = opened = self.connection.time
        first: int | None = None
        index = self._tick = -1
        while True:
            index += 1
            ended = self._wait(opened + index * dt, started=first is not None)
            if ended is not None:
                return ended
            now = self.connection.time
            newest = math.floor((now - opened + CLOCK_TOLERANCE) / dt)
            if first is not None:
                self._skipped += max(0, newest - index)
            index = max(index, newest)
            estimate = self._estimator.estimate(now) if self._age(now) <= STALE + CLOCK_TOLERANCE else None
            if first is None and estimate is not None:
                first = index
            if first is None:
                if now - opened > FIRST_POSE:
                    return StopReason.TRACKER_LOST, self._why_no_pose(
                        f"no pose to start from within {FIRST_POSE:.1f} s"
                    )
                self._send(neutral, opened + index * dt)
                continue
            self._tick = index - first
            if samples is not None and self._tick >= samples:
                return StopReason.SAMPLES, ""
            if estimate is None:
                self._stale += 1
                self._send(neutral, opened + index * dt)
            else:
                control = pilot.decide(self._tick, estimate)
                if control is None:
                    return StopReason.PILOT, ""
                if not np.isfinite(control).all():
                    return StopReason.NOT_FINITE, f"sample {self._tick}: the pilot decided on {np.asarray(control)}"
                self._send(self.system.check_control(control), opened + index * dt)
            self._ticks.append((opened + index * dt, self.connection.time))

    def _wait(self, due: float, *, started: bool) -> tuple[StopReason, str] | None:
        """Take in frames until ``due`` and then those that are waiting; return the reason if one ends the run."""
        connection = self.connection
        enough = max(due, connection.time) + 0.5 * self.system.dt
        while True:
            if self.stop.reason is not None:
                return self.stop.reason, self.stop.detail
            now = connection.time
            until_stale = max(SHORTEST, STALE - self._age(now)) if started and self._driving else math.inf
            with self.stop.answer("the robot or its tracker"):
                measurement = connection.measure(max(0.0, min(due - now, POLL, until_stale)))
            if self._tripped():
                return StopReason.TRIPPED, ""
            now = connection.time
            if measurement is not None:
                self._take(measurement)
                if now - measurement.source_time > STALE and now < enough:
                    continue  # newer ones are waiting: the newest is not known yet
            age = self._age(now)
            if started and age > LOST + CLOCK_TOLERANCE:
                return StopReason.TRACKER_LOST, self._why_no_pose(f"the newest pose is {age:.2f} s old")
            if started and self._driving and age > STALE + CLOCK_TOLERANCE:
                self._send(self.system.neutral_control, now)
            if due - now <= CLOCK_TOLERANCE and (measurement is None or now >= enough):
                return None

    def _take(self, measurement: Measurement) -> None:
        """Notify the listeners of a frame and use it if it is accepted."""
        for listener in self._listeners:
            listener.on_measurement(measurement)
        if self._gate is None:
            self._gate = PoseGate(measurement.body, self.connection.gate_limits)
        verdict = self._gate.accept(measurement, driving=self._driving)
        if verdict.new_track:
            self._estimator.restart()
        if verdict.accepted:
            self._estimator.add(measurement)
            self._seen = min(measurement.source_time, measurement.arrival_time)
        else:
            self._rejected[verdict.reason] += 1

    def _send(self, control: Array, due: float) -> None:
        with self.stop.answer("the robot"):
            self.connection.send(control, valid_for=TIME_TO_LIVE)
        self._driving = not np.array_equal(control, self.system.neutral_control)
        command = Command(self._tick, due, self.connection.time, control.copy())
        for listener in self._listeners:
            listener.on_command(command)

    def _tripped(self) -> bool:
        """Notify the listeners of a new status; return whether the robot stopped itself in this run."""
        status = self.connection.status
        if status is None or (self._status is not None and status.time <= self._status.time):
            return False
        self._status = status
        for listener in self._listeners:
            listener.on_status(status)
        return status.state == "tripped" and status.time >= self._opened

    def _age(self, now: float) -> float:
        """Return the age of the newest accepted pose in s; infinite without one."""
        return math.inf if self._seen is None else now - self._seen

    def _why_no_pose(self, what: str) -> str:
        """Return ``what`` with the number of rejected frames by reason, and the exceeded limit, if any."""
        counts = ", ".join(f"{count} {why}" for why, count in self._rejected.most_common())
        beyond = "" if self._gate is None else self._gate.excess
        return what + (f"; frames not used: {counts}" if counts else "") + (f" ({beyond})" if beyond else "")


class Pilot(ABC):
    """A driver (a controller, a script or a person), asked for the control of every sample."""

    @abstractmethod
    def decide(self, tick: int, estimate: StateEstimate) -> Array | None:
        """Return the control (nu,) for sample ``tick``, or None to end the run in neutral."""


@contextmanager
def before_others() -> Iterator[None]:
    """Give the threads of this process a higher priority while a robot is driven, as far as the system allows.

    That is real-time scheduling if the user has the right to it (root, or ``rtprio`` in /etc/security/limits.conf),
    else a lower nice value (``nice`` there), else no change. Processes that they start do not inherit it.
    """
    found: list[tuple[int, int, os.sched_param, int]] = []
    threads = Path("/proc/self/task")
    for thread in [int(task.name) for task in threads.iterdir()] if threads.is_dir() else []:
        with suppress(ProcessLookupError):
            usual = os.sched_getscheduler(thread), os.sched_getparam(thread), os.getpriority(os.PRIO_PROCESS, thread)
            with suppress(PermissionError):
                try:
                    os.sched_setscheduler(thread, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(1))
                except PermissionError:
                    os.setpriority(os.PRIO_PROCESS, thread, AHEAD)
                found.append((thread, *usual))
    try:
        yield
    finally:
        for thread, policy, parameters, nice in found:
            with suppress(ProcessLookupError, PermissionError):
                # only root may remove the flag; it has no effect on a normal thread
                os.sched_setscheduler(thread, policy | os.SCHED_RESET_ON_FORK, parameters)
                os.setpriority(os.PRIO_PROCESS, thread, nice)


LATEST = 0.05  # s that a command may be late without a stop of the robot in between
SLOWEST = TIME_TO_LIVE - LATEST  # s: the longest sampling time
PLANAR = 3  # numbers of a pose that the gate can check


def check_loop(system: System) -> None:
    """Raise `IncompatibleSystem` unless the loop can command ``system`` in time and measure its pose."""
    if system.nu == 0:
        raise IncompatibleSystem("the control loop: expected a system with at least one control, got none")
    if system.n_pose != PLANAR:
        raise IncompatibleSystem(
            "the control loop: expected a system whose motion gives a planar pose (x, y, heading), got "
            + ("no motion" if system.motion is None else f"the motion {system.motion.kind}")
        )
    if system.dt > SLOWEST + CLOCK_TOLERANCE:
        raise IncompatibleSystem(
            f"the control loop: expected a sampling time dt of at most {SLOWEST:g} s, got {system.dt:g} s. A command "
            f"is valid for {TIME_TO_LIVE:g} s and the next may be {LATEST:g} s late, so that at a longer dt the robot "
            "would fall back to neutral between two commands; give the system a shorter dt"
        )
