"""What is said of a robot that was looked at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at: whether it is as it should be, a sentence, and its figures."""

    what: str
    ok: bool
    sentence: str
    figures: Mapping[str, float] = field(default_factory=dict)
