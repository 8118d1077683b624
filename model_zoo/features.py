"""Input features of states and controls, and which states are predicted by their change."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from model_zoo.scaling import deviation
from sysid_evo.angles import TURN
from sysid_evo.carry import CarryLayout
from sysid_evo.data import Dataset
from sysid_evo.data.units import written
from sysid_evo.errors import InvalidArgument
from sysid_evo.models.kernels import Predictor, on_top
from sysid_evo.system import System
from sysid_evo.types import Array, BoolArray


class Row(NamedTuple):
    """A feature: ``function`` ("" for none) of ``factor`` times (number ``place`` of (carry, control) - ``offset``)."""

    function: str
    place: int
    factor: float
    offset: float = 0.0


@dataclass(frozen=True)
class Features:
    """Input features of a regression or a network, made from (carry, control).

    In this order: states, earlier states, earlier controls, the control, then ``functions`` of one of these, such as
    ``abs(speed)`` or ``sin(2*drive[-1])``. Periodic states enter as sine and cosine, so that equal angles are equal.
    The ``offsets`` (nx + nu) are subtracted from states and controls, not from arguments of functions (see
    `offsets_of`).
    """

    system: System
    lags: tuple[int, int]
    functions: tuple[str, ...] = ()
    offsets: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        known = self.input_names if self.functions else []
        for text in self.functions:
            function = ChannelFunction.read(text)
            if function is None or function.input not in known:
                raise InvalidArgument(
                    f"functions: expected NAME(CHANNEL) with one of {', '.join(FUNCTIONS)} and one of "
                    f"{', '.join(known)}, got {text!r}"
                )

    @property
    def plain(self) -> bool:
        """Whether the features equal (carry, control), which compiled forms can read directly."""
        return not self.functions and not self.system.periods and not self.offsets

    @property
    def n_carry(self) -> int:
        """Number of features that belong to the carry; they come first."""
        return len(self.system.regressor_names) * (1 + self.lags[0]) + self.system.nu * self.lags[1]

    def __call__(self, carry: Array, control: Array) -> Array:
        """Return the features (..., n) of carries (..., n_carry) and controls (..., nu)."""
        parts = self.parts(carry, control)
        if self.functions:
            width = carry.shape[-1]
            for function, place in self._functions:
                side, column = (carry, place) if place < width else (control, place - width)
                parts.append(function(side[..., column : column + 1]))
        features = np.concatenate(parts, axis=-1)
        return features - np.array([row.offset for row in self.rows]) if self.offsets else features

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
        """The name of every element of (carry, control), the possible arguments of functions."""
        return self._layout.input_names(self.system.state_names, self.system.control_names)

    @property
    def rows(self) -> list[Row]:
        """The function, input and offset of every feature, in order."""
        nx, periods, past = self.system.nx, self.system.periods, self._layout.earlier_controls.start
        offsets = self.offsets or (0.0,) * (nx + self.system.nu)
        offset, found = self._layout.each_input(offsets[:nx], offsets[nx:]), list[Row]()
        for place in range(self._layout.size + self.system.nu):
            if place < past and place % nx in periods:
                turn = TURN / periods[place % nx]
                found += [Row("sin", place, turn), Row("cos", place, turn)]
            else:
                found.append(Row("", place, 1.0, offset[place]))
        return [*found, *(Row(function.function, place, function.factor) for function, place in self._functions)]

    @cached_property
    def plain_names(self) -> list[str]:
        """The name of every feature without the ``functions``."""
        return self._layout.input_names(self.system.regressor_names, self.system.control_names)

    @cached_property
    def names(self) -> list[str]:
        """The name of every feature."""
        return [*self.plain_names, *(function.name for function, _ in self._functions)]

    @property
    def shown_names(self) -> list[str]:
        """The name of every feature in a printed equation, such as ``(temperature - 293)``."""
        pairs = zip(self.names, self.rows, strict=True)
        return [f"({less(name, row.offset)})" if row.offset else name for name, row in pairs]

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
    def _functions(self) -> list[tuple[ChannelFunction, int]]:
        """The functions, and the position of each argument in (carry, control)."""
        known = self.input_names
        read = [function for text in self.functions if (function := ChannelFunction.read(text)) is not None]
        return [(function, known.index(function.input)) for function in read]

    @property
    def _layout(self) -> CarryLayout:
        return CarryLayout(self.system.nx, self.system.nu, *self.lags)


FUNCTIONS: dict[str, Callable[[Array], Array]] = {
    "abs": np.abs,
    "sign": np.sign,
    "sin": np.sin,
    "cos": np.cos,
    "tanh": np.tanh,
    "exp": np.exp,
    "sqrt_abs": lambda x: np.asarray(np.sqrt(np.abs(x))),  # such as the flow through an orifice
    "x_abs": lambda x: np.asarray(x * np.abs(x)),  # such as the drag of a body in air
}
"""Functions by name; `sysid_evo.models.kernels.shells` has the compiled form of each."""

CALL = re.compile(r"\s*(?P<function>\w+)\(\s*(?:(?P<factor>[-+.\deE]+)\s*\*\s*)?(?P<input>[^()*]+?)\s*\)\s*")


class ChannelFunction(NamedTuple):
    """``function`` of ``factor`` times the input called ``input``; read from ``sin(2*speed)`` or ``abs(speed)``."""

    function: str
    factor: float
    input: str

    @classmethod
    def read(cls, text: str) -> ChannelFunction | None:
        """Return the function that ``text`` describes; None if it is not a function of one input."""
        found = CALL.fullmatch(text)
        if found is None or found["function"] not in FUNCTIONS:
            return None
        try:
            factor = 1.0 if found["factor"] is None else float(found["factor"])
        except ValueError:
            return None
        return cls(found["function"], factor, found["input"])

    @property
    def text(self) -> str:
        """The text that `read` reads; exact."""
        factor = "" if self.factor == 1.0 else f"{self.factor!r}*"
        return f"{self.function}({factor}{self.input})"

    @property
    def name(self) -> str:
        """The text for display, such as ``sin(2 speed)``."""
        factor = "" if self.factor == 1.0 else f"{self.factor:.4g} "
        inside = f"{factor}{self.input}"
        if self.function == "x_abs":
            return f"({inside} |{inside}|)"
        return f"sqrt|{inside}|" if self.function == "sqrt_abs" else f"{self.function}({inside})"

    def unit(self, of_input: str) -> str:
        """Return the unit of the value; none if there is a factor."""
        if self.factor != 1.0:
            return ""
        if self.function == "abs":
            return of_input
        if self.function == "x_abs":
            return quotient("", [(of_input, -2)])
        return f"({of_input})^0.5" if self.function == "sqrt_abs" and of_input else ""

    def __call__(self, values: Array) -> Array:
        """Return the function of ``values``."""
        return FUNCTIONS[self.function](values if self.factor == 1.0 else self.factor * values)


MAX_OFFSET = 10.0
"""Distance from zero, in standard deviations, above which the monomials of a channel are too collinear.

