"""The compiled form of a motion: what kernels bind to integrate and to move a pose."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.motion.straight_kernel import integrate_straight, move_nothing, turn_nothing

if TYPE_CHECKING:
    from sysid_evo.system import System

LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class MotionKernel:
    """Three block functions over lanes and the flat ``parameters`` ``p`` that all of them get.

    - ``integrate(state, after, nx, dt, p)``: ``after`` holds an acceleration and becomes the state dt later;
    - ``turn(state, rate, p)``: add w(x) to ``rate``;
    - ``move(pose, before, after, dt, p)``: ``pose`` becomes that after dt, angles in (-pi, pi].
    """

    integrate: Callable[..., Any]
    turn: Callable[..., Any]
    move: Callable[..., Any]
    parameters: Array = field(default_factory=lambda: np.zeros(1))

    @property
    def bindings(self) -> dict[str, Any]:
        """What a shell binds: ``integrate``, ``turn`` and ``move``."""
        return {"integrate": self.integrate, "turn": self.turn, "move": self.move}


def motion_kernel(system: System) -> MotionKernel | None:
    """Return the compiled form of the system's motion, `STRAIGHT` without a motion; None if its motion has none.

    A remark is logged once for each kind of motion without one: its systems run in NumPy.
    """
    if system.motion is None:
        return STRAIGHT
    kernel = system.motion.kernel(system.state_names)
    if kernel is None:
        _remark(system.motion.kind)
    return kernel


@cache
def _remark(kind: str) -> None:
    LOG.warning("motion %s has no compiled form: what needs it runs in NumPy, some ten times slower", kind)


STRAIGHT = MotionKernel(integrate_straight, turn_nothing, move_nothing)
"""Of a system without a motion: no frame turns, and there is no pose."""
