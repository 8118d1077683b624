"""A host that speaks RCB/1 on a port and nothing more, for tests of the other end."""

from __future__ import annotations

import os
import select
import time
import tty
from pathlib import Path
from types import TracebackType
from typing import Self

from hardware.link.framing import FrameDecoder, encode
from hardware.link.messages import (
    Buttons,
    CommandMessage,
    Hello,
    HelloAcknowledgement,
    Message,
    State,
    StatusMessage,
    Stop,
    unpack,
)

PATIENCE = 5.0  # s: long, because nothing here measures speed
LIFE = 15  # 10 ms


class BareHost:
    """Opens ``port`` and asks for a session."""

    def __init__(self, port: str | Path) -> None:
        self._end = os.open(port, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._end)
        self._decoder = FrameDecoder()
        self._sequence = 0
        self.heard: list[Message] = []
        self.session = 0

    def hello(self, nonce: int = 1) -> HelloAcknowledgement:
        """Open a session and return the answer."""
        self.write(Hello(1, 0, nonce))
        while True:
            for message in self.listen():
                if isinstance(message, HelloAcknowledgement) and message.nonce == nonce:
                    self.session = message.session
                    return message

    def command(self, buttons: Buttons) -> None:
        self._sequence += 1
        milliseconds = int(time.monotonic() * 1000.0) & 0xFFFF
        self.write(CommandMessage(self.session, self._sequence, milliseconds, buttons, LIFE))

    def stop(self) -> None:
        self.write(Stop(self.session, self._sequence + 1))

    def status(self, buttons: Buttons, state: State | None = None) -> StatusMessage:
        """Return the first status from now on with these ``buttons`` closed and in this ``state``."""
        while True:
            for message in self.listen():
                if isinstance(message, StatusMessage) and message.buttons == buttons and state in (None, message.state):
                    return message

    def drive(self, buttons: Buttons) -> None:
        """Command neutral, then ``buttons``, and wait until they are closed."""
        for wanted in (Buttons.NONE, buttons):
            self.command(wanted)
            self.status(wanted)

    def write(self, message: Message) -> None:
        os.write(self._end, encode(message.pack()))

    def listen(self) -> list[Message]:
        """Return what comes next. Raises `TimeoutError`, or `EOFError` if the port is gone."""
        if not select.select([self._end], [], [], PATIENCE)[0]:
            raise TimeoutError("nothing from the robot")
        data = os.read(self._end, 4096)
        if not data:
            raise EOFError("the port is gone")
        messages = [message for message in map(unpack, self._decoder.feed(data)) if message is not None]
        self.heard += messages
        return messages

    def close(self) -> None:
        os.close(self._end)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
