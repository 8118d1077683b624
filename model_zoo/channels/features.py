"""What families see of states and controls: periodic states as sine and cosine, and functions of single channels."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sysid_evo.angles import TURN
from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidArgument
from sysid_evo.lags import CarryLayout
from sysid_evo.system import System

FUNCTIONS: dict[str, Callable[[Array], Array]] = {
    "abs": np.abs,
    "sign": np.sign,
    "sin": np.sin,
    "cos": np.cos,
    "tanh": np.tanh,
    "exp": np.exp,
}
"""Of these only ``abs`` keeps the unit of its channel."""


@dataclass(frozen=True)
class Features:
    """What a regression or a network sees of (carry, control).

    States, earlier states, earlier controls, the control, then ``functions`` of the present state or
    control, such as ``abs(speed)``. A periodic state stands as its sine and cosine, so that equal angles are equal.
    """

    system: System
    lags: tuple[int, int]
    functions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        known = (*self.system.state_names, *self.system.control_names)
        for text in self.functions:
            name, channel = _parts(text)
            if name not in FUNCTIONS or channel not in known:
                raise InvalidArgument(
                    f"functions: expected NAME(CHANNEL) with one of {', '.join(FUNCTIONS)} and one of "
                    f"{', '.join(known)}, got {text!r}"
                )

    @property
    def plain(self) -> bool:
        """Whether the features are (carry, control) as they are, which is what compiled forms read."""
        return not self.functions and not self.system.periods

    @property
    def n_carry(self) -> int:
        """How many of the features stand for the carry; they come first."""
        return len(self.system.regressor_names) * (1 + self.lags[0]) + self.system.nu * self.lags[1]

    def __call__(self, carry: Array, control: Array) -> Array:
        """Return the features (..., n) of carries (..., n_carry) and controls (..., nu)."""
        parts = self.parts(carry, control)
        if self.functions:
            system = self.system
            present = np.concatenate([carry[..., : system.nx], control], axis=-1)
            for name, channel in map(_parts, self.functions):
                place = (*system.state_names, *system.control_names).index(channel)
                parts.append(FUNCTIONS[name](present[..., place : place + 1]))
        return np.concatenate(parts, axis=-1)

    def parts(self, carry: Array, control: Array) -> list[Array]:
        """Return the features without functions as parts, to be joined along the last axis."""
        periods, nx, past = self.system.periods, self.system.nx, self._layout.earlier_controls.start
        if not periods:
            return [carry, control]
        columns = []
        for place in range(past):
            column = carry[..., place : place + 1]
            if place % nx in periods:
                angle = TURN / periods[place % nx] * column
                columns += [np.sin(angle), np.cos(angle)]
            else:
                columns.append(column)
        return [*columns, carry[..., past:], control]

    @cached_property
    def names(self) -> list[str]:
        """The name of every feature."""
        plain = self._layout.input_names(self.system.regressor_names, self.system.control_names)
        return [*plain, *self.functions]

    @cached_property
    def units(self) -> list[str]:
        """The unit of every feature."""
        system = self.system
        of_states = [unit for c in system.states for unit in (["", ""] if c.period else [c.unit])]
        of = {c.name: c.unit for c in (*system.states, *system.controls)}
        functions = [of[channel] if name == "abs" else "" for name, channel in map(_parts, self.functions)]
        return [*self._layout.each_input(of_states, [c.unit for c in system.controls]), *functions]

    @property
    def _layout(self) -> CarryLayout:
        return CarryLayout(self.system.nx, self.system.nu, *self.lags)


def _parts(text: str) -> tuple[str, str]:
    found = re.fullmatch(r"\s*(\w+)\((.+)\)\s*", text)
    return (found[1], found[2].strip()) if found else (text, "")
