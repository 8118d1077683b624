"""A module of PyTorch is a family: rate, change or next state, trained from its weights or used as it is."""

import re

import numpy as np
import pytest

from sysid_evo import as_model, load_model, load_plugin, make_model, save_model
from sysid_evo.errors import ArtefactError, IncompatibleSystem, InvalidArgument
from sysid_evo.registry.objects import keep_object
from sysid_evo.testing import MODEL
from tests.fixtures.plants import pendulum

torch = pytest.importorskip("torch")
SHORT = {"updates": 12, "horizon": 3}


@pytest.fixture(scope="module")
def swinging():
    return pendulum()


class Physics(torch.nn.Module):
    """The pendulum with one unknown number."""

    def __init__(self, stiffness=9.0):
        super().__init__()
        self.stiffness = torch.nn.Parameter(torch.tensor(stiffness, dtype=torch.float64))

    def forward(self, x, u):
        return torch.stack([x[:, 1], -self.stiffness * torch.sin(x[:, 0]) - 0.5 * x[:, 1] + 2.0 * u[:, 0]], dim=1)


def equal_physics(x, u):
    return x[1], -9.0 * np.sin(x[0]) - 0.5 * x[1] + 2.0 * u[0]


def test_a_module_used_as_it_is_equals_the_same_equations_in_numpy(swinging):
    model = as_model(Physics(), fitted=True).fit(swinging, rng=0)
    expected = as_model(equal_physics).fit(swinging, rng=0)
    np.testing.assert_allclose(
        model.simulate(swinging.episodes[0]), expected.simulate(swinging.episodes[0]), rtol=1e-9, atol=1e-9
    )
    assert model.fit_note == "used as it is"


def test_training_starts_from_the_weights_and_leaves_the_object_alone(swinging):
    given = Physics(7.0)
    model = make_model("torch_module", module=keep_object(given), updates=150, learning_rate=0.05).fit(swinging, rng=0)
    assert abs(model.weights_[0] - 9.0) < 0.2
    assert given.stiffness.item() == 7.0


@pytest.mark.parametrize("returns", ["rate", "change", "next_state"])
def test_the_output_is_a_rate_a_change_or_the_next_state(returns, swinging):
    layer = torch.nn.Linear(3, 2).double()
    model = as_model(layer, fitted=True).set_params(returns=returns).fit(swinging, rng=0)
    x, u = swinging.episodes[0].states[:4], swinging.episodes[0].controls[:4]
    with torch.no_grad():
        out = layer(torch.tensor(np.concatenate([x, u], axis=1))).numpy()
        matrix = layer.weight.numpy()[:, :2]
    dt, powers = 0.05, [np.linalg.matrix_power(0.05 * matrix, k) for k in range(4)]
    series = powers[0] + powers[1] / 2.0 + powers[2] / 6.0 + powers[3] / 24.0  # Runge-Kutta of a linear equation
    expected = {"rate": x + dt * out @ series.T, "change": x + out, "next_state": out}[returns]
    np.testing.assert_allclose(model.next_state(x, u), expected, rtol=1e-12)


@pytest.mark.parametrize(
    "module", [Physics(), torch.nn.Sequential(torch.nn.Linear(3, 4), torch.nn.GELU(), torch.nn.Linear(4, 2))]
)
def test_modules_keep_the_contract(module, swinging):
    results = list(MODEL.run("torch_module", swinging, module=keep_object(module), **SHORT))
    assert not [f"{one.rule}: {one.failure}" for one in results if one.failure]


FILE = """import torch

class Small(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.inner = torch.nn.Linear(3, 4)
        self.norm = torch.nn.BatchNorm1d(4)
        self.outer = torch.nn.Linear(4, 2)

    def forward(self, x, u):
        return self.outer(torch.tanh(self.norm(self.inner(torch.cat([x, u], dim=1)))))
"""


def test_a_class_of_a_plugin_file_is_stored_by_its_name_with_its_weights(swinging, tmp_path):
    file = tmp_path / "my_small_module.py"
    file.write_text(FILE)
    load_plugin(file)
    model = make_model("torch_module", module="Small", **SHORT).fit(swinging, rng=0)
    restored = load_model(save_model(model, tmp_path / "model"))
    assert np.array_equal(restored.simulate(swinging.episodes[0]), model.simulate(swinging.episodes[0]))
    restored.weights_ = restored.weights_[::-1]
    with pytest.raises(InvalidArgument, match="weights_"):
        save_model(restored, tmp_path / "other")


def test_a_module_from_python_is_needed_again(swinging, tmp_path, monkeypatch):
    save_model(as_model(Physics(), fitted=True).fit(swinging, rng=0), tmp_path / "model")
    assert load_model(tmp_path / "model").weights_ == [9.0]
    monkeypatch.setattr("sysid_evo.registry.objects._objects", {})
    with pytest.raises(ArtefactError, match=r"<Python object Physics \w+> was given in Python"):
        load_model(tmp_path / "model")


def test_a_module_of_other_sizes_is_refused(swinging):
    expected = re.escape("expected forward(x, u) that turns (B, 2) and (B, 1) into (B, 2), in float64, got ")
    for module in (torch.nn.Linear(3, 1), torch.nn.Linear(5, 2)):
        with pytest.raises(IncompatibleSystem, match=expected):
            as_model(module).fit(swinging, rng=0)


class Remembering(Physics):
    """It adds the number of its calls."""

    calls = 0

    def forward(self, x, u):
        self.calls += 1
        return super().forward(x, u) + self.calls


class WithExtras(Physics):
    """It returns more than its outputs."""

    def forward(self, x, u):
        return super().forward(x, u), None


@pytest.mark.parametrize(
    ("module", "message"),
    [
        (Remembering(), "other outputs for the same inputs: it must neither keep a state nor draw"),
        (WithExtras(), "got a tuple"),
        (torch.nn.GRU(3, 2), "got a tuple"),
    ],
)
def test_a_module_with_a_memory_or_with_several_outputs_is_refused(module, message, swinging):
    with pytest.raises(IncompatibleSystem, match=message):
        as_model(module).fit(swinging, rng=0)


@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
def test_compiled_and_scripted_modules_are_trained_as_the_module_itself(swinging):
    for inner, given in (
        (module := Physics(), torch.compile(module)),
        (module, torch.jit.script(module)),
        (layer := torch.nn.Linear(3, 2), torch.jit.script(layer)),
    ):
        expected, found = (as_model(one).set_params(**SHORT).fit(swinging, rng=0) for one in (inner, given))
        np.testing.assert_allclose(found.weights_[0], expected.weights_[0], rtol=1e-9)


def test_a_module_without_trainable_weights_is_used_as_it_is(swinging):
    module = torch.nn.Linear(3, 2).requires_grad_(False)
    model = as_model(module).fit(swinging, rng=0)
    assert model.fit_note == "used as it is"
    assert np.array_equal(model.weights_[0], module.weight.double().numpy())
