"""What is trained and what steps are the same model, and its gradients are derivatives."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from model_zoo.backprop27 import Backprop27
from model_zoo.car.hybrid_ode import CarPhysics, HybridOde
from model_zoo.networks.backpropagation import StandardisedModel
from model_zoo.networks.mlp_ensemble import LaggedMembers, MlpEnsemble
from model_zoo.networks.network import Layers, random_network
from model_zoo.networks.neural_ode import Flow
from model_zoo.networks.training import Batches, Shots
from model_zoo.scaling import Mirror
from sysid_evo.data import Dataset
from sysid_evo.models import save_model
from sysid_evo.models.base import make_model
from sysid_evo.models.dynamics import rk4
from sysid_evo.progress import Counter
from sysid_evo.system import Channel, System
from sysid_evo.testing import example_dataset
from sysid_evo.types import Array


@pytest.fixture(scope="module")
def recording() -> Dataset:
    return example_dataset()


@pytest.fixture(scope="module")
def ensemble(recording: Dataset) -> MlpEnsemble:
    model = MlpEnsemble(
        members=3, hidden=[16], state_lags=1, control_lags=2, one_step_updates=200, updates=40, horizon=10, folds=3
    )
    return model.fit(recording, rng=np.random.default_rng(4))


def test_layers_and_plain_networks_agree() -> None:
    rng = np.random.default_rng(0)
    network = random_network([4, 7, 5, 2], 3, rng)
    inputs, centre, scale, output = rng.standard_normal((6, 4)), np.ones(4), rng.uniform(1, 2, 4), np.array([2.0, 3.0])
    layers = Layers([4, 7, 5, 2], 3, centre=centre, scale=scale, output_scale=output)
    parameters = layers.flat(network)
    layers.take(parameters)
    layers.reserve(2, 6)[1] = inputs
    folded = network.folded(centre, scale, output)
    np.testing.assert_allclose(layers.forward(1), folded(inputs), atol=1e-5)
    np.testing.assert_allclose(layers.network(parameters)(inputs), network(inputs), atol=1e-5)


def test_a_folded_network_takes_raw_inputs() -> None:
    rng = np.random.default_rng(0)
    network = random_network([4, 7, 2], 3, rng)
    centre, scale, output = rng.standard_normal(4), rng.uniform(1, 2, 4), rng.uniform(1, 2, 2)
    inputs = rng.standard_normal((6, 4))
    np.testing.assert_allclose(
        network.folded(centre, scale, output)(inputs), network((inputs - centre) / scale) * output, atol=1e-12
    )


def members(dataset: Dataset) -> StandardisedModel:
    mirror = Mirror.of(dataset.system, ["steer"])
    rng = np.random.default_rng(0)
    return LaggedMembers(dataset, (1, 3), hidden=[7, 6], members=2, further=1, mirror=mirror, rng=rng)


def flow(dataset: Dataset) -> StandardisedModel:
    return Flow(dataset, (2, 1), hidden=[7], rng=np.random.default_rng(0))


def hybrid(dataset: Dataset) -> StandardisedModel:
    model = Flow(dataset, (0, 2), hidden=[5], rng=np.random.default_rng(0))
    model.know(CarPhysics((0, 1, 2, 0, 1)), HybridOde.initial)
    return model


def swinging() -> Dataset:
    """Return a recording of a pendulum, whose angle is periodic."""
    system = System(
        (Channel("angle", "rad", period=2.0 * np.pi), Channel("rate", "rad/s")), (Channel("torque", "N m"),), dt=0.1
    )
    rng = np.random.default_rng(0)
    states, torque = np.zeros((41, 2)), np.repeat(rng.uniform(-2.0, 2.0, (10, 1)), 4, axis=0)
    for k in range(40):
        angle, rate = states[k]
        states[k + 1] = angle + 0.1 * rate, rate + 0.1 * (torque[k, 0] - 4.0 * np.sin(angle) - 0.3 * rate)
    return Dataset.from_arrays(system, [states], [torque])


@pytest.mark.parametrize(
    ("make", "record"),
    [(members, example_dataset), (flow, example_dataset), (hybrid, example_dataset), (flow, swinging)],
)
def test_the_gradient_of_a_free_run_is_its_derivative(
    make: Callable[[Dataset], StandardisedModel], record: Callable[[], Dataset]
) -> None:
    """Of a random sum of all states of all steps, by every eleventh parameter and the last nine."""
    dataset, rng = record(), np.random.default_rng(3)
    model = make(dataset)
    count, size = model.parameters.shape
    shots = Shots.of(dataset, 6, model.layout.history)
    batch = Batches([shots] * count, model.layout.history).of(rng.integers(0, len(shots), (count, 9)), 6)
    batch = model.augmented(batch, rng)
    weights = rng.standard_normal((6, count, 9, dataset.system.nx)).astype(np.float32)
    model.run(batch)
    found, before = model.gradient(weights), model.parameters
    for place in (*range(0, size - 9, 11), *range(size - 9, size)):
        sums = []
        for step in (2e-3, -2e-3):
            model.parameters = before.copy()
            model.parameters[:, place] += step
            sums.append(np.sum(model.run(batch).astype(np.float64) * weights, axis=(0, 2, 3)))
        slope = (sums[0] - sums[1]) / 4e-3
        np.testing.assert_allclose(found[:, place], slope, atol=1e-3 * np.abs(found).max())


@pytest.mark.parametrize("family", ["mlp_ensemble", "neural_ode", "hybrid_ode"])
def test_what_was_trained_is_what_steps(family: str, recording: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its free runs over the held-out windows, in single precision, are those of the fitted model."""
    seen: list[tuple[StandardisedModel, Array]] = []
    learn = StandardisedModel.learn

    def watched(self: StandardisedModel, *arguments: Any) -> Any:
        learned = learn(self, *arguments)
        seen.append((self, learned[0]))
        return learned

    monkeypatch.setattr(StandardisedModel, "learn", watched)
    small = {"hidden": [8], "one_step_updates": 40, "updates": 20, "horizon": 4, "state_lags": 1, "control_lags": 2}
    model = make_model(family, **small, **({"members": 1} if family == "mlp_ensemble" else {}))
    model.fit(recording, rng=np.random.default_rng(0))
    trained, trained.parameters = seen[-1]
    trained.as_recorded()
    windows = recording.windows(5, stride=20, history=2)
    shots = Shots.at(recording, windows.episode, windows.start, 5)
    found = trained.run(Batches([shots], 2).of([np.arange(len(shots))], 5))
    expected = model.simulate(windows.past_states, windows.past_controls, windows.controls)
    np.testing.assert_allclose(np.moveaxis(found[:, 0], 0, 1), expected, atol=2e-4)


