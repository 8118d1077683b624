"""The models that are timed: registered families, quickly fitted to one recording of the emulated car, and the car.

Sizes are those of the standard preset (networks, members, lags); only the training is short. Fitted models and the
populations that drive on them are kept in a folder, so that later runs time the same numbers.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hardware.robot import find_robot
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.data import Dataset
from sysid_evo.engine import DynamicsRunner
from sysid_evo.evolution import EnsembleObjective, MuPlusLambda, evolve
from sysid_evo.models import Dynamics, load_model, save_model
from sysid_evo.models.base import make_model
from sysid_evo.tasks import PointToPoint
from sysid_evo.types import Array

TRIALS, SEED, N_PARAMETERS = 10, 1, 78
CAR = "emulated_car"
FAMILIES = {
    "parametrised": "generations=100",
    "evolved3": "generations=100",
    "backprop27": "epochs=200",
    "nearest_neighbour": "",
    "neural_ode": "one_step_updates=400, updates=60",
    "sindy": "degree=3, threshold=0.03, control_lags=0",
    "mlp_ensemble": "state_lags=1, control_lags=3, one_step_updates=300, updates=40",
}


def dynamics(name: str, folder: Path, *, seconds: float = 360.0) -> Dynamics:
    """Return the fitted family (loaded from ``folder`` if it is there), or the emulated car."""
    if name == CAR:
        robot: Any = find_robot(CAR)
        car: Dynamics = robot.dynamics
        return car
    path = folder / name
    if not path.with_suffix(".json").exists():
        if not (folder / "recording").exists():
            find_robot(CAR).record(seed=0, duration=seconds).dataset.save(folder / "recording")
        data = Dataset.read(folder / "recording")
        model = make_model(f"{name}({FAMILIES[name]})").fit(data, rng=np.random.default_rng(0))
        save_model(model, path, seed=0, data=data.fingerprint)
    return load_model(path)


def population(name: str, on: Dynamics, folder: Path, *, candidates: int = 100, generations: int = 60) -> Array:
    """Return controllers (candidates, 78) that evolved on the model."""
    path = folder / f"{name}.population.npy"
    if not path.exists():
        half = candidates // 2
        strategy = MuPlusLambda(n_parameters=N_PARAMETERS, seed=SEED, parents=half, children=candidates - half)
        objective = EnsembleObjective((DynamicsRunner(on),), RecurrentNetwork(), PointToPoint(), SEED, TRIALS)
        for _ in evolve(strategy, objective, generations):
            pass
        np.save(path, strategy.ask())
    kept: Array = np.load(path)
    return kept
