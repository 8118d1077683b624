"""Physics written down as equations: how fast each state changes, integrated by Runge and Kutta's method."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

import numpy as np

from hardware.emulation.sensed_robot import SensedPhysics
from sysid_evo.arrays import Array, check_shape
from sysid_evo.errors import InvalidSystem
from sysid_evo.system import System


class Equations(SensedPhysics):
    """Derive from it, give ``system`` and `rates_of_change`, and `SensedRobot` makes a robot of it.

    One step of ``system.dt`` takes ``substeps`` steps of Runge and Kutta's fourth-order method, under one control. The
    carry is the state. Where states have limits, the loops that step it clip to them. Raises `InvalidSystem`
    without a system.
    """

    substeps: int = 4

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        system = getattr(cls, "system", None)
        if not isinstance(system, System):
            raise InvalidSystem(
                f"{cls.__name__}: expected a class attribute system = System(states=..., controls=..., dt=...), "
                f"got {system!r}"
            )
        cls.n_carry = system.nx

    @abstractmethod
    def rates_of_change(self, states: Array, controls: Array) -> Array | Mapping[str, Array]:
        """Return the change of every state per second, (B, nx), in ``states`` (B, nx) under ``controls`` (B, nu).

        It may also be one array (B,) for each state, by the state's name.
        """

    @property
    def envelope(self) -> Array | None:
        limits = np.array([[c.low for c in self.system.states], [c.high for c in self.system.states]])
        return limits if np.isfinite(limits).any() else None

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return states[:, -1].copy()

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        h = self.system.dt / self.substeps
        for _ in range(self.substeps):
            k1 = self._rates(carry, control)
            k2 = self._rates(carry + 0.5 * h * k1, control)
            k3 = self._rates(carry + 0.5 * h * k2, control)
            k4 = self._rates(carry + h * k3, control)
            carry = carry + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return carry

    def _rates(self, states: Array, controls: Array) -> Array:
        """Return the change per second (B, nx). Raises `InvalidSystem` for names that are not those of the states."""
        given, names = self.rates_of_change(states, controls), self.system.state_names
        if isinstance(given, Mapping):
            if set(given) != set(names):
                raise InvalidSystem(
                    f"{type(self).__name__}.rates_of_change: expected the change per second of {', '.join(names)}, "
                    f"got {', '.join(map(str, given)) or 'none'}"
                )
            given = np.stack([np.broadcast_to(given[name], len(states)) for name in names], axis=1)
        return check_shape(f"{type(self).__name__}.rates_of_change", given, states.shape)
