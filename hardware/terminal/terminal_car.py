"""The emulated car as a physical robot is met: on a serial port, seen by a tracker, in real time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hardware.emulation.car_physics import CAR
from hardware.link.serial_connection import SerialConnection
from hardware.link.serial_robot import SerialRobot
from hardware.listener import RobotStatus
from hardware.measurement import Measurement
from hardware.robot import Connection, Robot
from hardware.terminal.faults import Fault
from hardware.terminal.terminal_process import TerminalProcess
from hardware.trackers.tracker import Tracker, TrackerStream
from hardware.trackers.udp import UdpTracker
from sysid_evo.arrays import Array
from sysid_evo.registry import register_robot

BODY = "car"


@register_robot("terminal_car")
class TerminalCar(Robot):
    """A toy car whose firmware, physics and tracker run in a process of their own, started for each session.

    ``seed`` makes another car of the kind, see `CarParameters.perturbed`. ``faults`` are `Fault` or
    tables of their entries; ``journal`` is a file for what buttons and wire did. The link and the
    tracker are those of a physical robot.
    """

    dynamics = None

    def __init__(
        self,
        *,
        seed: int | None = None,
        faults: Sequence[Fault | Mapping[str, Any]] = (),
        journal: str | Path | None = None,
    ) -> None:
        self.name = "terminal_car" if seed is None else f"terminal_car:{seed}"
        self.system = CAR
        self.car = seed
        self.faults = tuple(fault if isinstance(fault, Fault) else Fault.read(fault) for fault in faults)
        self.journal = None if journal is None else Path(journal)

    def connect(self, *, seed: int | None = None) -> TerminalConnection:
        """Start the car and open a session; ``seed`` fixes its noise and what its faults hit. Raises `LinkLost`."""
        with ExitStack() as opened:
            stream = opened.enter_context(UdpTracker(BODY, 0, clock="host").open())
            process = opened.enter_context(
                TerminalProcess(
                    tracker=stream.address,
                    body=BODY,
                    seed=seed,
                    car=self.car,
                    faults=self.faults,
                    journal=self.journal,
                )
            )
            link = SerialRobot(port=process.port, tracker=_OpenTracker(stream), name=self.name).connect()
            opened.pop_all()
        return TerminalConnection(link, process)


class TerminalConnection(Connection):
    """The session ``link`` on the port of ``process``, which ends with it."""

    def __init__(self, link: SerialConnection, process: TerminalProcess) -> None:
        self.link = link
        self.process = process

    @property
    def time(self) -> float:
        return self.link.time

    @property
    def status(self) -> RobotStatus | None:
        return self.link.status

    def send(self, control: Array, *, valid_for: float) -> None:
        self.link.send(control, valid_for=valid_for)

    def measure(self, timeout: float) -> Measurement | None:
        return self.link.measure(timeout)

    def close(self) -> None:
        self.link.close()
        self.process.close()


@dataclass(frozen=True)
class _OpenTracker(Tracker):
    """A tracker that is open already, because the car must know where to send its frames."""

    stream: TrackerStream
    body: str = BODY
    name = "udp"

    def open(self) -> TrackerStream:
        return self.stream
