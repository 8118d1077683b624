"""How numbers, shares, intervals and names are written, in tables, on plots and in sentences."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from evaluation.transfer.uncertainty import Estimate, PairedEstimate


def number(value: float | None, digits: int = 1) -> str:
    """Return ``value`` with that many decimals, a dash for None and nan."""
    return f"{value:.{digits}f}" if value is not None and np.isfinite(value) else "–"


def three_digits(value: float | None) -> str:
    """Return ``value`` with about three digits: 0.123, 1.23, 12.3, 123; a dash for None and nan."""
    size = abs(value or 0.0)
    return number(value, 3 if size < 0.9995 else 2 if size < 9.995 else 1 if size < 99.95 else 0)


def percent(share: float | None) -> str:
    """Return a share as per cent, with a decimal below ten."""
    if share is None or not np.isfinite(share):
        return "–"
    if 0 < share < 0.0005:
        return "<0.1 %"
    return f"{100 * share:.1f} %" if 0 < share < 0.0995 else f"{100 * share:.0f} %"


def plus_minus(estimate: Estimate | PairedEstimate | None) -> str:
    """Return ``11.5 ±0.3``, the value and its standard error; a dash for None."""
    return "–" if estimate is None else f"{number(estimate.value)} ±{number(estimate.standard_error)}"


def within(estimate: Estimate | None, digits: int = 1) -> str:
    """Return the value, and below it its interval: ``11.5`` over ``11.2 to 11.9``; a dash for None."""
    if estimate is None:
        return "–"
    ends = (estimate.low, estimate.high)
    known = all(map(np.isfinite, ends))
    return lines(number(estimate.value, digits), " to ".join(number(end, digits) for end in ends) if known else "")


def with_interval(value: float, low: float, high: float) -> str:
    """Return ``11.5 (11.2 to 11.9)``."""
    return f"{number(value)} ({number(low)} to {number(high)})"


def horizon_name(horizon: int | None, dt: float) -> str:
    """Return ``20 steps (1 s)`` for steps of ``dt`` seconds, or ``free run`` over whole episodes for None."""
    if horizon is None:
        return "free run"
    return f"{horizon} {'step' if horizon == 1 else 'steps'} ({horizon * dt:g} s)"


def few(names: Sequence[str], most: int = 4) -> str:
    """Return ``names`` in a row; of more than ``most`` and one the first ``most``, and how many more there are."""
    more = len(names) - most
    return ", ".join(names[:most]) + f" and {more} more" if more > 1 else ", ".join(names)


def listed(names: Sequence[str]) -> str:
    """Join names with commas, a dash for none."""
    return ", ".join(names) if names else "–"


def lines(*parts: str) -> str:
    """Join the parts that are not empty, one a line."""
    return "\n".join(part for part in parts if part)


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
