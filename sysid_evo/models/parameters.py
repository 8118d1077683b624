"""Hyper-parameters: declaration, types, limits, scikit-learn's access."""

from __future__ import annotations

import contextlib
import copy
import functools
import inspect
import numbers
import sys
import types
import typing
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from typing import TYPE_CHECKING, Any, Literal, Self, Union

import numpy as np

from sysid_evo.data.dataset import Dataset
from sysid_evo.errors import InvalidArgument, UnknownParameter, did_you_mean

if TYPE_CHECKING:
    from sklearn.utils import Tags


NAMES: dict[Any, str] = {bool: "True or False", int: "a whole number", float: "a number", str: "text"}


@dataclass(frozen=True)
class Limit:
    """Allowed numbers: from ``low`` (exclusive with ``open_below``) to ``high``; for a list, those of each item."""

    low: float = -np.inf
    high: float = np.inf
    open_below: bool = False

    def allows(self, value: Any) -> bool:
        """Whether a number, or all numbers of a list, are within the limits; True for anything else."""
        if isinstance(value, (list, tuple)):
            return all(self.allows(item) for item in value)
        if not isinstance(value, (int, float, np.number)):
            return True
        return bool((value > self.low if self.open_below else value >= self.low) and value <= self.high)

    def __str__(self) -> str:
        above = f"{'>' if self.open_below else '>='} {self.low:g}"
        below = f"<= {self.high:g}"
        return " and ".join(text for text, limit in ((above, self.low), (below, self.high)) if np.isfinite(limit))


def at_least(low: float, *, at_most: float = np.inf) -> Limit:
    """Return the limit ``low`` <= value <= ``at_most``."""
    return Limit(low, at_most)


def above(low: float, *, at_most: float = np.inf) -> Limit:
    """Return the limit ``low`` < value <= ``at_most``."""
    return Limit(low, at_most, open_below=True)


def limits_of(family: type) -> dict[str, Limit]:
    """Return the ``limits`` of a class and its bases; those of a subclass replace those of its base."""
    merged: dict[str, Limit] = {}
    for base in reversed(family.__mro__):
        merged.update(base.__dict__.get("limits", {}))
    return merged


def declare(family: type) -> None:
    """Generate the constructor of a class from the hyper-parameters that it and its bases declare.

    Hyper-parameters are the annotated names without `ClassVar`. Their types are resolved here, in the module of the
    class. A class with several bases gets a constructor for the hyper-parameters of all of them.
    """
    own = {name: kind for name, kind in vars(family).get("__annotations__", {}).items() if "ClassVar" not in str(kind)}
    several = sum(is_dataclass(base) for base in family.__bases__) > 1
    if (own or several) and "__init__" not in vars(family):
        declared = types.SimpleNamespace(__annotations__=own)
        with contextlib.suppress(NameError):  # a name that only the type checker knows: nothing to check against
            family.__annotations__.update(typing.get_type_hints(declared, vars(sys.modules[family.__module__])))
        dataclass(kw_only=True, eq=False, repr=False)(family)


def check_values(family: type, values: Mapping[str, Any]) -> None:
    """Raise `InvalidArgument` with the first of ``values`` that has the wrong type or is out of its limits."""
    limits = limits_of(family)
    try:
        annotations = typing.get_type_hints(family.__init__)  # type: ignore[misc]  # __init__ of a class is only read
    except NameError:  # a name that only the type checker knows: nothing to check against
        annotations = {}
    for name, value in values.items():
        expected, limit = annotations.get(name, Any), limits.get(name, Limit())
        if not (fits(value, expected) and limit.allows(value)):
            kind = f"{described(expected)} {limit}".strip()
            raise InvalidArgument(f"{family.__name__}: {name}: expected {kind}, got {value!r}")


def check_names(family: type, names: Collection[str]) -> None:
    """Raise `UnknownParameter` if one of ``names`` is not a parameter of the constructor of ``family``."""
    signature = inspect.signature(family).parameters
    known, any_name = list(signature), any(one.kind is one.VAR_KEYWORD for one in signature.values())
    for name in names:
        if name not in known and not any_name:
            raise UnknownParameter(
                f"{family.__name__}: there is no parameter {name!r}.{did_you_mean(name, known)} "
                f"It has: {', '.join(known) or 'none'}."
            )


