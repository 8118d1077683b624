"""Which parameters of a family are searched, and where: as declared, else by types, limits and defaults."""

from __future__ import annotations

import types
import typing
from collections.abc import Collection, Mapping
from typing import Any, Literal, Union

import numpy as np

from sysid_evo.errors import InvalidArgument
from sysid_evo.hyperparameters import check_names, limits_of
from sysid_evo.registry import models
from sysid_evo.searched import OneOf, Searched, Within

NEVER = frozenset({"stochastic", "rest_hold", "most_steps", "folds", "lag_search", "state_lags", "control_lags"})
"""What has little to do with how well a model predicts, or has ranges of its own."""
LAGS = {"state_lags": Within(0, 2), "control_lags": Within(0, 6)}
FACTOR = 8.0
"""How far a positive number is searched from its default, both ways."""
SMALLEST, LARGEST = 1e-6, 1.0
"""Where a number is searched that is 0 by default."""


def search_space(name: str, *, fixed: Collection[str] = (), only: Collection[str] | None = None) -> dict[str, Searched]:
    """Return where each parameter of the registered family ``name`` is searched, those that are ``fixed`` left out.

    What the family declares in ``searched`` comes first. Of the rest, lags are searched from 0 to 2 earlier states and
    6 earlier controls, a positive number within a factor of 8 of its default and its limits, words of a `Literal` and
    truth values in turn. Left out are names, lists, numbers without a default, and what a preset changes: that is a
    matter of time. ``only`` names those to search. Raises `InvalidArgument` if nothing is left.
    """
    family: Any = models.get(name)
    check_names(family, only or ())
    found: dict[str, Searched] = dict(declared(family))
    annotations, limits = typing.get_type_hints(family.__init__), limits_of(family)
    budgets = {key for preset in family.presets.values() for key in preset}
    for key, default in models.parameters(name).items():
        if key is None or key in found:
            continue
        if key in LAGS:
            found[key] = LAGS[key]
        elif key not in NEVER and (key not in budgets or key in (only or ())):
            derived = _derived(annotations.get(key, Any), default, limits.get(key))
            found |= {} if derived is None else {key: derived}
    chosen = {key: one for key, one in found.items() if key not in fixed and (only is None or key in only)}
    if not chosen:
        wanted = "" if only is None else f" among {', '.join(only)}"
        raise InvalidArgument(f"model {name!r} has no parameter to search{wanted}; it declares some in ``searched``")
    return chosen


def declared(family: type) -> Mapping[str, Searched]:
    """Return the ``searched`` of a class, those of its bases included; the class nearest to it wins."""
    merged: dict[str, Searched] = {}
    for base in reversed(family.__mro__):
        merged.update(base.__dict__.get("searched", {}))
    return merged


def _derived(kind: Any, default: Any, limit: Any) -> Searched | None:
    """Return where a parameter of this type, default and `Limit` is searched, None if that cannot be told."""
    options = [one for one in _options(kind) if one is not types.NoneType]
    if typing.get_origin(kind) is Literal:
        return OneOf(typing.get_args(kind))
    if options == [bool]:
        return OneOf((False, True))
    if not options or not {*options} <= {int, float} or isinstance(default, bool) or default is None:
        return None
    low, high = (-np.inf, np.inf) if limit is None else (limit.low, limit.high)
    if default > 0:
        return Within(max(low, default / FACTOR), min(high, default * FACTOR), log=True)
    return Within(max(low, SMALLEST), min(high, LARGEST), log=True) if default == 0 and float in options else None


def _options(kind: Any) -> tuple[Any, ...]:
    """Return the types of a union, or the one type."""
    return typing.get_args(kind) if typing.get_origin(kind) in (Union, types.UnionType) else (kind,)


def whole(name: str, key: str) -> bool:
    """Whether the parameter ``key`` of a family is a whole number."""
    family: Any = models.get(name)
    options = _options(typing.get_type_hints(family.__init__).get(key, Any))
    return int in options and float not in options
