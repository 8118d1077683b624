"""Names and shares where space is short."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np


def folded(text: str, width: int = 12) -> str:
    """Break each line of ``text`` into lines of at most ``width``, after an underscore, hyphen, plus or space."""
    lines: list[str] = []
    for line in text.split("\n"):
        lines.append("")
        for part in re.findall(r"[^_\-+ ]*[_\-+ ]?", line):
            if part and lines[-1] and len(lines[-1]) + len(part.rstrip()) > width:
                lines.append("")
            lines[-1] += part
    return "\n".join(lines)


def few(names: Sequence[str], most: int) -> str:
    """Return ``names`` in a row; of more than ``most`` and one the first ``most``, and how many more there are."""
    more = len(names) - most
    return ", ".join(names[:most]) + f" and {more} more" if more > 1 else ", ".join(names)


def percent(share: float | None) -> str:
    """Return a share as per cent, with a decimal below ten."""
    if share is None or not np.isfinite(share):
        return "–"
    if 0 < share < 0.0005:
        return "<0.1 %"
    return f"{100 * share:.1f} %" if 0 < share < 0.0995 else f"{100 * share:.0f} %"