On a simulated vehicle and tank (1,800 samples) errors rose from 0.02 to 0.31 at 12 deviations (`sindy_discrete`), from
0.004 to 0.006 at 40 and 0.03 at 1e6 (`sindy`), from 0.004 to 0.009 at 1e4 (`narx`). At 3 deviations offsets have no
effect.
"""


def offsets_of(dataset: Dataset) -> tuple[float, ...]:
    """Return the offsets (nx + nu) to subtract from states and controls before monomials are formed; () if all are 0.

    A channel further than `MAX_OFFSET` from zero has its mean as offset, rounded to the leading digit of its standard
    deviation. Periodic states have none.
    """
    values = np.concatenate([np.column_stack([e.states[:-1], e.controls]) for e in dataset])
    mean, spread = values.mean(axis=0), deviation(values)
    digit = 10.0 ** np.floor(np.log10(spread))
    far = np.abs(mean) > MAX_OFFSET * spread
    far[list(dataset.system.periods)] = False
    return tuple(np.where(far, np.round(mean / digit) * digit, 0.0).tolist()) if far.any() else ()


def less(name: str, offset: float) -> str:
    """Return ``temperature - 293`` for an offset of 293, ``temperature + 40`` for -40, the name alone for 0."""
    return f"{name} {'-' if offset > 0 else '+'} {abs(offset):.10g}" if offset else name


OWN = 0.005
"""A state's own value has no effect on its change up to this share of the change's deviation."""
RATE = 0.95
"""Share of the variance of a state's change that another state must explain to be its rate."""
AT_LIMIT = 1e-6
"""Share of the range of a channel within which a state is at its limit."""
FEWEST = 0.5
"""Smallest share of samples that may remain without those at a limit; otherwise all are used."""


