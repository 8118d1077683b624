"""One drives, the others watch."""

from __future__ import annotations

from typing import Any

from hardware.driving.keyboard import ALL_KEYS, Keyboard, Punctuality


class InvalidWord(ValueError):
    """What came is not what the page sends."""


class Seat:
    """One open page. Its words count only while it drives, and its keys only once it has said that none is held."""

    def __init__(self, seats: Seats, keyboard: Keyboard) -> None:
        self._seats = seats
        self._keyboard = keyboard
        self._punctuality = Punctuality()
        self._seen_released = False

    @property
    def drives(self) -> bool:
        return self._seats.driver is self

    def hear(self, word: Any, arrival: float) -> None:
        """Act on what the page says; ``arrival`` is in s. Raises `InvalidWord`.

        ``word`` has the ``keys`` held (a bit for each), the page's ``clock`` in s and, at most,
        ``new``: a new trial is wanted.
        """
        if not isinstance(word, dict) or not {"keys", "clock"} <= word.keys() <= {"keys", "clock", "new"}:
            raise InvalidWord("expected keys, clock and perhaps new")
        keys, clock, new = word["keys"], word["clock"], word.get("new", False)
        if type(keys) is not int or not 0 <= keys <= ALL_KEYS:
            raise InvalidWord(f"keys: expected 0 to {ALL_KEYS}, got {keys!r}")
        if type(clock) not in (int, float) or not abs(clock) < 1e12:
            raise InvalidWord(f"clock: expected seconds, got {clock!r}")
        if type(new) is not bool:
            raise InvalidWord(f"new: expected true or false, got {new!r}")
        on_time = self._punctuality.on_time(clock, arrival)
        if new and self.drives:  # it ends what is driven, so it is never too late for it
            self._keyboard.ask_for_new_trial()
        if not on_time or not self.drives:
            return
        self._seen_released = self._seen_released or keys == 0
        if self._seen_released:
            self._keyboard.press(keys)

    def leave(self) -> None:
        """Let go of the keys and make room for the one who has watched longest; a second call does nothing."""
        self._seats.remove(self)


class Seats:
    """The open pages in the order in which they came; the first one drives."""

    def __init__(self, keyboard: Keyboard) -> None:
        self._keyboard = keyboard
        self._taken: list[Seat] = []

    @property
    def driver(self) -> Seat | None:
        return self._taken[0] if self._taken else None

    @property
    def watchers(self) -> int:
        return max(0, len(self._taken) - 1)

    def take(self) -> Seat:
        """Return a seat for a page that was opened."""
        seat = Seat(self, self._keyboard)
        self._taken.append(seat)
        return seat

    def remove(self, seat: Seat) -> None:
        """Take back ``seat``; if it drove, all keys are released."""
        if seat not in self._taken:
            return
        if seat is self.driver:
            self._keyboard.release()
        self._taken.remove(seat)
