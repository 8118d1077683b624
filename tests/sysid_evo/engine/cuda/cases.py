"""What the tests of the device run: every shipped kernel in a small closed loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.controllers import Controller, RecurrentNetwork
from sysid_evo.data import Dataset
from sysid_evo.dynamics import Dynamics
from sysid_evo.registry import make_model
from sysid_evo.tasks import PointToPoint, Task
from sysid_evo.testing import example_dataset

HORIZON = 12


@dataclass(frozen=True)
class Case:
    """A dynamics, a controller and a task, none of them bound; `parameters` are those of two candidates."""

    dynamics: Dynamics
    controller: Controller
    task: Task
    size: float = 0.5

    @property
    def parameters(self) -> Array:
        """Parameters (2, n), small enough that no candidate is chaotic: rounding stays rounding."""
        bound = self.controller.bind_to(self.task.bind(self.dynamics.system))
        return self.size * np.random.default_rng(3).standard_normal((2, bound.n_parameters))


@cache
def dataset() -> Dataset:
    """A small recording of a made-up car."""
    return example_dataset(episodes=2, steps=120)


@cache
def family(name: str, **given: Any) -> Dynamics:
    """Return a model of the zoo, quickly fitted."""
    return make_model(name, **given).fit(dataset(), rng=np.random.default_rng(0))


def driven(dynamics: Dynamics) -> Case:
    """The paper's controller and task around ``dynamics``."""
    return Case(dynamics, RecurrentNetwork(hidden=5), PointToPoint(horizon=HORIZON, waypoint_radius=0.5))


CASES: dict[str, Callable[[], Case]] = {
    "parametrised": lambda: driven(family("parametrised", generations=2)),
}
