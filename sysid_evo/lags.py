"""Where states and controls stand in a carry with lags: the only place that lays them out in Python.

The functions only cut and list parts; whoever calls joins them along the last axis, with its own library.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class CarryLayout:
    """The state (nx), ``state_lags`` earlier states, ``control_lags`` earlier controls (nu), newest first."""

    nx: int
    nu: int
    state_lags: int = 0
    control_lags: int = 0

    @property
    def size(self) -> int:
        """Length of the carry."""
        return self.nx * (1 + self.state_lags) + self.nu * self.control_lags

    @property
    def history(self) -> int:
        """Number of samples before the present that it takes to start."""
        return max(self.state_lags, self.control_lags)

    @property
    def earlier_controls(self) -> slice:
        """Where the earlier controls stand."""
        return slice(self.nx * (1 + self.state_lags), self.size)

    def started(self, states: Any, controls: Any) -> list[Any]:
        """Return the parts of a carry after a history of states (..., L + 1, nx) and controls (..., L, nu)."""
        parts = [states[..., -1 - lag, :] for lag in range(self.state_lags + 1)]
        return parts + [controls[..., -1 - lag, :] for lag in range(self.control_lags)]

    def moved(self, carry: Any, control: Any, after: Any) -> list[Any]:
        """Return the parts of the next carry (..., size): states and controls move one place back."""
        parts = [after, carry[..., : self.nx * self.state_lags]] if self.state_lags else [after]
        if self.control_lags:
            first = self.earlier_controls.start
            parts += [control, carry[..., first : first + self.nu * (self.control_lags - 1)]]
        return parts

    def each_input(self, of_states: Iterable[T], of_controls: Iterable[T]) -> list[T]:
        """Return one value for every number of (carry, control), from one for every state and control."""
        return [*of_states] * (1 + self.state_lags) + [*of_controls] * (self.control_lags + 1)

    def input_names(self, states: Sequence[str], controls: Sequence[str]) -> list[str]:
        """Return the names of (carry, control); ``speed[-1]`` is the speed one sample ago."""
        earlier = [f"{name}[-{lag}]" for lag in range(1, self.state_lags + 1) for name in states]
        held = [f"{name}[-{lag}]" for lag in range(1, self.control_lags + 1) for name in controls]
        return [*states, *earlier, *held, *controls]
