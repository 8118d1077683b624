"""Which states a task wants where: channels of any system, by name."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.system import Channel, System

Names: TypeAlias = str | Sequence[str]
Numbers: TypeAlias = float | Sequence[float] | None
"""One number for all channels, or one for each; None for the task's own choice."""
TOLERANCES = 20.0
"""The range of the targets in tolerances, where no tolerance is given."""


@dataclass(frozen=True)
class Goal:
    """One state that is to be led: its ``channel`` and its ``place`` among the states of the system.

    All in the channel's unit: targets lie between ``low`` and ``high``; an error of one ``tolerance``, or a change of
    ``still`` per second, costs half of the score; a trial begins within ``spread`` of its start, and is over once
    the error exceeds ``end``.
    """

    channel: Channel
    place: int
    low: float
    high: float
    tolerance: float
    still: float = math.inf
    spread: float = 0.0
    end: float = math.inf

    @property
    def period(self) -> float:
        """The period of the channel, 0 if it has none."""
        return self.channel.period or 0.0


def listed(names: Names) -> tuple[str, ...]:
    """Return ``names`` as a tuple; an empty text is none."""
    if isinstance(names, str):
        return (names,) if names else ()
    return tuple(names)


def numbers(what: str, given: Numbers, count: int, default: Sequence[float]) -> tuple[float, ...]:
    """Return ``given`` for each of ``count`` channels. Raises `InvalidArgument` unless there are one or ``count``."""
    if given is None:
        return tuple(default)
    values = [given] if isinstance(given, int | float) else list(given)
    if len(values) not in (1, count):
        raise InvalidArgument(f"{what}: expected one number, or one for each of {count} channels, got {len(values)}")
    if any(isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value) for value in values):
        raise InvalidArgument(f"{what}: expected numbers, got {given!r}")
    return tuple(float(value) for value in (values * count if len(values) == 1 else values))


def places(task: str, names: Sequence[str], system: System) -> tuple[int, ...]:
    """Return where the states called ``names`` stand. Raises `IncompatibleTask` naming one that is missing."""
    if system.nx == 0:
        raise IncompatibleTask(f"{task} needs a state to lead; {system.name or 'this system'} has none")
    for name in names:
        if name not in system.state_names:
            raise IncompatibleTask(f"{task} needs the state {name!r}; the states are {', '.join(system.state_names)}")
    if len(set(names)) < len(names):
        raise InvalidArgument(f"{task}: expected every state once, got {', '.join(names)}")
    return tuple(system.state_names.index(name) for name in names)


def middle_half(channel: Channel) -> tuple[float, float]:
    """Return the middle half of a channel's limits; without both, 1 either side of neutral (an eighth of a period)."""
    if channel.bounded:
        quarter = 0.25 * (channel.high - channel.low)
        return channel.low + quarter, channel.high - quarter
    reach = 1.0 if channel.period is None else channel.period / 8.0
    return channel.neutral - reach, channel.neutral + reach


def goals_of(
    task: str,
    system: System,
    channels: Names,
    low: Numbers,
    high: Numbers,
    tolerance: Numbers,
    *,
    still: Numbers = math.inf,
    spread: Numbers = 0.0,
    end: Numbers = math.inf,
) -> tuple[Goal, ...]:
    """Return the goals for ``channels`` (default: the first state), with the usual values where none are given."""
    found = places(task, listed(channels) or system.state_names[:1], system)
    states, count = [system.states[place] for place in found], len(found)
    middle = [middle_half(channel) for channel in states]
    lows = numbers(f"{task}: low", low, count, [ends[0] for ends in middle])
    highs = numbers(f"{task}: high", high, count, [ends[1] for ends in middle])
    widths = [b - a if b > a else ends[1] - ends[0] for a, b, ends in zip(lows, highs, middle, strict=True)]
    tolerances = numbers(f"{task}: tolerance", tolerance, count, [width / TOLERANCES for width in widths])
    stills = numbers(f"{task}: still", still, count, [math.inf] * count)
    spreads = numbers(f"{task}: spread", spread, count, [0.0] * count)
    ends = numbers(f"{task}: end", end, count, [math.inf] * count)
    chosen = zip(states, found, lows, highs, tolerances, stills, spreads, ends, strict=True)
    return tuple(Goal(*values) for values in chosen)