def fits(value: Any, expected: Any) -> bool:
    """Whether ``value`` is of the annotated type; an integer is a number, a bool is not."""
    origin, arguments = typing.get_origin(expected), typing.get_args(expected)
    if origin in (Union, types.UnionType):
        return any(fits(value, one) for one in arguments)
    if origin is Literal:
        return value in arguments
    if origin in (list, tuple, Sequence):
        items = [one for one in arguments if one is not Ellipsis]
        return isinstance(value, (list, tuple)) and all(any(fits(item, one) for one in items) for item in value)
    if isinstance(origin, type):
        return isinstance(value, origin)
    if expected in (int, float):
        kind = numbers.Integral if expected is int else numbers.Real
        return isinstance(value, kind) and not isinstance(value, (bool, np.bool_))
    if expected is bool:
        return isinstance(value, (bool, np.bool_))
    return expected is Any or not isinstance(expected, type) or isinstance(value, expected)


def described(expected: Any) -> str:
    """Return a description of an annotated type."""
    origin, arguments = typing.get_origin(expected), typing.get_args(expected)
    if origin in (Union, types.UnionType):
        first = [described(one) for one in arguments if one is not types.NoneType]
        return " or ".join(["None"] * (types.NoneType in arguments) + first)
    if origin is Literal:
        return "one of " + ", ".join(map(repr, arguments))
    if origin in (list, tuple, Sequence):
        return f"a list of {described(arguments[0]).removeprefix('a ')}s"
    return NAMES.get(expected, getattr(expected, "__name__", "a value"))


def checked(init: Any) -> Any:
    """Wrap a family's constructor: raise an error for a wrong name or value."""

    @functools.wraps(init)
    def wrapped(self: Any, *arguments: Any, **parameters: Any) -> None:
        outermost = type(self).__init__ is wrapped
        if outermost:
            check_names(type(self), parameters)
        init(self, *arguments, **parameters)
        if outermost:
            self.check_parameters()

    return wrapped


class ParameterAccess:
    """An object whose constructor only stores its arguments, under their names.

    `sklearn.base.clone` and `GridSearchCV` accept it as an estimator.
    """

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the constructor's arguments; ``deep`` is for scikit-learn and has no effect."""
        return {name: getattr(self, name) for name in sorted(inspect.signature(type(self)).parameters)}

    def set_params(self, **parameters: Any) -> Self:
        """Set some of the constructor's arguments."""
        for name, value in parameters.items():
            setattr(self, name, value)
        return self

    def clone_unfitted(self) -> Self:
        """Return an unfitted object with copies of the same arguments."""
        return type(self)(**copy.deepcopy(self.get_params()))

    def variant(self, **parameters: Any) -> Self:
        """Return a copy with all learned values and other hyper-parameters."""
        other: Self = self.clone_unfitted().set_params(**parameters)
        other.__dict__.update({name: value for name, value in vars(self).items() if name.endswith("_")})
        return other

    def __repr__(self) -> str:
        defaults = {name: one.default for name, one in inspect.signature(type(self)).parameters.items()}
        changed = (
            f"{name}={value!r}" for name, value in self.get_params().items() if repr(value) != repr(defaults.get(name))
        )
        return f"{type(self).__name__}({', '.join(changed)})"

    def __sklearn_tags__(self) -> Tags:
        from sklearn.utils import Tags, TargetTags

        return Tags(estimator_type=None, target_tags=TargetTags(required=False))


def shorter(estimator: Any, dataset: Dataset) -> str:
    """Return hyper-parameters that make a fit shorter: those of the preset quick, no lags, fewer steps."""
    n_steps, now = dataset.n_steps, estimator.get_params(deep=False)
    found = {name: value for name, value in estimator.presets.get("quick", {}).items() if value != now[name]}
    found |= {name: 0 for name in ("state_lags", "control_lags") if now.get(name, 0) != 0}
    if "max_steps" in now:
        found["max_steps"] = max(1, min(n_steps, now["max_steps"] or n_steps) // 10)
    what = ", ".join(f"{name}={value!r}" for name, value in found.items()) or "a shorter recording"
    return f"{what} (of {n_steps:,} steps, {dataset.system.nx} states and {dataset.system.nu} controls)"
