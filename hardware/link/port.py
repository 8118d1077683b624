"""A serial port as a descriptor: never blocks, belongs to one program, reports at once that it is gone."""

from __future__ import annotations

import errno
import os
import select
import termios
from pathlib import Path

from sysid_evo.errors import InvalidArgument, LinkLost

BAUD = 115200
BY_ID = Path("/dev/serial/by-id")
NO_DEVICE = "no such device; is the robot plugged in?"
REASONS = {
    errno.ENOENT: NO_DEVICE,
    errno.EACCES: "not permitted; see the udev rule in docs/hardware.md",
    errno.EAGAIN: "another program uses it",
    errno.EBUSY: "another program uses it",
}
CHUNK = 4096
CHUNKS = 16  # read at most at once, so that a device that sends continuously cannot block the host


def only_port() -> str:
    """Return the only serial device. Raises `InvalidArgument` if there are none or several."""
    ports = sorted(map(str, BY_ID.iterdir())) if BY_ID.is_dir() else []  # the names do not change when plugged in again
    if len(ports) != 1:
        raise InvalidArgument(
            f"serial robot: expected port, or one device in {BY_ID} to choose; found {', '.join(ports) or 'none'}"
        )
    return ports[0]


class SerialPort:
    """An open port, 115200 8N1. Raises `LinkLost` if it is missing, not permitted, in use, or disconnected."""

    def __init__(self, name: str) -> None:
        import serial

        self.name = name
        self._torn = False
        try:
            self._serial = serial.Serial(name, BAUD, timeout=0, write_timeout=0, exclusive=True)
        except OSError as error:  # a SerialException is one, too
            raise LinkLost(f"port {name}: {REASONS.get(error.errno or 0, str(error))}") from error
        self._poll = select.poll()
        self._poll.register(self.fileno(), select.POLLIN)

    def fileno(self) -> int:
        """Return the descriptor, readable when bytes are waiting or the port is gone."""
        return int(self._serial.fileno())

    def read(self) -> bytes:
        """Return all bytes that are waiting, maybe none."""
        data = bytearray()
        for _ in range(CHUNKS):
            if not self._poll.poll(0):
                break
            try:
                piece = os.read(self.fileno(), CHUNK)
            except BlockingIOError:
                break
            except OSError as error:
                raise LinkLost(f"port {self.name} is gone: {error.strerror}") from error
            if not piece:
                raise LinkLost(f"port {self.name} is gone: it hung up")
            data += piece
        return bytes(data)

    def write(self, frames: bytes) -> None:
        """Pass ``frames`` to the port, or as much of them as there is room for; nothing is repeated."""
        if self._torn:
            frames = b"\0" + frames
        try:
            written = os.write(self.fileno(), frames)
        except BlockingIOError:
            written = 0
        except OSError as error:
            raise LinkLost(f"port {self.name} is gone: {error.strerror}") from error
        if written:
            self._torn = written < len(frames)

    def discard(self) -> None:
        """Discard data that have been written and not sent."""
        try:
            self._serial.reset_output_buffer()
        except (OSError, termios.error) as error:
            raise LinkLost(f"port {self.name} is gone: {error}") from error
        self._torn = True

    def close(self) -> None:
        """Release the port; a second call does nothing."""
        self._serial.close()
