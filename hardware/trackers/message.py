"""A frame of a tracker, read from one JSON object in bytes that nobody vouches for."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidData

LONGEST = 1024  # bytes of a message
LARGEST_FRAME = 2**63 - 1
LARGEST = 1e12
"""Of times in s, coordinates in m and angles in rad: room for a clock in any use, none for an overflow."""
N_POSE = 3


@dataclass(frozen=True)
class FrameMessage:
    """What a message says: ``time`` in s on the source's clock, planar ``pose`` (3,) in m, m, rad or nan."""

    time: float
    frame: int
    body: str
    valid: bool
    pose: Array


def parse_message(data: bytes) -> FrameMessage:
    """Return what ``data`` says. Raises `InvalidData` on anything but a whole message of sound numbers."""
    if len(data) > LONGEST:
        raise InvalidData(f"frame: expected at most {LONGEST} bytes, got more")
    try:
        fields = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InvalidData(f"frame: expected a JSON object, got {data[:40]!r}") from error
    if not isinstance(fields, dict):
        raise InvalidData(f"frame: expected a JSON object, got {type(fields).__name__}")
    frame, body, valid = (fields.get(name) for name in ("frame", "body", "valid"))
    if type(frame) is not int or not 0 <= frame <= LARGEST_FRAME:
        raise InvalidData(f"frame: expected frame, a whole number from 0 to 2^63 - 1, got {_short(frame)}")
    if not isinstance(body, str):
        raise InvalidData(f"frame: expected body, a name, got {_short(body)}")
    if not isinstance(valid, bool):
        raise InvalidData(f"frame: expected valid, true or false, got {_short(valid)}")
    time = _finite(fields.get("time"), "time")
    pose = np.full(N_POSE, np.nan)
    if valid:
        values = fields.get("pose")
        if not isinstance(values, list) or len(values) != N_POSE:
            raise InvalidData(f"frame: expected pose, a list of x, y and heading, got {_short(values)}")
        pose = np.array([_finite(value, "pose") for value in values])
    return FrameMessage(time, frame, body, valid, pose)


def _finite(value: Any, name: str) -> float:
    if type(value) in (int, float) and -LARGEST < value < LARGEST:
        return float(value)
    raise InvalidData(f"frame: expected numbers within {LARGEST:g} in {name}, got {_short(value)}")


def _short(value: Any) -> str:
    return type(value).__name__ if isinstance(value, (int, list, dict)) else repr(value)[:40]
