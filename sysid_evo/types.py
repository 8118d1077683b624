"""Array types, checks of shapes, and dataclass fields that convert their values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeAlias, TypeVar, overload

import numpy as np
import numpy.typing as npt

from sysid_evo.errors import ShapeError

Array: TypeAlias = npt.NDArray[np.float64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]
IntArray: TypeAlias = npt.NDArray[np.int64]
Seeds: TypeAlias = npt.NDArray[np.uint64]


def check_shape(name: str, array: npt.ArrayLike, expected: tuple[int | None, ...]) -> Array:
    """Return ``array`` as float64, or raise `ShapeError` if its shape is not ``expected``.

    None is any length. The message contains the name and both shapes.
    """
    result = _numbers(name, array)
    fits = result.ndim == len(expected) and all(
        want is None or want == have for want, have in zip(expected, result.shape, strict=True)
    )
    if not fits:
        wanted = "(" + ", ".join("any" if n is None else str(n) for n in expected) + ")"
        raise ShapeError(f"{name}: expected shape {wanted}, got {result.shape}")
    return result


def check_last(name: str, array: npt.ArrayLike, expected: int) -> Array:
    """Return ``array`` as float64, or raise `ShapeError` if its last axis is not ``expected`` long."""
    result = _numbers(name, array)
    if result.shape[-1:] != (expected,):
        raise ShapeError(f"{name}: expected {expected} values on the last axis, got shape {result.shape}")
    return result


def _numbers(name: str, array: npt.ArrayLike) -> Array:
    try:
        return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ShapeError(f"{name}: expected numbers, got {type(array).__name__}: {error}") from error


G = TypeVar("G")
H = TypeVar("H")


class Converted(Generic[G, H]):
    """A field of a dataclass that accepts a G and holds the H that ``convert`` returns.

    Type checkers see both types: that of the argument, for example a text, and that of the field, such as a `Spec`.
    """

    def __init__(self, convert: Callable[[G], H], default: G) -> None:
        self._convert, self._default = convert, default

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, instance: None, owner: type) -> G: ...
    @overload
    def __get__(self, instance: object, owner: type) -> H: ...
    def __get__(self, instance: Any, owner: type) -> G | H:
        return self._default if instance is None else instance.__dict__[self._name]

    def __set__(self, instance: Any, value: G) -> None:
        instance.__dict__[self._name] = self._convert(value)
