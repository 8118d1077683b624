"""The loop of the emulated car: board, physics and tracker, each when it is due."""

from __future__ import annotations

import json
import os
import select
import time

from hardware.link.messages import Buttons
from hardware.link.serial_robot import control_of_buttons
from tests.system.rig.board import Board
from tests.system.rig.faults import Fault, FaultSchedule
from tests.system.rig.journal import RigLogWriter
from tests.system.rig.moving_car import MovingCar
from tests.system.rig.pose_stream import PoseStream
from tests.system.rig.pseudo_port import PseudoPort

LONGEST_WAIT = 0.1  # s between two looks at the parent
LINES = 4096  # bytes read at once from the host's side


class Terminal:
    """Runs a car until its host ends. Every part looks at the same ``faults``."""

    def __init__(
        self,
        port: PseudoPort,
        board: Board,
        car: MovingCar,
        poses: PoseStream,
        faults: FaultSchedule,
        journal: RigLogWriter,
    ) -> None:
        self._port, self._board, self._car, self._poses = port, board, car, poses
        self._faults, self._journal = faults, journal

    def run(self, host: int) -> None:
        """Run until the descriptor ``host`` closes or the parent dies.

        What arrives on ``host`` are further faults, a JSON object a line, whose ``at`` counts from then.
        """
        parent = os.getppid()
        self._journal.note(time.monotonic(), "start", os.getpid())
        while os.getppid() == parent:
            readable = self._wait(host)
            now = time.monotonic()
            if host in readable and not self._told(os.read(host, LINES), now):
                self._board.talk(now)  # the host's last words may still be on the wire
                break
            self._board.switch(now)
            self._board.talk(now)
            for frame in self._car.move(now, control_of_buttons(Buttons(self._board.buttons))):
                self._poses.add(frame)
            self._poses.send(now)
        figures = {"frames": self._car.frames, "given_up": self._car.given_up, "lateness": self._car.lateness}
        self._journal.note(time.monotonic(), "end", figures)

    def _wait(self, host: int) -> list[int]:
        """Return the descriptors that can be read, as soon as one can or something is due."""
        now = time.monotonic()
        due = min(self._car.due, self._poses.due, self._board.due, self._faults.next_change(now))
        descriptors = [host, self._port.fileno()] if self._port.plugged else [host]
        return select.select(descriptors, [], [], min(max(due - now, 0.0), LONGEST_WAIT))[0]

    def _told(self, data: bytes, now: float) -> bool:
        """Take in faults; return whether the host is still there."""
        for line in data.splitlines():
            fault = Fault(**json.loads(line))
            self._faults.add(fault, now)
            self._journal.note(now + fault.at, "fault", fault.kind)
        return bool(data)
