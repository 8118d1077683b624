"""Units of products and quotients, with what cancels left out."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable

from sysid_evo.data.units import written

SYMBOL = re.compile(r"([^\s/*^·()]+)(?:\^(-?\d+))?")


def powers(unit: str) -> Counter[str]:
    """Return the power of every symbol: m 1, s -2 for ``m/s^2``. What cannot be read stays one symbol."""
    found: Counter[str] = Counter()
    for number, factor in enumerate(unit.split("/")):
        symbols = re.split(r"[\s*·]+", factor.strip()) if factor.strip() else []
        for symbol in symbols:
            match = SYMBOL.fullmatch(symbol)
            if match is None:
                return Counter({unit: 1})
            if match[1] != "1":
                found[match[1]] += (1 if number == 0 else -1) * int(match[2] or 1)
    return found


def quotient(unit: str, divisors: Iterable[tuple[str, int]]) -> str:
    """Return ``unit`` divided by units to their powers, such as ``1/s`` for m/s^2 by m/s; empty without unit."""
    left = powers(unit)
    for divisor, power in divisors:
        for symbol, own in powers(divisor).items():
            left[symbol] -= own * power
    return written(left)
