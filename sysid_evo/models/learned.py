"""Shapes and ranges that a family declares for its learned arrays, and their check."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np

from sysid_evo.errors import InvalidArgument, PluginError, ShapeError

Length: TypeAlias = int | str
"""A number, or a name: the same length, at least 1, everywhere in the declaration of a model."""


class Numbers:
    """A learned array of shape ``lengths``; without lengths, one number.

    ``least`` and ``most`` bound its values. ``whole`` values are integers, such as indices, counts and exponents;
    others have single or double precision. nan is always refused, infinity unless ``infinite``. ``rising`` values never
    decrease along the first axis. An ``optional`` array may be missing or None.
    """

    def __init__(
        self,
        *lengths: Length,
        least: float = -math.inf,
        most: float = math.inf,
        whole: bool = False,
        infinite: bool = False,
        rising: bool = False,
        optional: bool = False,
    ) -> None:
        self.lengths, self.least, self.most, self.whole = lengths, least, most, whole
        self.infinite, self.rising, self.optional = infinite, rising, optional

    def check(self, name: str, value: object, known: dict[str, int]) -> None:
        """Raise `ShapeError` unless ``value`` is as declared; ``known`` holds the lengths that have names."""
        array = np.asarray(value)
        kinds = "i" if self.whole else "f" if self.lengths else "if"
        if array.dtype.kind not in kinds or (array.dtype.kind == "f" and array.dtype.itemsize < 4):
            raise ShapeError(f"{name}: expected {'whole' if self.whole else 'real'} numbers, got {_what(value)}")
        if array.ndim == len(self.lengths):
            for length, found in zip(self.lengths, array.shape, strict=True):
                if isinstance(length, str) and found > 0:
                    known.setdefault(length, found)
        expected = tuple(known.get(length, length) if isinstance(length, str) else length for length in self.lengths)
        if array.shape != expected:
            raise ShapeError(f"{name}: expected shape ({', '.join(map(str, expected))}), got {array.shape}")
        if np.isnan(array).any() or not (self.infinite or np.isfinite(array).all()):
            raise ShapeError(f"{name}: expected {'numbers' if self.infinite else 'finite numbers'}, some are not")
        if (array < self.least).any() or (array > self.most).any():
            span = f"{array.min():g} to {array.max():g}"
            raise ShapeError(f"{name}: expected numbers from {self.least:g} to {self.most:g}, got {span}")
        if self.rising and (array[1:] < array[:-1]).any():
            raise ShapeError(f"{name}: expected numbers that do not fall along the first axis, some do")


Declared: TypeAlias = "Numbers | tuple[Length, ...] | list[Declared]"
"""A tuple of lengths declares an array of finite numbers; a list declares the items of a list."""


def check_learned(model: object) -> list[str]:
    """Raise `ShapeError` unless the arrays of ``model`` are as ``learned_arrays`` of its class and bases declare.

    Arrays without a declaration may have any shape but no nan; their names are returned.
    """
    declared: dict[str, Declared] = {}
    try:
        for cls in reversed(type(model).__mro__):
            if "learned_arrays" in vars(cls):
                own = vars(cls)["learned_arrays"](model)
                if not declared:
                    _check_all(model, own)  # that of the base class: the others use its lags
                declared.update(own)
        _check_all(model, declared)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        if isinstance(error, ShapeError):
            raise
        if isinstance(error, InvalidArgument):  # an object or a plugin file of another process
            raise PluginError(str(error)) from error
        raise ShapeError(f"its learned arrays do not fit together: {type(error).__name__}: {error}") from error
    others = []
    for name in vars(model).keys() - declared.keys():
        value = getattr(model, name)
        arrays = [one for one in (value if isinstance(value, list) else [value]) if isinstance(one, np.ndarray)]
        if arrays and name.endswith("_"):
            others.append(name)
        if any(array.dtype.kind == "f" and np.isnan(array).any() for array in arrays):
            raise ShapeError(f"{name}: expected numbers, some are nan")
    return sorted(others)


def _check_all(model: object, declared: Mapping[str, Declared]) -> None:
    known: dict[str, int] = {}
    for name, one in declared.items():
        _check(name, getattr(model, name, None), one, known)


def _check(name: str, value: Any, declared: Declared, known: dict[str, int]) -> None:
    if isinstance(declared, list):
        if not isinstance(value, list) or len(value) != len(declared):
            raise ShapeError(f"{name}: expected a list of {len(declared)}, got {_what(value)}")
        for number, (item, one) in enumerate(zip(value, declared, strict=True)):
            _check(f"{name}[{number}]", item, one, known)
        return
    one = declared if isinstance(declared, Numbers) else Numbers(*declared)
    if value is None and one.optional:
        return
    one.check(name, value, known)


def _what(value: object) -> str:
    """Return the type of a value in a few words."""
    if value is None:
        return "nothing"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    return str(value.dtype) if isinstance(value, np.ndarray) else f"a {type(value).__name__}"
