"""The constants of a forecast, and the command that they come from."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Rule:
    """How what models say of a controller becomes one number with an interval; nothing in it has a unit.

    The credibility of a model falls with its prediction error to the ``power``. A model of a family that the
    controller was evolved in counts ``own`` times that: its claim may be exploited. The unit of the interval has two
    parts. One is how far models lie from the forecast, over the number of models that count to the power ``apart``: not
    a half, since models of the same data share some of their errors. The other is the standard error of the trials,
    which all models share. It reaches from ``low`` to ``high`` such units, by the quantiles of what was missed on cars.
    """

    power: float = 2.0
    own: float = 0.5
    apart: float = 0.25
    low: float = -2.3
    high: float = 1.3
    share: float = 0.9


RULE = Rule()
"""Calibrated on five cars of the emulated family; ``python -m tests.benchmarks.forecast`` prints the constants.

``low`` and ``high`` are near the 5 and 95 % quantiles of what was missed: -2.4 and 1.3 by 550 controllers with nine
families, -2.1 and 1.2 by 1247 with all 22. The others are round numbers on a plateau, chosen with the same cars.
"""
