"""What is computed does not depend on the number of threads of linear algebra, and that is as before afterwards."""

import sys
from contextlib import contextmanager
from types import ModuleType

import numpy as np
import pytest
import scipy.linalg
import torch
from threadpoolctl import threadpool_info, threadpool_limits

from sysid_evo.controllers.controller import make_controller
from sysid_evo.engine import rollout
from sysid_evo.evolution import ControllerEvolution, evolve_controller
from sysid_evo.models.base import DynamicsModel, make_model
from sysid_evo.models.storage import save_model
from sysid_evo.plan import Store
from sysid_evo.plan.run_cell import run_cell
from sysid_evo.processors import _LinearAlgebra, one_blas_thread
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks.task import make_task
from sysid_evo.testing import example_dataset
from tests.fixtures.cells import number

NETWORK = {"hidden": [24], "one_step_updates": 30, "updates": 4, "horizon": 5, "state_lags": 1}
FAMILIES = {
    "linear": {"state_lags": 3, "control_lags": 3},
    "nearest_neighbour": {},
    "narx": {"terms": 8},
    "linear_state_space": {"iterations": 5, "folds": 1, "horizon": 200},
    "gaussian_process": {"inducing": 60, "state_lags": 0, "control_lags": 2},
    "neural_ode": {**NETWORK, "control_lags": 1},
    "mlp_ensemble": {**NETWORK, "members": 2, "control_lags": 1},
    "torch_ode": {"hidden": [32], "updates": 4, "horizon": 5},
    "parametrised": {"generations": 20},
}
LONG = {
    "k_neighbours": {},
    "sindy": {},
    "sindy_discrete": {},
    "nonlinear_state_space": {
        "members": 2,
        "order": 3,
        "screening_iterations": 3,
        "iterations": 3,
        "hidden": 4,
        "horizon": 100,
    },
    "single_track": {"starts": 1, "windows": 15},
}
"""What works with matrices of the same kinds as one of the others, and takes seconds."""


@contextmanager
def on_threads(count):
    """Let linear algebra and torch use this number of threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    with threadpool_limits(count, user_api="blas"):
        yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def recording():
    return example_dataset(episodes=2, steps=1000)


def blas_threads():
    libraries = threadpool_info()
    return {one["num_threads"] for one in libraries if one.get("threading_layer", "disabled") != "disabled"}


@pytest.mark.parametrize("family", [*FAMILIES, *(pytest.param(one, marks=pytest.mark.nightly) for one in LONG)])
def test_a_model_is_the_same_for_any_number_of_threads(family, recording, tmp_path):
    found = []
    for count in (1, 4):
        with on_threads(count):
            model = make_model(family, **{**FAMILIES, **LONG}[family]).fit(recording, rng=0)
            simulated = model.simulate(recording.episodes[1])
        save_model(model, tmp_path / family)
        found.append(((tmp_path / f"{family}.safetensors").read_bytes(), simulated.tobytes()))
    assert found[0] == found[1]


def test_a_champion_is_the_same_for_any_number_of_threads(recording):
    settings = ControllerEvolution(
        generations=24, trials=2, repeats=1, selection_trials=3, strategy="cma_es", task="point_to_point(horizon=50)",
        controller="recurrent(hidden=15)",  # 330 parameters; C of fewer than 240 came out the same on four threads
    )  # fmt: skip
    model = make_model("linear").fit(recording, rng=0)
    found = []
    for count in (1, 4):
        with on_threads(count):
            champion = evolve_controller("c", {"linear": model}, recording.system, settings, seed=0)
        found.append({name: tensor.tobytes() for name, tensor in champion.tensors.items()})
    assert found[0] == found[1]


class Watched(DynamicsModel):
    """Nothing changes; notes the numbers of threads in each step."""

    def fit(self, dataset, *, rng, progress=None):
        self.noted = []
        return self

    def next_state(self, carry, control):
        self.noted.append(blas_threads())
        return carry


def test_simulations_trials_in_numpy_and_cells_of_a_plan_work_on_one_thread(recording, tmp_path):
    model, noted = Watched().fit(recording, rng=0), []
    task = make_task("point_to_point(horizon=2)").bind(recording.system)
    law = make_controller("constant").bind_to(task)
    with on_threads(3):
        model.simulate(recording.episodes[0].states[0], recording.episodes[0].controls[:2])
        assert len(model.noted) == 2
        rollout(model, law, np.zeros((1, law.n_parameters)), task, trial_seeds(0, 2), engine="reference")
        assert len(model.noted) == 4
        run_cell(Store(tmp_path), number(1, then=lambda: noted.append(blas_threads())))
    assert [*model.noted, *noted] == [{1}] * 5


def test_afterwards_linear_algebra_works_on_as_many_threads_as_before():
    scipy.linalg.eigh(np.eye(2))  # its library is one of those
    with on_threads(3):
        with one_blas_thread():
            assert blas_threads() == {1}
        with pytest.raises(ZeroDivisionError), one_blas_thread():
            raise ZeroDivisionError
        assert blas_threads() == {3}


def test_a_library_that_is_imported_meanwhile_works_on_one_thread(monkeypatch):
    with on_threads(3), one_blas_thread(), on_threads(3):  # it is loaded with as many as there are processors
        monkeypatch.setitem(sys.modules, "loaded_meanwhile", ModuleType("loaded_meanwhile"))
        known = _LinearAlgebra.found
        with one_blas_thread():
            assert blas_threads() == {1}
        assert _LinearAlgebra.found is not known
