"""Champions to write into files, what they see, and what the product decides on it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from sysid_evo import make_controller, make_task
from sysid_evo.evolution import Champion
from sysid_evo.export.exported_controller import decided_by
from sysid_evo.system import System
from sysid_evo.testing.examples import switched_car
from sysid_evo.types import Array

SPECS = (
    "recurrent",
    "feed_forward(hidden=[4, 3])",
    "policy(hidden=[4, 3])",
    "policy(hidden=[5], inner=relu, output=tanh)",
    "linear(inputs=[yaw_rate, waypoint_angle])",
    "pid(loops={steer: [waypoint_angle, yaw_rate], drive: waypoint_distance})",
    "pursuit",
    "pursuit(backward=true)",
)
Step = Callable[[Array], Array]


def champion_of(spec: str, system: System | None = None, name: str = "best of a+b") -> Champion:
    """Return a champion with arbitrary parameters."""
    system = system or switched_car()
    n = make_controller(spec).bind_to(make_task("point_to_point").bind(system)).n_parameters
    parameters = 0.7 * np.random.default_rng(2).standard_normal(n)
    return Champion(name, parameters, ("a", "b"), "min", 0, np.zeros((1, 3)), controller=spec, system=system)


def wandering(steps: int) -> Array:
    """Return observations of a point-to-point task (steps, 5) that change a little from sample to sample."""
    rng = np.random.default_rng(7)
    walk = np.cumsum(rng.normal(scale=0.3, size=(steps, 5)), axis=0)
    seen = np.stack(
        [np.ones(steps), 2.0 * np.sin(walk[:, 1]), 5.0 * np.sin(walk[:, 2]), walk[:, 3], 1.5 + np.sin(walk[:, 4])], 1
    )
    seen[:, 3] = (seen[:, 3] + np.pi) % (2.0 * np.pi) - np.pi
    return seen


def decided(champion: Champion, seen: Array) -> Array:
    """Return the controls of the product."""
    assert champion.system is not None
    task = make_task("point_to_point").bind(champion.system)
    return decided_by(make_controller(champion.controller).bind_to(task), champion, task, seen)


def stepped(step: Step, seen: Array) -> Array:
    """Return what ``step`` decides on every row of ``seen``."""
    return np.array([step(row) for row in seen])


def write(text: str, path: Path) -> Path:
    """Write ``text`` to ``path`` and return it."""
    path.write_text(text, encoding="utf-8")
    return path
