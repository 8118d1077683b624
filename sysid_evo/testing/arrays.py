"""What the kits ask of arrays: shape and type, equal numbers, arguments left as they were."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import numpy as np

from sysid_evo.arrays import Array, BoolArray
from sysid_evo.errors import ContractViolation
from sysid_evo.testing.verdicts import expect

Result = TypeVar("Result")


def expect_numbers(name: str, array: Any, shape: tuple[int, ...]) -> None:
    """Raise `ContractViolation` unless ``array`` holds finite float64 numbers of this shape."""
    if not isinstance(array, np.ndarray):
        raise ContractViolation(f"{name}: expected an array {shape} float64, got {type(array).__name__}")
    if array.shape != shape or array.dtype != np.float64:
        raise ContractViolation(f"{name}: expected {shape} float64, got {array.shape} {array.dtype}")
    if not np.isfinite(array).all():
        raise ContractViolation(f"{name}: expected finite numbers, got {array[~np.isfinite(array)][0]}")


def twice(name: str, function: Callable[..., Result], *arguments: Any) -> Result:
    """Call ``function`` twice and return the result; ``name`` is what a reason calls it.

    Raises `ContractViolation` if it changes its arguments or gives another result the second time.
    """
    kept = [copied(argument) for argument in arguments]
    first = function(*arguments)
    held = copied(first)
    second = function(*arguments)
    expect(all(map(same, arguments, kept)), f"{name} overwrites its arguments")
    expect(same(held, first), f"a second {name} overwrites the result of the first")
    expect(same(first, second), f"the same {name} twice gives two results")
    return first


def same(first: Any, second: Any) -> bool:
    """Return whether two results are equal: arrays number by number, nan being equal to nan."""
    if isinstance(first, (tuple, list)):
        return len(first) == len(second) and all(map(same, first, second))
    if is_dataclass(first):
        return all(same(getattr(first, item.name), getattr(second, item.name)) for item in fields(first))
    if isinstance(first, np.ndarray):
        return np.array_equal(first, second, equal_nan=first.dtype.kind == "f")
    return bool(first == second)


def copied(value: Any) -> Any:
    """Return a copy of arrays and of the tuples and dataclasses that hold them; anything else as it is."""
    if isinstance(value, (tuple, list)):
        return type(value)(map(copied, value))
    if isinstance(value, np.ndarray):
        return value.copy()
    if is_dataclass(value) and not isinstance(value, type):
        made = object.__new__(type(value))
        for item in fields(value):
            object.__setattr__(made, item.name, copied(getattr(value, item.name)))
        return made
    return value


def rows_off(found: Array, expected: Array, tolerance: float) -> BoolArray:
    """Return which rows of (B, n) differ by more than ``tolerance`` times the number plus its column's largest."""
    size = np.abs(expected)
    return (np.abs(found - expected) > tolerance * (size + size.max(axis=0, initial=0.0))).any(axis=1)


def normal(count: int, rows: int, rng: np.random.Generator | None = None) -> Array | None:
    """Return standard normal numbers (rows, count), or None if none are taken."""
    rng = np.random.default_rng(3) if rng is None else rng
    return rng.standard_normal((rows, count)) if count else None
