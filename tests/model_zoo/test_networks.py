"""The differentiable form of a family and its NumPy form are the same model."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from model_zoo.backprop27 import Backprop27
from model_zoo.channels.mirror import Mirror
from model_zoo.flows.runge_kutta import rk4
from model_zoo.hybrid_ode import HybridOde
from model_zoo.mlp_ensemble import MlpEnsemble
from model_zoo.networks.multistep import as_network, as_tensors, forward_pass
from model_zoo.networks.network import random_network
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.motion.torch_form import torch_motion
from sysid_evo.progress import Counter
from sysid_evo.store import save_model
from sysid_evo.system import System
from sysid_evo.testing import example_dataset


@pytest.fixture(scope="module")
def recording() -> Dataset:
    return example_dataset()


@pytest.fixture(scope="module")
def ensemble(recording: Dataset) -> MlpEnsemble:
    model = MlpEnsemble(
        members=3, hidden=[16], state_lags=1, control_lags=2, one_step_updates=200, updates=40, horizon=10, folds=3
    )
    return model.fit(recording, rng=np.random.default_rng(4))


def test_torch_and_numpy_networks_agree() -> None:
    network = random_network([4, 7, 5, 2], 3, np.random.default_rng(0))
    inputs = np.random.default_rng(1).standard_normal((6, 4))
    values = torch.from_numpy(inputs.astype(np.float32))[None].expand(3, 6, 4)
    np.testing.assert_allclose(forward_pass(as_tensors(network), values).detach().numpy(), network(inputs), atol=1e-5)
    np.testing.assert_allclose(as_network(as_tensors(network))(inputs), network(inputs), atol=1e-5)


def test_a_folded_network_takes_raw_inputs() -> None:
    rng = np.random.default_rng(0)
    network = random_network([4, 7, 2], 3, rng)
    centre, scale, output = rng.standard_normal(4), rng.uniform(1, 2, 4), rng.uniform(1, 2, 2)
    inputs = rng.standard_normal((6, 4))
    np.testing.assert_allclose(
        network.folded(centre, scale, output)(inputs), network((inputs - centre) / scale) * output, atol=1e-12
    )


def test_torch_and_numpy_integrate_alike(car: System) -> None:
    rng = np.random.default_rng(0)
    state, acceleration = rng.standard_normal((5, 3)), rng.standard_normal((5, 3))
    motion, on_tensors = torch_motion(car), torch.from_numpy(state)
    ours = motion.integrate(on_tensors, torch.from_numpy(acceleration * car.dt), car.dt).numpy()
    np.testing.assert_allclose(ours, car.integrate(state, acceleration), atol=1e-12)
    turned = motion.turned(on_tensors, torch.from_numpy(acceleration)).numpy()
    np.testing.assert_allclose(turned, acceleration + car.turning(state), atol=1e-12)


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


def test_hybrid_physics_are_the_same_in_torch_and_numpy(recording: Dataset) -> None:
    model = HybridOde()
    model.system_ = recording.system
    model.physical_ = np.random.default_rng(1).uniform(0.5, 3.0, 9)
    rng = np.random.default_rng(2)
    state, control = rng.standard_normal((6, 3)), rng.uniform(-1, 1, (6, 2))
    theirs = model.torch_rate(*(torch.from_numpy(array) for array in (state, control, model.physical_)))
    np.testing.assert_allclose(theirs.numpy(), model.known_rate(state, control), atol=1e-12)


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


def test_a_stored_ensemble_steps_without_torch(ensemble: MlpEnsemble, tmp_path: Path) -> None:
    save_model(ensemble, tmp_path / "model")
    script = (
        "import sys, numpy as np\n"
        "from sysid_evo.store import load_model\n"
        f"model = load_model({str(tmp_path / 'model')!r})\n"
        "model.step(np.zeros((1, model.n_carry)), np.zeros((1, 2)))\n"
        "assert 'torch' not in sys.modules\n"
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
