"""A model's closed loop in C, compiled with the system's compiler."""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from sysid_evo.models import Dynamics
from sysid_evo.randomness import draw_for_steps
from sysid_evo.tasks import PointToPoint
from sysid_evo.types import Array, Seeds
from tests.benchmarks.c_reference.export import LANES, export

HERE = Path(__file__).parent
FLAGS = (
    "-O3",
    "-march=native",
    "-ffast-math",
    "-mprefer-vector-width=512",
    "-Wno-psabi",
    "-shared",
    "-fPIC",
    "-std=gnu11",
)


class Compiled:
    """Rollouts of controllers ``theta`` (P, 78) in at most sixteen trials; noise and waypoints are ready made."""

    def __init__(
        self, compiler: str, name: str, model: Dynamics, theta: Array, task: PointToPoint, seeds: Seeds
    ) -> None:
        parameters, sizes = export(name, model, seeds)
        macros = [f"-D{key}={value}" for key, value in sizes.items()]
        with tempfile.TemporaryDirectory() as folder:
            library = f"{folder}/{name}.so"
            subprocess.run([compiler, *FLAGS, *macros, str(HERE / f"{name}.c"), "-o", library, "-lm"], check=True)
            self.rollout = ctypes.CDLL(library).rollout
        limits = np.full((2, 3), 1e30) * [[-1.0], [1.0]] if model.state_bounds is None else model.state_bounds
        drawn = np.zeros((task.horizon, model.n_noise, LANES), np.float32)
        if model.n_noise:
            drawn[:, :, : len(seeds)] = draw_for_steps(seeds, task.horizon, model.n_noise).transpose(1, 2, 0)
        settings = [model.system.dt, task.waypoint_radius**2, *np.ravel(limits)]
        waypoints = task.bind(model.system).begin(seeds).waypoints
        self.arrays = [
            np.ascontiguousarray(array, np.float32)
            for array in (parameters, settings, theta, waypoints, drawn, np.zeros((len(theta), len(seeds))))
        ]
        self.shape = len(theta), len(seeds), task.horizon

    def __call__(self) -> Array:
        """Return the fitness (P, E)."""
        parameters, settings, theta, waypoints, noise, fitness = map(_pointer, self.arrays)
        self.rollout(parameters, settings, theta, self.shape[0], waypoints, *self.shape[1:], noise, fitness)
        return self.arrays[-1]


def _pointer(array: Any) -> ctypes.c_void_p:
    pointer: ctypes.c_void_p = array.ctypes.data_as(ctypes.c_void_p)
    return pointer
