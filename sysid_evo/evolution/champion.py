"""The controller that an evolutionary run ends with, and how it came about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sysid_evo.arrays import Array, check_shape


@dataclass(frozen=True)
class Champion:
    """One evolved parameter vector (n,) of a registered controller at a registered task.

    ``against`` names the models it met, ``aggregate`` how their fitnesses became one. ``history``
    (G, 3) holds the best, mean and worst fitness of each generation, as evolution saw them, with states
    observed ``estimator_delay`` s late.
    """

    name: str
    parameters: Array
    against: tuple[str, ...]
    aggregate: str
    seed: int
    history: Array
    controller: str = "recurrent"
    controller_parameters: Mapping[str, Any] = field(default_factory=dict)
    task: str = "point_to_point"
    task_parameters: Mapping[str, Any] = field(default_factory=dict)
    estimator_delay: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", check_shape("parameters", self.parameters, (None,)))
        object.__setattr__(self, "history", check_shape("history", self.history, (None, 3)))
