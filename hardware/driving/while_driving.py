"""A listener in front of another: a person may take an hour before the first key, which nobody wants to record."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from hardware.driving.human_pilot import HumanPilot, Phase
from hardware.listener import Command, Listener, RobotStatus
from hardware.measurement import Measurement

LEAD = 1.0  # s at rest before the first key, for the preparation of the log to cut off


class WhileDriving(Listener):
    """Tells ``listener`` what happens from a second before ``pilot`` drives on.

    ``make_listener`` is called, once, when the driving begins: a trial without a key leaves nothing.
    """

    def __init__(self, pilot: HumanPilot, make_listener: Callable[[], Listener]) -> None:
        self._pilot = pilot
        self._make = make_listener
        self._listener: Listener | None = None
        self._earlier: deque[tuple[float, Callable[[Listener], None]]] = deque()

    def measured(self, measurement: Measurement) -> None:
        self._tell(measurement.arrival_time, lambda listener: listener.measured(measurement))

    def commanded(self, command: Command) -> None:
        self._tell(command.time, lambda listener: listener.commanded(command))

    def reported(self, status: RobotStatus) -> None:
        self._tell(status.time, lambda listener: listener.reported(status))

    def close(self) -> None:
        if self._listener is not None:
            self._listener.close()

    def _tell(self, time: float, tell: Callable[[Listener], None]) -> None:
        if self._listener is not None:
            tell(self._listener)
            return
        self._earlier.append((time, tell))
        while self._earlier[0][0] < time - LEAD:
            self._earlier.popleft()
        if self._pilot.progress.phase is Phase.DRIVING:
            self._listener = self._make()
            for _, earlier in self._earlier:
                earlier(self._listener)
            self._earlier.clear()
