"""A serial port that can be unplugged: a pseudo-terminal behind a link whose name stays."""

from __future__ import annotations

import contextlib
import os
import tty
from pathlib import Path

CHUNK = 4096


class PseudoPort:
    """The robot's end of a pseudo-terminal; hosts open ``link``, as they would a port by its stable id.

    The other end is kept open here too, so that a host may come and go as on a real line. What a host
    does not read in time is lost, as on a real line.
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self._master = -1
        self._slave = -1

    @property
    def plugged(self) -> bool:
        return self._master >= 0

    def fileno(self) -> int:
        """Return the descriptor to wait on; -1 while unplugged."""
        return self._master

    def plug(self) -> None:
        """Make a new pair of ends and let the link point to it."""
        self._master, self._slave = os.openpty()
        for end in (self._master, self._slave):
            tty.setraw(end)
        os.set_blocking(self._master, False)
        fresh = self.link.with_name(self.link.name + ".new")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(os.ttyname(self._slave))
        fresh.replace(self.link)

    def unplug(self) -> None:
        """Take the port away: hosts that have it open read its end, the link is gone."""
        if self.plugged:
            self.link.unlink(missing_ok=True)
            os.close(self._slave)
            os.close(self._master)
            self._master = self._slave = -1

    def read(self) -> bytes:
        """Return what the host has written; empty if nothing."""
        try:
            return os.read(self._master, CHUNK) if self.plugged else b""
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Send ``data`` to the host."""
        if data and self.plugged:
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, data)
