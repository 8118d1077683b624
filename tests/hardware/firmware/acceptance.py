"""The rules of acceptance once more, in Python and in unbounded time: what the C core must agree with."""

from __future__ import annotations

from dataclasses import dataclass, field

from hardware.link.messages import Buttons, CommandMessage, Hello, State

LONGEST_LIFE = 150  # ms
WINDOW = 16
LEAK = 128  # ms


@dataclass
class Acceptance:
    """A robot as the rules describe it; times in ms, ``session`` as the robot has told it."""

    state: State = State.WAITING
    buttons: Buttons = Buttons.NONE
    session: int = 0
    nonce: int | None = None
    sequence: int = 0
    transit: int = 0
    leaked: int = 0
    deadline: int = 0
    counters: dict[str, int] = field(default_factory=lambda: {"duplicate": 0, "late": 0, "trips": 0})

    def pass_time(self, now: int) -> None:
        if self.state == State.DRIVING and now >= self.deadline:
            self.state, self.buttons = State.TRIPPED, Buttons.NONE
            self.counters["trips"] += 1

    def hello(self, message: Hello, session: int) -> None:
        """Take a HELLO that the robot has answered with ``session``."""
        if message.major != 1:
            self.state, self.buttons = State.WAITING, Buttons.NONE
            assert session == 0
        elif self.state == State.WAITING or message.nonce != self.nonce:
            assert session not in (0, self.session)
            self.state, self.buttons, self.session = State.NEUTRAL, Buttons.NONE, session
            self.nonce, self.sequence = message.nonce, 0
        else:
            assert session == self.session

    def command(self, message: CommandMessage, now: int) -> bool:
        """Take a well-formed CMD; return whether it counts."""
        if self.state not in (State.NEUTRAL, State.DRIVING):
            return False
        fresh = self.state == State.NEUTRAL
        ahead = (message.sequence - self.sequence) % 65536
        if message.session != self.session or not 1 <= ahead <= (32767 if fresh else WINDOW):
            self.counters["duplicate"] += 1
            return False
        if fresh and message.buttons:
            return False
        transit = (now - message.host_ms) % 65536
        if fresh:
            self.transit, self.leaked = transit, now
        leaks = (now - self.leaked) // LEAK
        self.transit, self.leaked = self.transit + leaks, self.leaked + leaks * LEAK
        excess = (transit - self.transit + 32768) % 65536 - 32768
        life = 10 * message.time_to_live
        if not -LONGEST_LIFE <= excess < life:
            self.counters["late"] += 1
            return False
        self.transit = min(self.transit, self.transit + excess)
        self.deadline = now + life - max(excess, 0)
        self.state, self.buttons, self.sequence = State.DRIVING, message.buttons, message.sequence
        return True

    def stop(self) -> None:
        self.state, self.buttons = State.WAITING, Buttons.NONE
