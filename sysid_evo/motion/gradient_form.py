"""The derivatives of a motion, backwards: through them a model that is trained on free runs learns from its errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from sysid_evo.motion.contract import Motion
    from sysid_evo.system import System

Numbers: TypeAlias = npt.NDArray[Any]
"""Of single or double precision."""
SMALL_STEP = 1e-6


class MotionGradient(Protocol):
    """From the ``gradient`` of a number by a result (..., nx), its gradients by what the result was made of."""

    def integrated(
        self, state: Numbers, acceleration: Numbers, dt: float, gradient: Numbers
    ) -> tuple[Numbers, Numbers]:
        """Return the gradients by state and by acceleration of what `Motion.integrate` gives."""

    def turned(self, state: Numbers, gradient: Numbers) -> Numbers:
        """Return the gradient by the state of what `Motion.turning` gives."""


class Straight:
    """Of a system without a motion: no frame turns."""

    def integrated(
        self, state: Numbers, acceleration: Numbers, dt: float, gradient: Numbers
    ) -> tuple[Numbers, Numbers]:
        return gradient, dt * gradient

    def turned(self, state: Numbers, gradient: Numbers) -> Numbers:
        return np.zeros_like(state)


@dataclass(frozen=True)
class CentralDifferences:
    """Of any motion, in double precision: every column of its arguments is moved a little both ways."""

    motion: Motion
    names: Sequence[str]

    def integrated(
        self, state: Numbers, acceleration: Numbers, dt: float, gradient: Numbers
    ) -> tuple[Numbers, Numbers]:
        by_state = pulled(lambda x: self.motion.integrate(x, acceleration, dt, self.names), state, gradient)
        return by_state, pulled(lambda a: self.motion.integrate(state, a, dt, self.names), acceleration, gradient)

    def turned(self, state: Numbers, gradient: Numbers) -> Numbers:
        return pulled(lambda x: self.motion.turning(x, self.names), state, gradient)


def pulled(function: Callable[[Numbers], Numbers], at: Numbers, gradient: Numbers) -> Numbers:
    """Return the gradient by ``at`` (..., n) from that by what ``function`` makes of it, by central differences."""
    at, found = np.asarray(at, dtype=np.float64), np.empty(at.shape)
    for column in range(at.shape[-1]):
        step = np.zeros(at.shape[-1])
        step[column] = SMALL_STEP
        slope = (function(at + step) - function(at - step)) / (2.0 * SMALL_STEP)
        found[..., column] = np.sum(slope * gradient, axis=-1)
    return found


def motion_gradient(system: System) -> MotionGradient:
    """Return the derivatives of the system's motion, `Straight` without one."""
    return Straight() if system.motion is None else system.motion.gradient_form(system.state_names)
