"""Aggregates: the rule that combines the fitness on several models and trials into one number.

An aggregate is a function of the fitness (models, candidates, trials) that returns one number for each candidate, in
the unit of fitness. If a candidate scores the same on all models and trials, the aggregate equals that score. Further
arguments are the parameters of its spec.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from sysid_evo.errors import InvalidArgument, SysidEvoError
from sysid_evo.registry.grammar import Spec
from sysid_evo.registry.registry import aggregates, register_aggregate
from sysid_evo.types import Array

Aggregate: TypeAlias = Callable[[Array], Array]


@register_aggregate("min")
def lowest(fitness: Array) -> Array:
    """Lowest of the models' mean fitness over the trials (the paper's rule)."""
    return np.min(fitness.mean(axis=2), axis=0)


@register_aggregate("mean")
def mean(fitness: Array) -> Array:
    """Mean over the models of the mean fitness over the trials."""
    return np.mean(fitness.mean(axis=2), axis=0)


@register_aggregate("median")
def median(fitness: Array) -> Array:
    """Median over the models of the mean fitness over the trials."""
    return np.median(fitness.mean(axis=2), axis=0)


@register_aggregate("cvar")
def conditional_value_at_risk(fitness: Array, *, share: float = 0.3) -> Array:
    """Mean of the worst ``share`` of a candidate's trials on all models.

    ``share`` 1 gives the mean; towards 0 it becomes the single worst trial. A trial may count in part: the worst 25 %
    of ten trials are two and a half trials (Rockafellar and Uryasev 2000).
    """
    if not 0.0 < share <= 1.0:
        raise InvalidArgument(f"cvar: expected share above 0 and at most 1, got {share}")
    models, candidates, trials = fitness.shape
    worst_first = np.sort(fitness.transpose(1, 0, 2).reshape(candidates, models * trials), axis=1)
    counted = max(1.0, share * models * trials)
    weights = np.clip(counted - np.arange(models * trials), 0.0, 1.0)
    return worst_first @ weights / counted


def make_aggregate(spec: str | Spec, /, **parameters: Any) -> Aggregate:
    """Return the aggregate that ``spec`` names, with its parameters; a test call detects invalid values.

    Raises the errors of `Registry.check`, and `InvalidArgument` if the test call fails.
    """
    found = aggregates.check(spec, **parameters)
    aggregate = partial(aggregates.get(found.name), **found.parameters)
    try:
        aggregate(np.zeros((1, 1, 1)))
    except SysidEvoError:
        raise
    except Exception as error:  # a function may fail in any way when its values are wrong
        raise InvalidArgument(f"aggregate {found}: {type(error).__name__}: {error}") from error
    return aggregate