def integrals(dataset: Dataset) -> BoolArray:
    """Return for which states (nx,) the change is predicted instead of the next value: periodic states and integrals.

    A prediction of the next state from inputs clipped to the training range cannot leave that range. For a speed, which
    drag limits, this is a good guess. A position is not limited, and a controller evolved in such a model would use the
    limit as a wall. An *integral* is a state whose change is explained by another state (its rate) or does not depend
    on its own value (linear and quadratic terms, given all other states and controls).
    """
    system, data = dataset.system, dataset.transitions(moving=True)
    free = between_limits(system, data.after)
    state, control, after = data.state[free], data.control[free], data.after[free]
    seen = np.concatenate([system.regressors(state), control], axis=1)
    standard = (seen - seen.mean(axis=0)) / deviation(seen)
    change = system.difference(after, state)
    columns = np.concatenate([np.ones((len(seen), 1)), standard, standard**2], axis=1)
    effects, *_ = np.linalg.lstsq(columns, change / deviation(change), rcond=None)
    moved = (change - change.mean(axis=0)) / deviation(change)
    explained = (standard.T @ moved / len(moved)) ** 2
    found = np.zeros(system.nx, dtype=bool)
    for i, channel in enumerate(system.states):
        if channel.period is None:
            place = system.regressor_names.index(channel.name)
            effect = np.abs(effects[[1 + place, 1 + seen.shape[1] + place], i]).max()
            others = np.delete(explained[: len(system.regressor_names), i], place)
            is_moved = others.max(initial=0.0) >= RATE
            found[i] = (is_moved or effect < OWN) and np.ptp(state[:, i]) > 0.0
        else:
            found[i] = True
    return found


def between_limits(system: System, after: Array) -> BoolArray:
    """Return in which samples (N,) no state of ``after`` (N, nx) is at a limit of its channel.

    Samples at a limit carry no information on the dynamics. If most samples are, all are returned.
    """
    low, high = system.limits
    width = np.where(np.isfinite(high - low), high - low, 1.0)
    free: BoolArray = ((after > low + AT_LIMIT * width) & (after < high - AT_LIMIT * width)).all(axis=1)
    return free if free.mean() >= FEWEST else np.ones(len(after), dtype=bool)


def next_state(added: Array, state: Array, predicted: Array) -> Array:
    """Return ``predicted`` (B, nx), added to ``state`` (B, nx) where ``added`` (nx,) is above 0."""
    return np.where(added > 0.0, state + predicted, predicted)


def next_state_predictor(added: Array, inner: Predictor) -> Predictor:
    """Return the compiled form of `next_state` around the predictor ``inner``."""
    chosen = added > 0.0
    return on_top(inner, chosen) if chosen.any() else inner


SYMBOL = re.compile(r"([^\s/*^·()]+)(?:\^(-?\d+))?")


def powers(unit: str) -> Counter[str]:
    """Return the power of every symbol: m 1, s -2 for ``m/s^2``. An unreadable unit is one symbol."""
    found: Counter[str] = Counter()
    for number, factor in enumerate(unit.split("/")):
        symbols = re.split(r"[\s*·]+", factor.strip()) if factor.strip() else []
        for symbol in symbols:
            match = SYMBOL.fullmatch(symbol)
            if match is None:
                return Counter({unit: 1})
            if match[1] != "1":
                found[match[1]] += (1 if number == 0 else -1) * int(match[2] or 1)
    return found


def quotient(unit: str, divisors: Iterable[tuple[str, int]]) -> str:
    """Return ``unit`` divided by units to their powers, such as ``1/s`` for m/s^2 by m/s; empty without unit."""
    left = powers(unit)
    for divisor, power in divisors:
        for symbol, own in powers(divisor).items():
            left[symbol] -= own * power
    return written(left)
