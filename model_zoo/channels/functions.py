"""The elementary functions of one quantity that a library may name, and how their names are read; never evaluated."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from model_zoo.sparse.units import quotient
from sysid_evo.arrays import Array


def square_with_sign(x: Array) -> Array:
    """Return x |x|, such as the drag of a body in air."""
    return np.asarray(x * np.abs(x))


def root_of_size(x: Array) -> Array:
    """Return the square root of |x|, such as the flow through an orifice without its direction."""
    return np.asarray(np.sqrt(np.abs(x)))


FUNCTIONS: dict[str, Callable[[Array], Array]] = {
    "abs": np.abs,
    "sign": np.sign,
    "sin": np.sin,
    "cos": np.cos,
    "tanh": np.tanh,
    "exp": np.exp,
    "sqrt_abs": root_of_size,
    "x_abs": square_with_sign,
}
"""What may be named; `sysid_evo.engine.kernels.functions` has the compiled form of each."""

CALL = re.compile(r"\s*(?P<function>\w+)\(\s*(?:(?P<factor>[-+.\deE]+)\s*\*\s*)?(?P<input>[^()*]+?)\s*\)\s*")


class FunctionOf(NamedTuple):
    """``function`` of ``factor`` times the input called ``input``; read from ``sin(2*speed)`` or ``abs(speed)``."""

    function: str
    factor: float
    input: str

    @classmethod
    def read(cls, text: str) -> FunctionOf | None:
        """Return what ``text`` says, None if it is no function of one input."""
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
        """What `read` reads; exact."""
        factor = "" if self.factor == 1.0 else f"{self.factor!r}*"
        return f"{self.function}({factor}{self.input})"

    @property
    def name(self) -> str:
        """The text for people, such as ``sin(2 speed)``."""
        factor = "" if self.factor == 1.0 else f"{self.factor:.4g} "
        inside = f"{factor}{self.input}"
        if self.function == "x_abs":
            return f"({inside} |{inside}|)"
        return f"sqrt|{inside}|" if self.function == "sqrt_abs" else f"{self.function}({inside})"

    def unit(self, of_input: str) -> str:
        """Return the unit of the value; a factor takes the unit away."""
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
