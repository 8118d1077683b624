"""What the tests of the device run: every shipped kernel in a small closed loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
import pytest

from sysid_evo.arrays import Array
from sysid_evo.controllers import Controller, RecurrentNetwork
from sysid_evo.controllers.lqr import Lqr
from sysid_evo.data import Dataset
from sysid_evo.dynamics import Dynamics
from sysid_evo.registry import make_controller, make_model, make_robot, make_task, models
from sysid_evo.tasks import PointToPoint, Task
from sysid_evo.tasks.registered_reward import NamedReward
from sysid_evo.testing import example_dataset
from sysid_evo.testing.examples import ExampleDynamics, continuous_car, pendulum, switched_car
from sysid_evo.wrappers import (
    Cautious,
    DelayedEstimate,
    RadicalEnvelope,
    Supported,
    Switching,
    disturbed,
)

HORIZON = 12
ALL_NOISE = RadicalEnvelope(
    process=0.3, latency=2, dropout=0.3, sensor=0.2, bias=0.1, effect=0.2
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A dynamics, a controller and a task, none of them bound; `parameters` are those of two candidates.

    ``loose`` says how many times more than elsewhere rounding shows in float64.
    """

    dynamics: Dynamics
    controller: Controller
    task: Task
    size: float = 0.5
    loose: float = 1.0

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
def family(name: str) -> Dynamics:
    """Return a model of the zoo, quickly fitted."""
    quick = dict(models.get(name).presets.get("quick", {}))  # type: ignore[attr-defined]  # a class, not any factory
    return make_model(name, **quick).fit(dataset(), rng=np.random.default_rng(0))


def driven(dynamics: Dynamics, loose: float = 1.0) -> Case:
    """The paper's controller and task around ``dynamics``."""
    task = PointToPoint(horizon=HORIZON, waypoint_radius=0.5)
    return Case(dynamics, RecurrentNetwork(hidden=5), task, loose=loose)


def robot(name: str, task: str, size: float = 0.5) -> Case:
    """An emulated robot at a task of its own."""
    dynamics = make_robot(name).dynamics
    assert dynamics is not None
    return Case(dynamics, RecurrentNetwork(hidden=3), make_task(task, horizon=HORIZON), size)


def steered(controller: str, **given: Any) -> Case:
    """A controller in the linear car."""
    task = PointToPoint(horizon=HORIZON, waypoint_radius=0.5)
    return Case(ExampleDynamics(continuous_car()), make_controller(controller, **given), task)


def at_task(task: str, **given: Any) -> Case:
    """A task in the linear car."""
    return Case(ExampleDynamics(switched_car()), RecurrentNetwork(hidden=3), make_task(task, horizon=HORIZON, **given))


def wrapped(around: Callable[[Dynamics], Dynamics]) -> Case:
    """Something around a linear model."""
    return driven(around(family("linear")))


def swung(torque, angle, weight=0.5):  # type: ignore[no-untyped-def]  # read by Numba
    """The angle up, with little torque."""
    return -math.cos(angle) - weight * torque**2


def fast(angular_speed):  # type: ignore[no-untyped-def]  # read by Numba
    """It turns too fast."""
    return angular_speed > 1.0


def reward() -> Case:
    """A reward that somebody registers, whose trials may be over before their time."""
    given: Any = {"lowest": -2.0, "start": {"angle": (-1.0, 1.0), "angular_speed": (0.0, 1.2)}}
    task = NamedReward("swung", swung, constants={"weight": 0.5}, ended=fast, horizon=HORIZON, **given)
    return Case(ExampleDynamics(pendulum()), RecurrentNetwork(hidden=3), task)


def environment() -> Case:
    """A classic environment whose reward is compiled."""
    system = make_robot("gymnasium").system
    return Case(ExampleDynamics(system), RecurrentNetwork(hidden=3), make_task("environment", horizon=HORIZON))


LOOSE = {"k_neighbours": 1e4}
"""Its neighbours change at once: where two are as near, rounding decides."""
MODELS: dict[str, Callable[[], Case]] = {
    name: partial(lambda name: driven(family(name), LOOSE.get(name, 1.0)), name)
    for name in (
        "backprop27", "evolved3", "gaussian_process", "hybrid_ode", "k_neighbours", "linear", "mlp_ensemble", "narx",
        "nearest_neighbour", "neural_ode", "neural_ode_history", "parametrised", "sindy", "sindy_bagged",
        "sindy_discrete", "single_track",
    )
}  # fmt: skip
ROBOTS: dict[str, Callable[[], Case]] = {
    "emulated_car": lambda: robot("emulated_car", "point_to_point"),
    "awkward_car": lambda: robot("awkward_car", "point_to_point", 3.0),
    "pendulum": lambda: robot("pendulum", "swing_up"),
    "cart_pole": lambda: robot("cart_pole", "balance"),
    "thermal": lambda: robot("thermal", "track_reference"),
}
WRAPPERS: dict[str, Callable[[], Case]] = {
    "late": lambda: wrapped(lambda model: DelayedEstimate(model, 0.07)),
    "noise of all kinds": lambda: wrapped(lambda model: disturbed(model, ALL_NOISE)),
    "supported": lambda: wrapped(lambda model: Supported(model, every=3)),
    "cautious": lambda: wrapped(lambda model: Cautious(model, [family("parametrised")])),
    "switching": lambda: wrapped(lambda model: Switching([model, family("parametrised")], every=3.0)),
}
CONTROLLERS: dict[str, Callable[[], Case]] = {
    "constant": lambda: steered("constant"),
    "feed_forward": lambda: steered("feed_forward", hidden=[5, 3]),
    "linear feedback": lambda: steered("linear"),
    "pursuit": lambda: steered("pursuit"),
    "pid": lambda: Case(ExampleDynamics(pendulum()), make_controller("pid"), make_task("set_point", horizon=HORIZON)),
    "lqr": lambda: Case(
        ExampleDynamics(pendulum()), Lqr(model=ExampleDynamics(pendulum())), make_task("set_point", horizon=HORIZON)
    ),
}
TASKS: dict[str, Callable[[], Case]] = {
    "set_point": lambda: at_task("set_point"),
    "track_reference": lambda: at_task("track_reference"),
    "walled_track": lambda: at_task("walled_track"),
    "reward": reward,
    "environment": environment,
}
CASES = MODELS | ROBOTS | WRAPPERS | CONTROLLERS | TASKS
HEAVY = {"mlp_ensemble"}
"""Families that take seconds to fit, or to simulate."""


def seldom(name: str, slow: Collection[str]) -> Any:
    """Return ``name``, to be left out without --slow if it is among the ``slow`` ones."""
    return pytest.param(name, marks=pytest.mark.slow) if name in slow else name
