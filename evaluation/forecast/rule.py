"""The constants of a forecast, and the command that they come from."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Rule:
    """How what models say of a controller becomes one number with an interval; nothing in it has a unit.

    The credibility of a model falls with its prediction error to the ``power``. A model of a family that the
    controller was evolved in counts ``own`` times that: its claim may be exploited. The unit of the interval is how
    far models lie from the forecast, and ``trial`` times how far trials lie apart, over the root of the number of
    models that count. It reaches from ``low`` to ``high`` such units, by the quantiles of what was missed on cars.
    """

    power: float = 2.0
    own: float = 0.5
    trial: float = 0.2
    low: float = -3.1
    high: float = 1.5
    share: float = 0.9


RULE = Rule()
"""Calibrated on five cars of the emulated family; ``python -m tests.benchmarks.forecast RUN ...`` prints the constants.

``low`` and ``high`` are the 5 and 95 % quantiles of what was missed by 683 controllers; the others are round numbers on
a plateau, chosen with the same cars.
"""
