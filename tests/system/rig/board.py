"""The board in the remote control: the firmware between the wire and the four buttons."""

from __future__ import annotations

import time
from dataclasses import replace

from hardware.link.messages import FrameDecoder, HelloAcknowledgement, encode, unpack
from tests.system.rig.core import FirmwareCore
from tests.system.rig.faults import FaultSchedule
from tests.system.rig.journal import RigLogWriter
from tests.system.rig.pseudo_port import PseudoPort
from tests.system.rig.wire import Wire

POWER_ON, EXTERNAL = 1, 2  # causes of a reset, bits of the AVR's register MCUSR


class Board:
    """Gives the firmware its bytes and the time, and the host its answers.

    ``buttons`` are those closed, bits as in a command. ``journal`` gets everything that happens, at
    the time it happens.
    """

    def __init__(self, port: PseudoPort, faults: FaultSchedule, journal: RigLogWriter) -> None:
        self.buttons = 0
        self._port = port
        self._faults = faults
        self._journal = journal
        self._inward, self._outward = Wire(faults), Wire(faults)
        self._resets = self._starts = 0
        self._restart()

    @property
    def due(self) -> float:
        """When the board has to be looked at next, whatever the host does (s)."""
        return min(self._inward.due, self._outward.due)

    def switch(self, now: float) -> None:
        """Unplug, plug in or reset, as the faults say at ``now``."""
        unplugged = self._faults.active("unplug", now)
        if unplugged and self._port.plugged:
            self._port.unplug()
            self._inward.clear()
            self._outward.clear()
            self._journal.note(time.monotonic(), "unplug")
        elif not unplugged and not self._port.plugged:
            self._port.plug()
            self._journal.note(time.monotonic(), "plug")
        resets = self._faults.begun("reset", now)
        if resets > self._resets:
            self._resets = resets
            self._restart()
            self._journal.note(time.monotonic(), "reset", self._starts)
            self._note_buttons()

    def talk(self, now: float) -> None:
        """Pass on what has arrived at either end by ``now``, the bytes to the firmware one by one."""
        self._inward.push(self._port.read(), now)
        arrived = self._inward.pull(now)
        if arrived:
            self._journal.note(now, "in", arrived.hex())
        for byte in arrived:
            self._core.receive(bytes([byte]), self._clock())
            self._note_buttons()
        self._core.tick(self._clock())
        self._note_buttons()
        answer = self._core.transmit()
        if self._faults.active("version", now):
            answer = _next_version(answer)
        self._outward.push(answer, now)
        leaving = self._outward.pull(now)
        if leaving:
            self._journal.note(time.monotonic(), "out", leaving.hex())
            self._port.write(leaving)

    def _restart(self) -> None:
        self._starts += 1
        self._started = time.monotonic()
        cause = POWER_ON if self._starts == 1 else EXTERNAL
        self._core = FirmwareCore(reset_cause=cause, boot_count=self._starts)

    def _clock(self) -> int:
        return int((time.monotonic() - self._started) * 1000.0) & 0xFFFFFFFF

    def _note_buttons(self) -> None:
        buttons = self._core.buttons
        if buttons != self.buttons:
            self.buttons = buttons
            self._journal.note(time.monotonic(), "buttons", buttons)


def _next_version(frames: bytes) -> bytes:
    """Return ``frames`` with the next major version in every answer to a HELLO."""
    bodies = FrameDecoder().feed(frames)
    messages = [unpack(body) for body in bodies]
    changed = [
        replace(message, major=message.major + 1).pack() if isinstance(message, HelloAcknowledgement) else body
        for message, body in zip(messages, bodies, strict=True)
    ]
    return b"".join(encode(body) for body in changed)
