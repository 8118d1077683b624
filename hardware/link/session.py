"""The host's side of one session with a robot: bytes in, bytes out, and time-outs; no port, no clock."""

from __future__ import annotations

from collections import deque
from math import floor

from hardware.link.messages import (
    MAJOR,
    MINOR,
    TIME_TO_LIVE_UNIT,
    Buttons,
    CommandMessage,
    FrameDecoder,
    Hello,
    HelloAcknowledgement,
    State,
    StatusMessage,
    Stop,
    encode,
    unpack,
)
from sysid_evo.errors import IncompatibleRobot, InvalidArgument, LinkLost

SILENCE = 0.25  # s without a message of the robot after which the link is lost
STOPS = 3
REMEMBERED = 64  # commands whose time of sending is kept until their status arrives


class HostSession:
    """One session: from the HELLO with ``nonce``, which no other session has, to the STOP.

    Times are in s on the host's clock. The host repeats only the HELLO: a lost command is replaced by the next one.
    Any end of a session is final.
    """

    def __init__(self, *, nonce: int) -> None:
        self.nonce = nonce
        self.acknowledgement: HelloAcknowledgement | None = None
        self.status: StatusMessage | None = None
        self.heard = 0.0
        self.round_trip: float | None = None
        self._decoder = FrameDecoder()
        self._sequence = 0
        self._sent: deque[tuple[int, float]] = deque(maxlen=REMEMBERED)
        self._last_command: float | None = None
        self._longest_pause = 0.0
        self._ended = ""

    @property
    def is_open(self) -> bool:
        """Whether the robot has answered the HELLO with a session."""
        return self.acknowledgement is not None and self.acknowledgement.session != 0

    def hello(self) -> bytes:
        """Return the frame that asks for the session; a repetition is the same request for the robot."""
        return encode(Hello(MAJOR, MINOR, self.nonce).pack())

    def receive(self, data: bytes, now: float) -> None:
        """Take in bytes from the robot; the newest status counts."""
        for body in self._decoder.feed(data):
            message = unpack(body)
            if isinstance(message, HelloAcknowledgement):
                if message.nonce == self.nonce and self.acknowledgement is None:
                    self.acknowledgement = message
                    self.heard = now
            elif isinstance(message, StatusMessage):
                self._reported(message, now)

    def check(self, now: float) -> None:
        """Raise `LinkLost` if the session has ended, or the robot has tripped or has been silent for too long.

        Raises `IncompatibleRobot` if it uses another major version. Call `receive` with all waiting bytes before.
        """
        acknowledgement = self.acknowledgement
        if acknowledgement is not None and acknowledgement.major != MAJOR:
            raise IncompatibleRobot(
                f"the robot uses RCB/{acknowledgement.major}.{acknowledgement.minor}, this host RCB/{MAJOR}.{MINOR}: "
                "flash the firmware of this version"
            )
        if not self._ended:
            self._ended = self._end(now)
        if self._ended:
            raise LinkLost(f"{self._ended}; connect again to continue")

    def command(self, buttons: Buttons, valid_for: float, now: float) -> bytes:
        """Return the frame that closes ``buttons`` for ``valid_for`` s at most, and no longer than the robot allows.

        A neutral command is sent before it until the robot has confirmed one. Raises `LinkLost`,
        `InvalidArgument`.
        """
        self.check(now)
        if self.acknowledgement is None:
            raise LinkLost("the robot has not answered the HELLO yet")
        if not valid_for >= TIME_TO_LIVE_UNIT:
            raise InvalidArgument(f"send: expected valid_for >= {TIME_TO_LIVE_UNIT} s, got {valid_for}")
        units = min(valid_for / TIME_TO_LIVE_UNIT + 1e-9, self.acknowledgement.max_time_to_live)
        self._longest_pause = self._pause(now)
        self._last_command = now
        frames = b""
        if buttons and (self.status is None or self.status.state != State.DRIVING):
            frames = self._frame(Buttons.NONE, floor(units), now)
        return frames + self._frame(buttons, floor(units), now)

    def stop(self) -> bytes:
        """Return the frames that open all buttons and end the session."""
        session = 0 if self.acknowledgement is None else self.acknowledgement.session
        self._ended = self._ended or "the session is closed"
        return encode(Stop(session, self._sequence).pack()) * STOPS

    def _pause(self, now: float) -> float:
        """Return the longest time without a command so far."""
        return max(self._longest_pause, 0.0 if self._last_command is None else now - self._last_command)

    def _frame(self, buttons: Buttons, time_to_live: int, now: float) -> bytes:
        assert self.acknowledgement is not None
        self._sequence = (self._sequence + 1) % 65536
        self._sent.append((self._sequence, now))
        host_ms = int(now * 1000.0) % 65536
        command = CommandMessage(self.acknowledgement.session, self._sequence, host_ms, buttons, time_to_live)
        return encode(command.pack())

    def _reported(self, message: StatusMessage, now: float) -> None:
        if self.acknowledgement is None:
            return
        self.heard = now
        if message.session != self.acknowledgement.session or message.state == State.WAITING:
            self._ended = self._ended or "the robot has left the session: it restarted or was stopped"
            return
        self.status = message
        for sequence, sent in self._sent:
            if sequence == message.last_sequence:
                self.round_trip = now - sent
        while self._sent and (message.last_sequence - self._sent[0][0]) % 65536 < 32768:
            self._sent.popleft()

    def _end(self, now: float) -> str:
        if self.status is not None and self.status.state == State.TRIPPED:
            return (
                "the robot has tripped: no command reached it within its time to live "
                f"(the host's longest pause between two was {self._pause(now):.3f} s)"
            )
        if self.is_open and now - self.heard > SILENCE:
            return f"the robot has been silent for {now - self.heard:.3f} s, longer than {SILENCE} s"
        return ""
