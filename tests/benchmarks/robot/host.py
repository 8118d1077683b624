"""A host that drives the car in circles until something happens to it: ``python -m tests.benchmarks.robot.host``.

It is the program that the stress tests kill, stop and cut off: the control loop, the serial link,
the tracker and the recorder of a real run. It ends with the exit code of its loop's report.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from pathlib import Path

import numpy as np

from hardware.connection import Command, Listener, Measurement
from hardware.control_loop import ControlLoop, Pilot
from hardware.estimator import StateEstimate
from hardware.link.serial_robot import SerialRobot
from hardware.recording.journal import Recorder
from hardware.run_report import LoopReport, StopRequest
from hardware.toy_car import CAR
from hardware.trackers.udp import UdpTracker
from sysid_evo.errors import IncompatibleRobot, LinkLost
from sysid_evo.types import Array
from tests.system.rig.journal import RigLogWriter

BODY = "car"
REFUSED = 20  # exit code of a session that could not be opened
DRIFT_TICKS = 100  # at either end of a run, whose median lateness gives its drift


class Circles(Pilot):
    """Full speed ahead and left, every other sample straight on, so that each command differs from the last."""

    def __init__(self, log: RigLogWriter, *, exception_at: int | None) -> None:
        self._log = log
        self._exception_at = exception_at

    def decide(self, tick: int, estimate: StateEstimate) -> Array:
        seen = {"tick": tick, "age": estimate.age, "pose": estimate.pose.tolist(), "state": estimate.state.tolist()}
        self._log.note(time.monotonic(), "decide", seen)
        if tick == self._exception_at:
            self._log.note(time.monotonic(), "fails")
            raise ArithmeticError("as asked for")
        return np.array([1.0, float(tick % 2)])


class Log(Listener):
    """Notes every frame that comes, at the time it was taken, and every command that is sent."""

    def __init__(self, log: RigLogWriter) -> None:
        self._log = log

    def on_measurement(self, measurement: Measurement) -> None:
        self._log.note(measurement.source_time, "frame", measurement.valid)

    def on_command(self, command: Command) -> None:
        self._log.note(command.time, "sent", {"tick": command.tick, "control": command.control.tolist()})


def drive(options: argparse.Namespace, log: RigLogWriter) -> LoopReport:
    """Drive until the samples are over or something ends the run."""
    robot = SerialRobot(port=options.port, tracker=UdpTracker(BODY, options.tracker, clock="host"))
    with StopRequest() as stops, robot.connect() as connection:
        if options.thread_dies_after is not None:
            threading.Timer(options.thread_dies_after, _die, [log]).start()
        with Recorder(options.record, CAR, robot=robot.name) as recorder:
            loop = ControlLoop(connection, CAR, listeners=[Log(log), recorder], stop=stops)
            return loop.run(Circles(log, exception_at=options.exception_at), samples=options.samples)


def _die(log: RigLogWriter) -> None:
    log.note(time.monotonic(), "fails")
    raise ArithmeticError("as asked for")


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--port", required=True)
    parser.add_argument("--tracker", type=int, required=True, help="port that frames are sent to")
    parser.add_argument("--log", type=Path, required=True)
    parser.add_argument("--record", type=Path, required=True, help="journal of the recorder")
    parser.add_argument("--samples", type=int)
    parser.add_argument("--exception-at", type=int, help="sample at which the pilot fails")
    parser.add_argument("--thread-dies-after", type=float, help="s")
    options = parser.parse_args()
    log = RigLogWriter(options.log)
    try:
        report = drive(options, log)
    except (IncompatibleRobot, LinkLost) as error:
        log.note(time.monotonic(), "ended", {"reason": "REFUSED", "detail": str(error)})
        return REFUSED
    figures = {
        "reason": report.reason.name,
        "detail": report.detail,
        "lateness": report.lateness.tolist(),
        "gaps": report.gaps.tolist(),
        "drift": drift_of(report.lateness),
        "skipped": report.skipped,
        "stale": report.stale,
        "rejected": dict(report.rejected),
    }
    log.note(time.monotonic(), "ended", figures)
    return report.reason.exit_code


def drift_of(lateness: Array) -> float:
    """Return the increase of the lateness (s) from the first to the last ticks; 0 for a run of one tick."""
    count = min(DRIFT_TICKS, len(lateness) // 2)
    return float(np.median(lateness[-count:]) - np.median(lateness[:count])) if count else 0.0


if __name__ == "__main__":
    sys.exit(main())
