"""More training of a network: all of it learns, and the model that there was stays as it is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from model_zoo.networks.backpropagation import StandardisedModel
from model_zoo.networks.training import TrainingSchedule
from model_zoo.scaling import Mirror
from sysid_evo.data import Dataset
from sysid_evo.models.base import make_model
from sysid_evo.types import Array
from tests.fixtures.systems import FloorCar, drive

HARDLY = {"hidden": [6], "one_step_updates": 10, "updates": 2, "horizon": 5, "input_noise": 0.07}
FAMILIES: dict[str, dict[str, Any]] = {
    "mlp_ensemble": {**HARDLY, "members": 2, "state_lags": 1, "control_lags": 1},
    "neural_ode": HARDLY,
    "hybrid_ode": {**HARDLY, "state_lags": 0, "control_lags": 0},
}


@pytest.fixture(scope="module")
def training() -> Dataset:
    return drive(FloorCar(), seconds=20.0, seed=1)


@pytest.fixture(scope="module")
def there() -> Dataset:
    return drive(FloorCar(thrust=1.5), seconds=10.0, seed=2)


def learned(model: Any) -> dict[str, list[Array]]:
    """Return copies of all that training changes."""
    names = [name for name in ("weights_", "biases_", "physical_") if hasattr(model, name)]
    return {name: [np.array(one) for one in getattr(model, name)] for name in names}


def same(one: list[Array], other: list[Array]) -> bool:
    return all((a == b).all() for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("family", FAMILIES)
def test_every_parameter_learns_and_the_model_stays_what_it_was(family: str, training: Dataset, there: Dataset) -> None:
    model: Any = make_model(family, **FAMILIES[family]).fit(training, rng=np.random.default_rng(0))
    before = learned(model)
    further: Any = model.trained_further(there, 3, rng=np.random.default_rng(1))
    assert type(further) is type(model)
    assert further is not model
    assert further.lags == model.lags
    after, again = (learned(one) for one in (further, model.trained_further(there, 3, rng=np.random.default_rng(1))))
    assert not any(same(after[name], before[name]) for name in before)
    assert all(same(after[name], again[name]) for name in before)
    assert all(same(learned(model)[name], before[name]) for name in before)


@pytest.mark.parametrize("family", FAMILIES)
def test_it_is_trained_so_long_on_single_steps_and_runs_of_its_own_length_and_in_the_mirror(
    family: str, training: Dataset, there: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    plans, signs = list[TrainingSchedule](), list[list[float]]()
    model: Any = make_model(family, **FAMILIES[family]).fit(training, rng=np.random.default_rng(0))
    original = StandardisedModel.learn_further

    def remembered(self: Any, dataset: Dataset, plan: TrainingSchedule, trainings: Any) -> Any:
        plans.append(plan)
        signs.append(self.mirror.states.tolist())
        assert dataset is there
        return original(self, dataset, plan, trainings)

    monkeypatch.setattr(StandardisedModel, "learn_further", remembered)
    model.trained_further(there, 7, rng=np.random.default_rng(1))
    (plan,) = plans
    assert (plan.one_step_updates, plan.updates, plan.horizon) == (5, 2, 5)
    assert plan.learning_rate == TrainingSchedule(1, 1, 1).learning_rate
    assert plan.input_noise == model.input_noise
    assert signs == [[1.0, -1.0, -1.0]]


@pytest.mark.parametrize("family", ["mlp_ensemble", "neural_ode"])
def test_left_turns_teach_something_of_right_turns(
    family: str, training: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    model: Any = make_model(family, **{**FAMILIES[family], "one_step_updates": 300, "updates": 20}).fit(training, rng=0)
    other, steps, rng = FloorCar(turn=2.0), 300, np.random.default_rng(3)
    controls = np.repeat(rng.uniform([0.3, 0.2], 1.0, (steps // 5, 2)), 5, axis=0)
    left = recorded(other, controls)
    right = recorded(other, controls * [1.0, -1.0])
    seen_in_the_mirror = model.trained_further(left, 200, rng=np.random.default_rng(0)).score(right)
    monkeypatch.setattr(Mirror, "of", lambda *_: None)
    assert seen_in_the_mirror > 0.93 * model.trained_further(left, 200, rng=np.random.default_rng(0)).score(right)


def recorded(car: FloorCar, controls: Array) -> Dataset:
    """Return what the car does from rest under ``controls`` (H, 2)."""
    states = np.zeros((len(controls) + 1, 3))
    for k, control in enumerate(controls):
        states[k + 1] = car.step(states[k : k + 1], control[None])[0]
    return Dataset.from_arrays(car.system, states, controls)


def test_of_a_mean_the_shares_stay_and_a_member_without_updates_is_the_same(training: Dataset, there: Dataset) -> None:
    rng = np.random.default_rng(0)
    network: Any = make_model("mlp_ensemble", **FAMILIES["mlp_ensemble"]).fit(training, rng=rng)
    linear: Any = make_model("auto", candidates=["linear"], folds=2).fit(training, rng=rng)
    mean = linear.of([network, linear.members_[0]], np.array([0.25, 0.75]))
    further = mean.trained_further(there, 2, rng=rng)
    np.testing.assert_array_equal(further.weights_, [0.25, 0.75])
    assert further.members_[1] is linear.members_[0]
    assert further.members_[0] is not network
    assert mean.members_[0] is network
