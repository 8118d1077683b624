"""Functions, modules and objects of other packages, stored and loaded in another process, simulate the same bits."""

import hashlib
import subprocess
import sys

import numpy as np
import pytest
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline

from model_zoo.estimators import read, written
from sysid_evo import as_model, load_model, load_plugin, make_model, save_model
from sysid_evo.errors import ArtefactError, InvalidArgument
from sysid_evo.models.adapters import as_spec
from tests.fixtures.plants import pendulum

ps, control, torch = (pytest.importorskip(name) for name in ("pysindy", "control", "torch"))
FILE = """
import numpy as np
import torch
from sklearn.base import BaseEstimator, RegressorMixin


def swing_with_gain(x, u, p=(("gain", 0.1, 10.0),)):
    return [x[1], -9.0 * np.sin(x[0]) - 0.5 * x[1] + p[0] * u[0]]


class Layers(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.layers = torch.nn.Sequential(torch.nn.Linear(3, 4), torch.nn.SiLU(), torch.nn.Linear(4, 2))

    def forward(self, x, u):
        return self.layers(torch.cat([x, u], dim=1))


class Means(RegressorMixin, BaseEstimator):
    def __init__(self, share=0.5):
        self.share = share

    def fit(self, x, y):
        self.means_ = self.share * np.mean(y, axis=0)
        self.n_features_in_ = np.shape(x)[1]
        return self

    def predict(self, x):
        return self.means_ + 0.1 * np.sum(x, axis=1)


class Plain:
    pass
"""
PROGRAM = """
import hashlib, sys
import numpy as np
from sysid_evo import load_model, load_plugin

load_plugin("stored_objects_plugin.py")
start, controls = np.load("start.npy"), np.load("controls.npy")
for name in sys.argv[1:]:
    print(hashlib.sha256(load_model(name).simulate(start, controls).tobytes()).hexdigest())
"""


def test_models_in_a_fresh_process_simulate_the_same_bits(tmp_path, monkeypatch):
    data = pendulum()
    (tmp_path / "stored_objects_plugin.py").write_text(FILE)
    load_plugin(tmp_path / "stored_objects_plugin.py")
    models = {
        "equations": make_model("equations", function="swing_with_gain", starts=1, windows=20),
        "torch": make_model("torch_module", module="Layers", updates=5, horizon=2),
        "regressor": make_model("regressor(estimator=Means, share=0.9, state_lags=0, control_lags=0)"),
        "sindy": as_model(ps.SINDy(feature_library=ps.PolynomialLibrary(2) + ps.FourierLibrary(1))),
        "lti": as_model(control.ss([[0.0, 1.0], [-9.0, -0.5]], [[0.0], [2.0]], np.eye(2), 0)),
    }
    start, controls = data.episodes[0].states[:1], data.episodes[0].controls[:50]
    np.save(tmp_path / "start.npy", start)
    np.save(tmp_path / "controls.npy", controls)
    expected = []
    for name, model in models.items():
        save_model(model.fit(data, rng=0), tmp_path / name)
        expected.append(hashlib.sha256(model.simulate(start, controls).tobytes()).hexdigest())
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *models], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == expected
    module = sys.modules["sysid_evo_plugin_stored_objects_plugin"]
    assert as_spec(module.Means(share=0.9)).text == "regressor(estimator=Means, share=0.9)"
    with pytest.raises(InvalidArgument, match=r"Plain: expected a class of sklearn\.base\.RegressorMixin"):
        make_model("regressor(estimator=Plain)")
    with monkeypatch.context() as patch:
        patch.delitem(sys.modules, module.__name__)
        with pytest.raises(ArtefactError, match=r"called 'Means'.*a class in a plugin file: --plugin FILE"):
            load_model(tmp_path / "regressor")
        with pytest.raises(ArtefactError, match=r"names sysid_evo_plugin_.*Means, not among .* with --plugin FILE"):
            read(models["regressor"].format_, models["regressor"].stored_.tobytes())
    with pytest.raises(InvalidArgument, match=r"Plain is not among the trusted types"):
        written(make_pipeline(module.Plain(), Ridge()))
