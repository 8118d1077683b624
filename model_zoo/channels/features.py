"""What families see of states and controls: periodic states as sine and cosine, and functions of single channels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from model_zoo.channels.functions import FUNCTIONS, FunctionOf
from sysid_evo.angles import TURN
from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidArgument
from sysid_evo.lags import CarryLayout
from sysid_evo.system import System


class Row(NamedTuple):
    """One feature: ``function`` ("" for none) of ``factor`` times number ``place`` of (carry, control)."""

    function: str
    place: int
    factor: float


@dataclass(frozen=True)
class Features:
    """What a regression or a network sees of (carry, control).

    States, earlier states, earlier controls, the control, then ``functions`` of one of these, such as ``abs(speed)``
    or ``sin(2*drive[-1])``. A periodic state stands as its sine and cosine, so that equal angles are equal.
    """

    system: System
    lags: tuple[int, int]
    functions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        known = self.input_names if self.functions else []
        for text in self.functions:
            function = FunctionOf.read(text)
            if function is None or function.input not in known:
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
            width = carry.shape[-1]
            for function, place in self._functions:
                side, column = (carry, place) if place < width else (control, place - width)
                parts.append(function(side[..., column : column + 1]))
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

    @property
    def input_names(self) -> list[str]:
        """The name of every number of (carry, control), of which functions may be asked for."""
        return self._layout.input_names(self.system.state_names, self.system.control_names)

    @property
    def rows(self) -> list[Row]:
        """What every feature is a function of, in the order of the features."""
        nx, periods, past = self.system.nx, self.system.periods, self._layout.earlier_controls.start
        found = []
        for place in range(self._layout.size + self.system.nu):
            if place < past and place % nx in periods:
                turn = TURN / periods[place % nx]
                found += [Row("sin", place, turn), Row("cos", place, turn)]
            else:
                found.append(Row("", place, 1.0))
        return [*found, *(Row(function.function, place, function.factor) for function, place in self._functions)]

    @cached_property
    def plain_names(self) -> list[str]:
        """The name of every feature without the functions asked for."""
        return self._layout.input_names(self.system.regressor_names, self.system.control_names)

    @cached_property
    def names(self) -> list[str]:
        """The name of every feature."""
        return [*self.plain_names, *(function.name for function, _ in self._functions)]

    @cached_property
    def units(self) -> list[str]:
        """The unit of every feature."""
        system = self.system
        of_states = [unit for c in system.states for unit in (["", ""] if c.period else [c.unit])]
        of_controls = [c.unit for c in system.controls]
        inputs = self._layout.each_input([c.unit for c in system.states], of_controls)
        functions = [function.unit(inputs[place]) for function, place in self._functions]
        return [*self._layout.each_input(of_states, of_controls), *functions]

    @cached_property
    def _functions(self) -> list[tuple[FunctionOf, int]]:
        """The functions, and the place of what each is of in (carry, control)."""
        known = self.input_names
        read = [function for text in self.functions if (function := FunctionOf.read(text)) is not None]
        return [(function, known.index(function.input)) for function in read]

    @property
    def _layout(self) -> CarryLayout:
        return CarryLayout(self.system.nx, self.system.nu, *self.lags)
