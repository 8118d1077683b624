"""The contract of a tracker: frames of one body, as they come."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from hardware.measurement import Measurement
from hardware.session import Session
from sysid_evo.extras import check_installed


class TrackerStream(Session):
    """An open tracker; use it in a ``with`` statement. One thread reads it."""

    @abstractmethod
    def read(self, timeout: float) -> Measurement | None:
        """Return the next frame, or None if there is none within ``timeout`` s. Raises `LinkLost`.

        Frames that came in between calls are kept and returned in turn.
        """

    @abstractmethod
    def fileno(self) -> int:
        """Return a descriptor that is readable while a frame is waiting, for `select`."""

    @abstractmethod
    def close(self) -> None:
        """End the stream and whatever feeds it; a second call does nothing."""


class Tracker(ABC):
    """A source of poses of one ``body``, described by its arguments and opened for a session.

    The constructor checks its arguments and touches nothing else: no network, no device, no file.
    ``requires`` are the modules that it imports only when it is opened.
    """

    requires: ClassVar[tuple[str, ...]] = ()
    name: str
    body: str

    def check(self) -> None:
        """Raise what `open` would raise and what can be known without opening anything: a package, a file."""
        check_installed(f"tracker {self.name!r}", self.requires)

    @abstractmethod
    def open(self) -> TrackerStream:
        """Start it. Raises `LinkLost` if nothing answers, `MissingExtra` if a package is not installed."""
