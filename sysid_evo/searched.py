"""Where the parameters of a family are worth looking for: what it declares in its ``searched``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias


@dataclass(frozen=True)
class Within:
    """Numbers from ``low`` to ``high``; with ``log``, every factor is as likely as any other."""

    low: float
    high: float
    log: bool = False


@dataclass(frozen=True)
class OneOf:
    """One of these values, of any kind that a spec can write."""

    values: tuple[Any, ...]


Searched: TypeAlias = Within | OneOf
