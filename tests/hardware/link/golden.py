"""A conversation of a host with a robot, byte for byte: what both sides of RCB/1 must read and write."""

from __future__ import annotations

from dataclasses import dataclass

from hardware.link.messages import (
    Buttons,
    CommandMessage,
    Hello,
    HelloAcknowledgement,
    Message,
    State,
    StatusMessage,
    Stop,
)

ROBOT = {"firmware_build": 0x0102, "reset_cause": 4, "boot_count": 7}
SESSION = 0x0319


@dataclass(frozen=True)
class Exchange:
    """At ``now_ms`` of the robot's clock ``said`` gets there as ``sent``; ``answer`` comes back as ``received``."""

    now_ms: int
    said: Message
    sent: str
    answer: Message
    received: str


def _status(clock_ms: int, sequence: int, state: State, buttons: Buttons = Buttons.NONE) -> StatusMessage:
    return StatusMessage(SESSION, sequence, state, buttons, clock_ms, 0, 0, 0, 0, 0)


CONVERSATION = (
    Exchange(
        50,
        Hello(1, 0, 0x12345678),
        "0301010778563412f5dc00",
        HelloAcknowledgement(1, 0, 0x0102, 15, 4, 7, 0x12345678, SESSION),
        "0381010602010f04070978563412190353ce00",
    ),
    Exchange(
        70,
        CommandMessage(SESSION, 1, 1000, Buttons.NONE, 15),
        "050219030107e803f00fdd9d00",
        _status(70, 1, State.DRIVING),
        "05821903010402f04601010101010101010101010103a41600",
    ),
    Exchange(
        120,
        CommandMessage(SESSION, 2, 1050, Buttons.FORWARD | Buttons.LEFT, 15),
        "0502190302071a04a50fc25500",
        _status(120, 2, State.DRIVING, Buttons.FORWARD | Buttons.LEFT),
        "05821903020402a578010101010101010101010101032ffc00",
    ),
    Exchange(
        171,
        CommandMessage(SESSION, 4, 1100, Buttons.BACKWARD | Buttons.RIGHT, 5),
        "0502190304074c045a05342800",
        _status(171, 4, State.DRIVING, Buttons.BACKWARD | Buttons.RIGHT),
        "058219030404025aab01010101010101010101010103093900",
    ),
    Exchange(
        200,
        Stop(SESSION, 4),
        "0503190304039a8200",
        _status(200, 4, State.WAITING),
        "05821903040103f0c80101010101010101010101010329e100",
    ),
    Exchange(
        250,
        Hello(2, 1, 0xFF),
        "05010201ff0101031d2300",
        HelloAcknowledgement(1, 0, 0x0102, 15, 4, 7, 0xFF, 0),
        "0381010602010f040702ff0101010103164800",
    ),
)
