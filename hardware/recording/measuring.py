"""Manoeuvres that measure: a step, a coast-down, circles (after Abbeel et al. 2006; see `sysid_evo.data.measured`)."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np

from hardware.recording.excitation import LEAD, Manoeuvre
from hardware.recording.signals import Segment, extremes
from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidArgument
from sysid_evo.system import System

KINDS = ("step", "coast_down", "circle")
HELD = {"step": 4.0, "coast_down": 2.0, "circle": 5.0}
"""How long in s a command is held, of a system that drives; of others, 80 samples."""
SAMPLES = 80
REST = 3.0  # s without a command after it, in which the body comes to rest


def measuring(system: System, kind: str) -> list[Manoeuvre]:
    """Return the manoeuvres of one ``kind``, each from rest and back to it, named KIND-CONTROL-VALUE.

    ``step``: each control in turn goes to each of its ends, the others at rest, and back; of a system that drives, the
    propelling one only. ``coast_down``: full speed each way, then no command. ``circle``: left and right at full and,
    if the drive is continuous, at half speed; forwards, and backwards if it can. The last two want a motion.
    Raises `InvalidArgument`.
    """
    if kind not in KINDS:
        raise InvalidArgument(f"manoeuvre: expected one of {', '.join(KINDS)}, got {kind!r}")
    if system.nu == 0:
        raise InvalidArgument("manoeuvre: expected a system with at least one control, got none")
    if kind != "step" and system.motion is None:
        raise InvalidArgument(f"manoeuvre {kind}: expected a system that drives, this one has no motion; take step")
    if kind == "circle" and system.nu < 2:
        raise InvalidArgument("manoeuvre circle: expected a control that propels and one that steers, got one control")
    made: list[Manoeuvre] = []
    for control, value, steer in _commands(system, kind):
        command = system.neutral_control.copy()
        command[control] = value
        name = f"{kind}-{system.control_names[control]}-{value:g}"
        if steer is not None:
            command[-1] = steer
            name = f"{name}-{system.control_names[-1]}-{steer:g}"
        held = HELD[kind] if system.motion is not None else SAMPLES * system.dt
        rest = REST if system.motion is not None else held
        script: list[Segment] = [(system.neutral_control, LEAD), (command, held), (system.neutral_control, rest)]
        made.append(Manoeuvre(name, _sampled(script, system.dt)))
    return made


def _commands(system: System, kind: str) -> Iterator[tuple[int, float, float | None]]:
    """Yield control, value and steering of each manoeuvre."""
    if kind == "step" and system.motion is None:
        for control, channel in enumerate(system.controls):
            yield from ((control, value, None) for value in _ends(system, control) if value != channel.neutral)
        return
    drives = _ends(system, 0)
    if kind != "circle":
        yield from ((0, value, None) for value in drives)
        return
    channel = system.controls[0]
    if channel.levels is None:
        drives = [*drives, *(0.5 * (value + channel.neutral) for value in drives)]
    for value in drives:
        yield from ((0, value, steer) for steer in _ends(system, system.nu - 1)[::-1])


def _ends(system: System, control: int) -> list[float]:
    """Return the highest and, if it is another than neutral, the lowest value of a control."""
    channel = system.controls[control]
    low, high = extremes(channel)[[0, -1]].tolist()
    return [value for value in (high, low) if value != channel.neutral]


def _sampled(script: list[Segment], dt: float) -> Array:
    return np.array(list(chain.from_iterable([control] * max(1, round(seconds / dt)) for control, seconds in script)))
