"""Between the control of the toy car and the four buttons of its remote."""

from __future__ import annotations

import numpy as np

from hardware.link.messages import EXCLUSIVE, Buttons
from hardware.toy_car import CAR
from sysid_evo.arrays import Array, check_shape
from sysid_evo.errors import InvalidArgument

DRIVE = {-1.0: Buttons.BACKWARD, 0.0: Buttons.NONE, 1.0: Buttons.FORWARD}
STEER = {-1.0: Buttons.RIGHT, 0.0: Buttons.NONE, 1.0: Buttons.LEFT}


def buttons_of(control: Array) -> Buttons:
    """Return the buttons for ``control`` (2,): drive and steer, each -1, 0 or 1.

    Buttons that exclude each other cannot come out. Raises `ShapeError`, `InvalidArgument`.
    """
    values = check_shape("control", control, (CAR.nu,)).tolist()
    pressed = Buttons.NONE
    for value, table, name in zip(values, (DRIVE, STEER), CAR.control_names, strict=True):
        if value not in table:
            raise InvalidArgument(f"control {name!r}: expected -1, 0 or 1, got {value}")
        pressed |= table[value]
    return pressed


def control_of(buttons: Buttons) -> Array:
    """Return the control (2,) that closes ``buttons``. Raises `InvalidArgument` for a pair that excludes itself."""
    if any(buttons & pair == pair for pair in EXCLUSIVE):
        raise InvalidArgument(f"buttons: expected at most one of each pair, got {buttons!r}")
    drive = (Buttons.FORWARD in buttons) - (Buttons.BACKWARD in buttons)
    steer = (Buttons.LEFT in buttons) - (Buttons.RIGHT in buttons)
    return np.array([drive, steer], dtype=np.float64)
