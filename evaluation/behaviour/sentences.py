"""What a controller does, in a sentence or two."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evaluation.behaviour.chase import REACTIONS
from evaluation.behaviour.manner import Manner, unit_of
from evaluation.labels import percent

MOSTLY, HARDLY = 0.5, 0.1
"""Shares from which on, and below which, something is worth its words."""
SIDED = 0.75
"""Share of the turns to one side from which on it is told."""
APART = 0.15
"""Difference of two shares, or of two rates as a share of the larger, that is told between two systems."""


def describe(here: Manner, there: Sequence[Manner] = (), *, place: str = "") -> str:
    """Return what a controller does on one system, and what it does otherwise on others.

    ``place`` are the words for the system ("on the robot").
    """
    parts = [*_driving(here), *_chasing(here), *_settling(here), *_switching(here)]
    text = f"{f'{place[0].upper()}{place[1:]}: ' if place else ''}{'; '.join(parts)}." if parts else ""
    others = [said for other in there if (said := _otherwise(here, other))]
    return " ".join(filter(None, (text, *others)))


def described(manners: Sequence[Manner], robot: str | None) -> dict[str, str]:
    """Return what each controller does: on the robot, or else where it was evolved, and what it does otherwise."""
    found: dict[str, list[Manner]] = {}
    for manner in manners:
        found.setdefault(manner.controller, []).append(manner)
    told = {}
    for controller, several in found.items():
        here = next((one for one in several if one.column == robot), several[0])
        place = "on the robot" if here.column == robot else f"in {here.column}"
        told[controller] = describe(here, [one for one in several if one is not here], place=place)
    return {controller: text for controller, text in told.items() if text}


def _driving(manner: Manner) -> list[str]:
    speed, back, left = (manner.value(name) for name in ("speed", "backwards", "turning left"))
    if not np.isfinite(speed):
        return []
    parts = []
    if np.isfinite(back):
        way = "backwards" if back > MOSTLY else "forwards"
        parts.append(f"drives {way} {percent(max(back, 1.0 - back))} of the time at {speed:.2f} m/s")
    else:
        parts.append("hardly moves")
    if np.isfinite(left) and max(left, 1.0 - left) >= SIDED:
        parts.append(f"turns {'left' if left > MOSTLY else 'right'} in {percent(max(left, 1.0 - left))} of its turns")
    stops, standing = manner.value("stops per minute"), manner.value("standing")
    if stops >= 1.0:
        parts.append(f"stops {stops:.0f} times a minute")
    if standing >= HARDLY:
        parts.append(f"stands {percent(standing)} of the time")
    return parts


def _chasing(manner: Manner) -> list[str]:
    missed, orbiting = manner.value("missed at first"), manner.value("orbiting")
    parts = []
    if np.isfinite(missed):
        if missed < HARDLY / 2:
            parts.append("hardly ever misses a waypoint")
        else:
            parts.append(f"misses {percent(missed)} of the waypoints at first{_after(manner)}")
    if np.isfinite(orbiting) and orbiting > HARDLY / 10:
        parts.append(f"orbits a waypoint {percent(orbiting)} of the time")
    return parts


def _after(manner: Manner) -> str:
    """Return what follows a miss, most often first."""
    shares = {what: manner.value(f"{what} after a miss") for what in REACTIONS}
    known = {what: share for what, share in shares.items() if np.isfinite(share) and share >= HARDLY}
    told = [f"{what} ({percent(share)})" for what, share in sorted(known.items(), key=lambda pair: -pair[1])]
    delay = manner.value("reached after a miss in")
    back = f", and is there {delay:.1f} s later" if np.isfinite(delay) else ""
    return f", then {' or '.join(told)}{back}" if told else ""


def _settling(manner: Manner) -> list[str]:
    settled, seconds, within = (manner.value(name) for name in ("settled", "settling time", "within tolerance"))
    if not np.isfinite(settled):
        return []
    parts = [f"is within tolerance {percent(within)} of the time"]
    if settled < HARDLY:
        return [*parts, "never settles" if settled == 0.0 else f"settles in {percent(settled)} of the trials only"]
    return [*parts, f"settles after {seconds:.1f} s in {percent(settled)} of the trials"]


def _switching(manner: Manner) -> list[str]:
    ending = " switches per second"
    rates = {name.removesuffix(ending): one.value for name, one in manner.measures.items() if name.endswith(ending)}
    parts = [f"{name} {rate:.1f} times" for name, rate in rates.items() if rate >= HARDLY]
    told = [f"switches {' and '.join(parts)} a second"] if parts else []
    for name in rates:
        limit = manner.value(f"{name} at a limit")
        if HARDLY <= limit < 1.0:
            told.append(f"holds {name} at a limit {percent(limit)} of the time")
    return told


def _otherwise(here: Manner, other: Manner) -> str:
    """Return what differs clearly on another system, the most different first; empty if nothing does."""
    found = []
    for name, one in other.measures.items():
        own = here.measures.get(name)
        if own is None or not one.differs(own):
            continue
        size = abs(one.value - own.value)
        if unit_of(name):
            size /= max(one.value, own.value)
        if size >= APART:
            found.append((size, f"{name} {_told(name, one.value)} instead of {_told(name, own.value)}"))
    listed = [text for _, text in sorted(found, key=lambda pair: -pair[0])[:3]]
    return f"In {other.column}: {', '.join(listed)}." if listed else ""


def _told(name: str, value: float) -> str:
    unit = unit_of(name)
    if " per " in name:
        return f"{value:.1f}"
    return f"{value:.1f} {unit}" if unit else percent(value)
