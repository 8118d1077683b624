"""The packages of the field find systems of their own kind, and their models are stored like others."""

import numpy as np
import pytest

from sysid_evo import Dataset, load_model, make_model, save_model
from sysid_evo.registry.plugins import load_plugin
from sysid_evo.system import Channel, System
from tests.benchmarks.field.__main__ import PLUGIN, main

load_plugin(PLUGIN)  # as the command does: an import would register the families twice
SYSTEM = System((Channel("y"),), (Channel("u", low=-1.0, high=1.0),), dt=0.1)


def recording(step, steps=600):
    """Return two episodes of y(k + 1) = ``step`` of the last two outputs and inputs, newest first."""
    rng, episodes, controls = np.random.default_rng(0), [], []
    for _ in range(2):
        u, y = rng.uniform(-1.0, 1.0, steps), np.zeros(steps + 1)
        for k in range(1, steps):
            y[k + 1] = step(y[k], y[k - 1], u[k], u[k - 1])
        episodes.append(y[1:, None])
        controls.append(u[1:, None])
    return Dataset.from_arrays(SYSTEM, episodes, controls)


def second_order(y, y_before, u, u_before):
    return 1.2 * y - 0.5 * y_before + 0.3 * u + 0.1 * u_before


RECOVERED = {
    "sysidentpy_frols": ("sysidentpy", lambda y, z, u, v: 0.5 * y + 0.2 * z + 0.3 * u + 0.1 * v * y, 1e-2),
    "sysidentpy_narx": ("sysidentpy", lambda y, z, u, v: 0.5 * y + 0.2 * z + 0.3 * u + 0.1 * v * y, 1e-2),
    "pydmd_dmdc": ("pydmd", lambda y, z, u, v: 0.9 * y + 0.3 * u, 1e-2),
    "nfoursid": ("nfoursid", second_order, 5e-2),
}


@pytest.mark.parametrize("name", RECOVERED)
def test_a_package_recovers_a_system_of_its_own_kind(name):
    """But for the joint of two episodes, which they take for a sample."""
    package, step, error = RECOVERED[name]
    pytest.importorskip(package)
    dataset = recording(step)
    model = make_model(name).fit(dataset, rng=0)
    assert -model.score(dataset) < error


@pytest.mark.parametrize("name", ["nfoursid", "deepsi_subnet"])
def test_a_model_with_a_hidden_state_is_stored_and_simulates_the_same(name, tmp_path):
    pytest.importorskip({"nfoursid": "nfoursid", "deepsi_subnet": "deepSI"}[name])
    dataset = recording(second_order, 200)
    model = make_model(name, **({"updates": 2} if name == "deepsi_subnet" else {})).fit(dataset, rng=0)
    save_model(model, tmp_path / "model")
    episode = dataset.episodes[0]
    np.testing.assert_array_equal(load_model(tmp_path / "model").simulate(episode), model.simulate(episode))


@pytest.mark.parametrize(("episodes", "steps", "lags"), [(20, 20, 6), (1, 180, 18), (1, 500, 20)])
def test_a_network_is_fitted_to_short_recordings_with_a_short_history(episodes, steps, lags):
    pytest.importorskip("deepSI")
    long = recording(second_order, 500).episodes[0]
    short = Dataset(SYSTEM, tuple(long[steps * i : steps * i + steps] for i in range(episodes)))
    model = make_model("deepsi_subnet", updates=2).fit(short, rng=0)
    assert model.n_lags == lags


@pytest.mark.nightly
def test_the_command_prints_a_row_for_each_package(tmp_path, capsys):
    for package in ("sysidentpy", "pydmd"):
        pytest.importorskip(package)
    main(["--out", str(tmp_path), "--systems", "emulated_car", "--models", "pydmd", "sysidentpy", "ridge",
          "--minutes", "1", "--generations", "2", "--search-minutes", "0.01"])  # fmt: skip
    rows = [line.split() for line in capsys.readouterr().out.splitlines() if line.split()[:1] in (["pydmd"], ["ridge"])]
    assert len(rows) == 2
    assert all(float(row[1]) > 0 for row in rows)
