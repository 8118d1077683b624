"""One step of the classical fourth-order Runge-Kutta method with the control held."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def rk4(rate: Callable[[Any], Any], state: Any, dt: float) -> Any:
    """Return the state (..., nx) after ``dt`` seconds of d state / dt = ``rate(state)``."""
    k1 = rate(state)
    k2 = rate(state + 0.5 * dt * k1)
    k3 = rate(state + 0.5 * dt * k2)
    k4 = rate(state + dt * k3)
    return state + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
