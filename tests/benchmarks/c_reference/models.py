"""The models that are timed: registered families, quickly fitted to one recording of the emulated car, and the car.

Sizes are those of the standard preset (networks, members, lags); only the training is short. Fitted models and
the populations that drive on them are kept in a folder, so that later runs time the same numbers.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.data import Dataset
from sysid_evo.dynamics import Dynamics
from sysid_evo.engine import DynamicsRunner
from sysid_evo.evolution import EnsembleObjective, MuPlusLambda, evolve
from sysid_evo.registry import Spec, make_model, make_robot
from sysid_evo.store import load_model, save_model
from sysid_evo.tasks import PointToPoint

CANDIDATES, TRIALS, GENERATIONS, SEED = 100, 10, 60, 1

FAMILIES = {
    "parametrised": {"generations": 100},
    "evolved3": {"generations": 100},
    "backprop27": {"epochs": 200},
    "nearest_neighbour": {},
    "neural_ode": {"one_step_updates": 400, "updates": 60},
    "sindy": {"degree": 3, "threshold": 0.03, "control_lags": 0},
    "mlp_ensemble": {"state_lags": 1, "control_lags": 3, "one_step_updates": 300, "updates": 40},
}


def dynamics(name: str, folder: Path) -> Dynamics:
    """Return the fitted family, or the emulated car."""
    if name == "emulated_car":
        return make_robot("emulated_car").dynamics
    path = folder / name
    if not path.with_suffix(".json").exists():
        if not (folder / "recording").exists():
            make_robot("emulated_car").record(seed=0, duration=360.0).dataset.save(folder / "recording")
        data = Dataset.read(folder / "recording")
        model = make_model(Spec(name, FAMILIES[name])).fit(data, rng=np.random.default_rng(0))
        save_model(model, path, seed=0, data=data.fingerprint)
    return load_model(path)


def population(name: str, on: Dynamics, folder: Path) -> np.ndarray:
    """Return controllers (100, 78) that evolved on the model for 60 generations."""
    path = folder / f"{name}.population.npy"
    if not path.exists():
        strategy = MuPlusLambda(n_parameters=78, seed=SEED, parents=50, children=50)
        objective = EnsembleObjective((DynamicsRunner(on),), RecurrentNetwork(), PointToPoint(), SEED, TRIALS)
        for _ in evolve(strategy, objective, GENERATIONS):
            pass
        np.save(path, strategy.ask())
    return np.load(path)
