"""Checks of values from a robot's file or a caller: each returns the value, or raises an error with the expectation."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from sysid_evo.errors import InvalidArgument, did_you_mean


def check_text(what: str, value: object) -> str:
    """Return ``value`` if it is a text that is not empty."""
    if not isinstance(value, str) or not value.strip():
        raise InvalidArgument(f"{what}: expected a text in quotes, got {value!r}")
    return value


def check_number(what: str, value: object, *, minimum: float = -math.inf, above: float = -math.inf) -> float:
    """Return ``value`` as a finite number of at least ``minimum`` and greater than ``above``."""
    given = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
    if math.isfinite(given) and minimum <= given and above < given:
        return given
    limits = f" above {above:g}" if above > -math.inf else f" of {minimum:g} or more" if minimum > -math.inf else ""
    raise InvalidArgument(f"{what}: expected a number{limits}, got {value!r}")


def check_integer(what: str, value: object, *, minimum: int, maximum: int) -> int:
    """Return ``value`` if it is a whole number from ``minimum`` to ``maximum``."""
    if isinstance(value, int) and not isinstance(value, bool) and minimum <= value <= maximum:
        return value
    raise InvalidArgument(f"{what}: expected a whole number from {minimum} to {maximum}, got {value!r}")


def check_choice(what: str, value: object, among: Iterable[str]) -> str:
    """Return ``value`` if it is one of the words ``among``."""
    words = tuple(among)
    if isinstance(value, str) and value in words:
        return value
    raise InvalidArgument(f"{what}: expected one of {', '.join(map(repr, words))}, got {value!r}")


def check_table(what: str, value: object, keys: Iterable[str]) -> dict[str, Any]:
    """Return ``value`` if it is a table with no keys but these ``keys``."""
    known = tuple(keys)
    if not isinstance(value, Mapping):
        raise InvalidArgument(f"{what}: expected a table with some of {', '.join(known)}, got {value!r}")
    for key in value:
        if key not in known:
            hint = did_you_mean(str(key), known)
            raise InvalidArgument(f"{what}: no key is called {key!r}.{hint} Known: {', '.join(known)}.")
    return dict(value)


def check_flag(what: str, value: object) -> bool:
    """Return ``value`` if it is true or false."""
    if isinstance(value, bool):
        return value
    raise InvalidArgument(f"{what}: expected true or false, got {value!r}")
