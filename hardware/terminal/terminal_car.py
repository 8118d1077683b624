"""The emulated car as a physical robot is met: on a serial port, seen by a tracker, in real time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hardware.arguments import seed as checked_seed
from hardware.arguments import text
from hardware.firmware.build import compiler
from hardware.link.serial_robot import SerialRobot
from hardware.measurement import Measurement
from hardware.robot import Robot
from hardware.terminal.faults import Fault
from hardware.terminal.terminal_process import TerminalProcess
from hardware.toy_car import CAR
from hardware.trackers.gates import GateLimits
from hardware.trackers.tracker import Tracker, TrackerStream
from hardware.trackers.udp import UdpTracker
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import register_robot

if TYPE_CHECKING:
    from hardware.link.serial_connection import SerialConnection

BODY = "car"


@register_robot("terminal_car")
class TerminalCar(Robot):
    """A toy car whose firmware, physics and tracker run in a process of their own, started for each session.

    ``seed`` makes another car of the kind, see `CarParameters.perturbed`. ``faults`` are `Fault` or
    tables of their entries; ``journal`` is a file for what buttons and wire did. The link and the
    tracker are those of a physical robot. ``gate`` is a table of `GateLimits`. The constructor starts
    nothing. Raises `InvalidArgument`.
    """

    requires = SerialRobot.requires
    dynamics = None

    def __init__(
        self,
        *,
        seed: int | None = None,
        faults: Sequence[Fault | Mapping[str, Any]] = (),
        journal: str | Path | None = None,
        gate: GateLimits | Mapping[str, Any] | None = None,
    ) -> None:
        seed = checked_seed("robot terminal_car", seed)
        if isinstance(faults, str | Mapping) or not isinstance(faults, Sequence):
            raise InvalidArgument(f"robot terminal_car: expected faults to be a list of tables, got {faults!r}")
        if journal is not None and not isinstance(journal, Path):
            journal = Path(text("robot terminal_car: journal", journal))
        self.name = "terminal_car" if seed is None else f"terminal_car:{seed}"
        self.system = CAR
        self.car = seed
        self.faults = tuple(fault if isinstance(fault, Fault) else Fault.read(fault) for fault in faults)
        self.journal = journal
        self.gate = GateLimits.read(gate)

    def check(self) -> None:
        """Raise `InvalidArgument` if there is no C compiler, which the firmware needs."""
        super().check()
        compiler()

    def connect(self, *, seed: int | None = None) -> SerialConnection:
        """Start the car and open a session; ``seed`` fixes its noise and what its faults hit. Raises `LinkLost`."""
        stream = UdpTracker(BODY, 0, clock="host").open()
        try:
            process = TerminalProcess(
                tracker=stream.address, body=BODY, seed=seed, car=self.car, faults=self.faults, journal=self.journal
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
