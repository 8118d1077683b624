"""The optical tracker beside the emulated car: poses with the errors of marker tracking."""

from __future__ import annotations

import math

import numpy as np

from sysid_evo.arrays import Array

POSITION_ERROR = 0.001  # m: "in the order of millimeters" (paper, section 3)
HEADING_ERROR = math.radians(0.3)  # what 1 mm on markers some 15 cm apart amounts to
CORRELATION = 0.3
"""Of one frame's error with the next: the cameras see the same markers from almost the same angle."""


class OpticalTracker:
    """Adds first-order correlated normal errors to planar poses, frame by frame.

    Standard deviations are 1 mm in x and y and 0.3 degrees in heading; headings lie in [-pi, pi).
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._error = rng.standard_normal(3)
        self._scale = np.array([POSITION_ERROR, POSITION_ERROR, HEADING_ERROR])

    def observe(self, pose: Array) -> Array:
        """Return what the tracker makes of the true ``pose`` (3,): m, m, rad."""
        measured: Array = pose + self._scale * self._error
        measured[2] = (measured[2] + math.pi) % (2.0 * math.pi) - math.pi
        fresh = math.sqrt(1.0 - CORRELATION**2)
        self._error = CORRELATION * self._error + fresh * self._rng.standard_normal(3)
        return measured
