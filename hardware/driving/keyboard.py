"""Dead-man keys: how long a key is valid, which open page drives, which messages are too late."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from hardware.driving.page_messages import ALL_KEYS, BACKWARD, FORWARD, LEFT, RIGHT, keys_message
from sysid_evo.errors import InvalidArgument
from sysid_evo.system import Channel, System
from sysid_evo.types import Array

HOLD = 0.15  # s after the last message of the page by which the robot must be in neutral
LATE = 0.1  # s of transport, in addition to the fastest, that make a message of the page too old
CREEP = 0.001  # s/s by which the fastest transport is forgotten: more than two clocks drift apart


class Keyboard:
    """The keys that are held: a bit for each, set by one thread and read by another.

    A message is valid for ``life`` s, within which it must be repeated; without it no key is held. A loop that reads
    the keys every dt is in neutral within 150 ms if ``life`` is 150 ms minus dt. ``clock`` is in s and monotonic.
    """

    def __init__(self, *, life: float, clock: Callable[[], float] = time.monotonic) -> None:
        if not life > 0.0:
            raise InvalidArgument(f"keyboard: expected keys to hold for more than 0 s, got {life}")
        self.life = life
        self._clock = clock
        self._held = 0, clock()  # the keys, and the time of the message
        self._again = threading.Event()

    def press(self, keys: int) -> None:
        """Set the keys that are held now."""
        self._held = keys & ALL_KEYS, self._clock()

    def release(self) -> None:
        """Release all keys."""
        self._held = 0, self._clock()

    @property
    def keys(self) -> int:
        """The keys that are held now."""
        keys, received = self._held
        return keys if self._clock() - received <= self.life else 0

    @property
    def all_released(self) -> bool:
        """Whether the newest message had no key held; an overdue message does not count as that."""
        return self._held[0] == 0

    def request_new_trial(self) -> None:
        """Store the person's request for a new trial."""
        self._again.set()

    @property
    def new_trial_wanted(self) -> bool:
        """Whether a new trial was requested; true until `take_new_trial`."""
        return self._again.is_set()

    def take_new_trial(self) -> bool:
        """Return whether a new trial was requested since the last call."""
        requested = self._again.is_set()
        self._again.clear()
        return requested


class LateMessageFilter:
    """Detects messages of one page that were delayed on their way and are out of date.

    The transport time of a message is its arrival (s, our clock) minus its stamp (s, the page's clock). The clocks are
    independent, so it is compared with the fastest message so far.
    """

    def __init__(self) -> None:
        self._fastest: float | None = None
        self._newest = 0.0

    def on_time(self, stamp: float, arrival: float) -> bool:
        way = arrival - stamp
        if self._fastest is None:
            self._fastest = way
        else:
            self._fastest = min(self._fastest + CREEP * max(0.0, arrival - self._newest), way)
        self._newest = arrival
        return way - self._fastest <= LATE


def key_validity(system: System) -> float:
    """Return for how long a message of the page is valid in a loop at ``system.dt``; raises `InvalidArgument`."""
    if system.dt >= HOLD:
        raise InvalidArgument(
            f"driving by hand: expected a sampling time below {HOLD} s, within which lost keys must give "
            f"neutral, got {system.dt} s"
        )
    return HOLD - system.dt


def control_of_keys(keys: int, system: System) -> Array:
    """Return the control (nu,) for the keys that are held.

    The first control is the drive, the last one the steering (+1 is left); a key sets it to its limit. Opposite keys
    cancel each other. Raises `InvalidArgument` for a control without limits.
    """
    control = system.neutral_control.copy()
    control[0] = _deflected(system.controls[0], bool(keys & FORWARD) - bool(keys & BACKWARD))
    if system.nu > 1:
        control[-1] = _deflected(system.controls[-1], bool(keys & LEFT) - bool(keys & RIGHT))
    return control


def _deflected(channel: Channel, way: int) -> float:
    if not channel.bounded:
        raise InvalidArgument(
            f"control {channel.name!r} has no finite limits for keys to set it to: give low and high, or levels"
        )
    return (channel.neutral, channel.high, channel.low)[way]


class PageClient:
    """One open page. Its messages count only while it drives, its keys only after a message without keys."""

    def __init__(self, seats: PageClients, keyboard: Keyboard) -> None:
        self._seats = seats
        self._keyboard = keyboard
        self._punctuality = LateMessageFilter()
        self._seen_released = False

    @property
    def is_driver(self) -> bool:
        return self._seats.driver is self

    def receive(self, given: Any, arrival: float) -> None:
        """Handle a message of the page, see `keys_message`; ``arrival`` is in s. Raises `InvalidPageMessage`."""
        message = keys_message(given)
        on_time = self._punctuality.on_time(message.clock, arrival)
        if message.new_trial and self.is_driver:  # it ends the present trial, so it is never too late
            self._keyboard.request_new_trial()
        if not on_time or not self.is_driver:
            return
        self._seen_released = self._seen_released or message.keys == 0
        if self._seen_released:
            self._keyboard.press(message.keys)


class PageClients:
    """The open pages in the order in which they were opened; the first one drives."""

    def __init__(self, keyboard: Keyboard) -> None:
        self._keyboard = keyboard
        self._taken: list[PageClient] = []

    @property
    def driver(self) -> PageClient | None:
        return self._taken[0] if self._taken else None

    @property
    def watchers(self) -> int:
        return max(0, len(self._taken) - 1)

    def join(self) -> PageClient:
        """Return the client of a newly opened page."""
        seat = PageClient(self, self._keyboard)
        self._taken.append(seat)
        return seat

    def remove(self, seat: PageClient) -> None:
        """Remove a client; if it drove, release all keys, and the page that has watched longest drives.

        A second call does nothing.
        """
        if seat not in self._taken:
            return
        if seat is self.driver:
            self._keyboard.release()
        self._taken.remove(seat)
