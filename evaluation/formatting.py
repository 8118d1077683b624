"""Text of numbers, shares, intervals and names, in tables, on plots and in sentences."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # the command line imports this module before it knows what else it needs
    from sysid_evo.validation.estimates import Estimate


def number(value: float | None, digits: int = 1) -> str:
    """Return ``value`` with that many decimals, a dash for None and NaN. A value that rounds to zero has no sign."""
    if value is None or not np.isfinite(value):
        return "–"
    return f"{value:z.{digits}f}"


def three_digits(value: float | None) -> str:
    """Return ``value`` with about three digits: 0.123, 1.23, 12.3, 123; a dash for None and NaN."""
    size = abs(value or 0.0)
    return number(value, 3 if size < 0.9995 else 2 if size < 9.995 else 1 if size < 99.95 else 0)


MOST_DECIMALS = 6
"""Maximum number of decimals: a smaller error is shown as zero."""


def by_error(value: float | None, error: float) -> str:
    """Return ``value`` with as many decimals as its standard ``error`` allows: two digits if the error begins with 1.

    Without an error (zero, NaN) it has about three digits.
    """
    if not np.isfinite(error) or error <= 0.0:
        return three_digits(value)
    power = int(np.floor(np.log10(error)))
    return number(value, int(np.clip(-power + (error < 2.0 * 10.0**power), 0, MOST_DECIMALS)))


def percent(share: float | None) -> str:
    """Return a share in percent, with a decimal below ten."""
    if share is None or not np.isfinite(share):
        return "–"
    if 0 < share < 0.0005:
        return "<0.1 %"
    return f"{100 * share:.1f} %" if 0 < share < 0.0995 else f"{100 * share:.0f} %"


def plus_minus(estimate: Estimate | None) -> str:
    """Return ``11.5 ±0.3``, the value and its standard error, if it is known; a dash for None."""
    if estimate is None:
        return "–"
    error = estimate.standard_error
    value = value_of(estimate)
    return f"{value} ±{by_error(error, error) if error > 0.0 else 0}" if np.isfinite(error) else value


def value_of(estimate: Estimate) -> str:
    """Return ``11.5``, the value alone with the digits that its standard error allows."""
    return by_error(estimate.value, estimate.standard_error)


def within(estimate: Estimate | None) -> str:
    """Return the value, and below it its interval: ``11.5`` over ``11.2 to 11.9``; a dash for None."""
    if estimate is None:
        return "–"
    ends = (estimate.low, estimate.high)
    known = all(map(np.isfinite, ends))
    between = " to ".join(by_error(end, estimate.standard_error) for end in ends) if known else ""
    return lines(value_of(estimate), between)


ERRORS_WIDE = 3.9
"""Width of a 95 % interval of a normal distribution in standard errors."""


def with_interval(value: float, low: float, high: float) -> str:
    """Return ``11.5 (11.2 to 11.9)``; the value alone if the interval is unknown or has no width."""
    error = (high - low) / ERRORS_WIDE
    if not error > 0.0:
        return three_digits(value)
    return f"{by_error(value, error)} ({by_error(low, error)} to {by_error(high, error)})"


def horizon_name(horizon: int | None, dt: float) -> str:
    """Return ``20 steps (1 s)`` for steps of ``dt`` seconds, or ``whole episode`` for None."""
    if horizon is None:
        return "whole episode"
    return f"{horizon} {'step' if horizon == 1 else 'steps'} ({horizon * dt:g} s)"


def few(names: Sequence[str], most: int = 4) -> str:
    """Return ``names`` with commas, if there are more than ``most`` + 1 only ``most`` and the number of others."""
    more = len(names) - most
    return ", ".join(names[:most]) + f" and {more} more" if more > 1 else ", ".join(names)


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