def test_the_rotation_of_the_frame_alone_keeps_the_speed(car: System) -> None:
    state = np.array([[1.0, 0.2, 3.0]])
    after = rk4(car.turning, state, 0.05)
    assert np.hypot(*after[0, :2]) == pytest.approx(np.hypot(1.0, 0.2), abs=1e-6)


def test_runge_kutta_is_of_fourth_order() -> None:
    def error(dt: float) -> float:
        state = np.array([[1.0]])
        for _ in range(round(1.0 / dt)):
            state = rk4(lambda x: -(x**2), state, dt)
        return abs(float(state[0, 0]) - 0.5)

    assert 3.7 < np.log2(error(0.1) / error(0.05)) < 4.3


def test_a_mirrored_car_steers_the_other_way(car: System) -> None:
    mirror = Mirror.of(car, ["steer"])
    assert mirror is not None
    assert mirror.states.tolist() == [1.0, -1.0, -1.0]
    assert mirror.controls.tolist() == [1.0, -1.0]
    assert Mirror.of(car, ["rudder"]) is None


def test_the_ensemble_learns_and_its_members_differ(ensemble: MlpEnsemble, recording: Dataset) -> None:
    windows = recording.windows(20, stride=10, history=2)
    simulated = ensemble.simulate(windows.past_states, windows.past_controls, windows.controls)
    error = np.sqrt(np.mean((simulated - windows.states) ** 2)) / windows.states.std()
    assert error < 0.5
    carry = ensemble.start(windows.past_states, windows.past_controls)
    outputs = ensemble.network(np.concatenate([carry, windows.controls[:, 0]], axis=1))
    assert np.abs(outputs[0] - outputs[1]).max() > 1e-3


def test_ninety_per_cent_intervals_hold_ninety_per_cent(ensemble: MlpEnsemble) -> None:
    fresh = example_dataset(seed=9)
    windows = fresh.windows(20, stride=5, history=2)
    ensemble.set_params(stochastic=True)
    drawn = ensemble.simulate(
        windows.past_states, windows.past_controls, windows.controls, samples=60, rng=np.random.default_rng(0)
    )
    ensemble.set_params(stochastic=False)
    low, high = np.quantile(drawn[:, :, -1], [0.05, 0.95], axis=0)
    truth = windows.states[:, -1]
    assert 0.75 < float(((truth >= low) & (truth <= high)).mean()) < 0.99


def test_a_stored_ensemble_steps_without_what_takes_long_to_load(ensemble: MlpEnsemble, tmp_path: Path) -> None:
    save_model(ensemble, tmp_path / "model")
    script = (
        "import sys, numpy as np\n"
        "from sysid_evo.models import load_model\n"
        f"model = load_model({str(tmp_path / 'model')!r})\n"
        "model.step(np.zeros((1, model.n_carry)), np.zeros((1, 2)))\n"
        "assert not {'scipy', 'sklearn', 'pandas', 'numba', 'torch'} & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("optimiser", ["adam", "gradient"])
def test_back_propagation_fits_a_linear_map(optimiser: str) -> None:
    rng = np.random.default_rng(0)
    inputs = rng.standard_normal((200, 3))
    targets = 0.4 * inputs @ rng.standard_normal((3, 2))

    def error(epochs: int) -> float:
        model = Backprop27(epochs=epochs, optimiser=optimiser, learning_rate=0.02 if optimiser == "adam" else 0.2)
        counter = Counter(None, epochs)
        first, first_bias, last, last_bias = model._trained(inputs, targets, np.random.default_rng(1), counter)
        hidden = np.tanh(inputs @ first + first_bias).reshape(200, 2, 8)
        guess: Array = np.einsum("nsh,sh->ns", hidden, last) + last_bias
        return float(np.mean((guess - targets) ** 2) / targets.var())

    assert error(600) < 0.05 < error(1)
