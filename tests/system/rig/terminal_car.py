"""The emulated car as a physical robot is met: on a serial port, seen by a tracker, in real time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hardware.connection import GateLimits, Measurement
from hardware.link.serial_robot import SerialConnection, SerialRobot
from hardware.robot import Robot
from hardware.toy_car import CAR
from hardware.trackers.tracker import Tracker, TrackerStream
from hardware.trackers.udp import UdpTracker
from tests.system.rig.faults import Fault
from tests.system.rig.terminal_process import TerminalProcess

BODY = "car"


class TerminalCar(Robot):
    """A toy car whose firmware, physics and tracker run in a process of their own, started for each session.

    ``seed`` makes another car of the kind, see `CarParameters.perturbed`. ``faults`` happen in every session;
    ``journal`` is a file for what buttons and wire did. The link and the tracker are those of a physical robot,
    ``gate`` are the limits of the tracker's frames. The constructor starts nothing.
    """

    requires = SerialRobot.requires
    dynamics = None

    def __init__(
        self,
        *,
        seed: int | None = None,
        faults: Sequence[Fault] = (),
        journal: Path | None = None,
        gate: GateLimits | None = None,
    ) -> None:
        self.name = "terminal_car" if seed is None else f"terminal_car:{seed}"
        self.system = CAR
        self.car = seed
        self.faults = tuple(faults)
        self.journal = journal
        self.gate = gate

    def connect(self, *, seed: int | None = None) -> SerialConnection:
        """Start the car and open a session; ``seed`` fixes its noise. Raises `LinkLost`."""
        stream = UdpTracker(BODY, 0, clock="host").open()
        try:
            process = TerminalProcess(
                tracker=stream.address, seed=seed, car=self.car, faults=self.faults, journal=self.journal
            )
        except BaseException:
            stream.close()
            raise
        return SerialRobot(
            port=process.port, tracker=_CarTracker(_CarStream(stream, process)), name=self.name, gate=self.gate
        ).connect()


class _CarStream(TrackerStream):
    """The frames of ``process``, which ends with them."""

    def __init__(self, stream: TrackerStream, process: TerminalProcess) -> None:
        self._stream = stream
        self._process = process

    def read(self, timeout: float) -> Measurement | None:
        return self._stream.read(timeout)

    def fileno(self) -> int:
        return self._stream.fileno()

    def close(self) -> None:
        self._stream.close()
        self._process.close()


@dataclass(frozen=True)
class _CarTracker(Tracker):
    """A tracker whose stream is open before the car starts, because the car must know where to send."""

    stream: TrackerStream
    body: str = BODY
    name = "udp"

    def open(self) -> TrackerStream:
        return self.stream
