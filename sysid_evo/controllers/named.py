"""Channels by name: where they stand among those that a task shows, or a system takes."""

from __future__ import annotations

import math
from collections.abc import Sequence

from sysid_evo.angles import TURN
from sysid_evo.errors import IncompatibleTask
from sysid_evo.system import Channel
from sysid_evo.tasks.task import Task


def observed(what: str, names: Sequence[str], task: Task) -> tuple[int, ...]:
    """Return where ``names`` stand among the observations of ``task``. Raises `IncompatibleTask`."""
    return _places(f"{what}: the task shows no", names, task.observations)


def controlled(what: str, names: Sequence[str], task: Task) -> tuple[int, ...]:
    """Return where ``names`` stand among the controls of the system of ``task``. Raises `IncompatibleTask`."""
    return _places(f"{what}: the system has no control", names, task.system.controls)


def _places(what: str, names: Sequence[str], channels: Sequence[Channel]) -> tuple[int, ...]:
    known = [channel.name for channel in channels]
    for name in names:
        if name not in known:
            raise IncompatibleTask(f"{what} {name!r}; there are {', '.join(known)}")
    return tuple(known.index(name) for name in names)


def size_of(channel: Channel) -> float:
    """Return how large the values of ``channel`` are: the larger of its limits, half a period, or 1 of its unit."""
    if channel.period is not None:
        return channel.period / 2.0
    return max(abs(channel.low), abs(channel.high)) if channel.bounded else 1.0


def period_of(channel: Channel) -> float | None:
    """Return the period of ``channel``, also of an angle that is shown within one turn; None for all others."""
    if channel.period is None and channel.unit == "rad" and math.isclose(channel.high - channel.low, TURN):
        return TURN
    return channel.period
