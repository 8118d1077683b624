"""An object of pysindy is a family: fitted as it is configured, simulated as by pysindy, compiled and stored."""

import numpy as np
import pytest
from sklearn.linear_model import Lasso

from sysid_evo import as_model, load_model, save_model
from sysid_evo.errors import ArtefactError, InvalidArgument
from tests.fixtures.plants import pendulum
from tests.fixtures.systems import ONE_STATE

ps = pytest.importorskip("pysindy")
STEPS = 40


@pytest.fixture(scope="module")
def swinging():
    return pendulum()


def fitted(peer, dataset):
    """Fit ``peer`` by pysindy alone; the last control of an episode is held at its end."""
    held = [np.concatenate([run.controls, run.controls[-1:]]) for run in dataset]
    return peer.fit([run.states for run in dataset], t=dataset.system.dt, u=held)


def sines():
    return ps.CustomLibrary([lambda a: np.sin(a), lambda a: a * np.abs(a), lambda a: a**3])


LIBRARIES = {
    "polynomial": lambda: ps.PolynomialLibrary(degree=3, include_interaction=False),
    "fourier and identity": lambda: ps.ConcatLibrary([ps.FourierLibrary(2), ps.IdentityLibrary()]),
    "custom": lambda: ps.ConcatLibrary([ps.PolynomialLibrary(1), sines()]),
    "tensored": lambda: ps.TensoredLibrary([ps.PolynomialLibrary(1), ps.FourierLibrary(1)]),
}


@pytest.mark.parametrize("name", LIBRARIES)
def test_a_discrete_object_simulates_as_pysindy_does(name, swinging):
    peer = ps.DiscreteSINDy(feature_library=LIBRARIES[name](), optimizer=ps.STLSQ(threshold=0.0, alpha=1e-3))
    model = as_model(peer).fit(swinging, rng=0)
    states, controls = swinging.episodes[0].states, swinging.episodes[0].controls
    expected = fitted(peer, swinging).simulate(states[0], STEPS + 1, u=controls[: STEPS + 1])[1:]
    found = model.simulate(states[0], controls[:STEPS])
    assert np.array_equal(found, np.clip(found, *(0.999 * model.state_bounds_))), "no state reaches its bounds"
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9)
    assert model.kernel() is not None


def test_a_continuous_object_approaches_the_simulation_of_pysindy_with_the_fourth_order(swinging):
    peer = fitted(ps.SINDy(feature_library=LIBRARIES["custom"](), optimizer=ps.STLSQ(threshold=0.2)), swinging)
    states, torque = swinging.episodes[0].states, swinging.episodes[0].controls[0, 0]
    expected = peer.simulate(states[0], 0.05 * np.arange(6), u=lambda t: np.full((np.size(t), 1), torque)[0])[1:]
    errors = []
    for substeps in (1, 2):
        model = as_model(peer).set_params(substeps=substeps).fit(swinging, rng=0)
        assert "used as it is" in model.fit_note
        np.testing.assert_array_equal(model.coefficients_, peer.coefficients().T)
        errors.append(np.abs(model.simulate(states[0], np.full((5, 1), torque)) - expected).max())
    assert errors[0] < 1e-4
    assert 10.0 < errors[0] / errors[1] < 24.0


def test_the_settings_of_the_object_are_used(swinging):
    few = as_model(ps.SINDy(optimizer=ps.STLSQ(threshold=0.4))).fit(swinging, rng=0)
    smooth = as_model(ps.SINDy(differentiation_method=ps.SmoothedFiniteDifference())).fit(swinging, rng=0)
    plain = as_model(ps.SINDy()).fit(swinging, rng=0)
    assert (few.coefficients_ != 0).sum() < (plain.coefficients_ != 0).sum()
    assert not np.array_equal(smooth.coefficients_, plain.coefficients_)
    assert few.equations()[0].startswith("rate of angle = ")
    assert "[1/s^2] angle" in few.equations()[1]


def test_an_object_without_any_term_and_one_with_a_regressor_for_a_single_state_are_fitted(swinging):
    none = as_model(ps.SINDy(optimizer=ps.STLSQ(threshold=1e6))).fit(swinging, rng=0)
    assert "all its coefficients are zero: lower the threshold" in none.fit_note
    single = as_model(ps.SINDy(optimizer=Lasso(alpha=1e-3))).fit(ONE_STATE.recording(), rng=0)
    assert single.coefficients_.shape[1] == 1


def test_an_ensemble_depends_on_the_seed_alone(swinging):
    ensemble = ps.SINDy(optimizer=ps.EnsembleOptimizer(ps.STLSQ(), bagging=True, n_models=3))
    first, again, other = (as_model(ensemble).fit(swinging, rng=seed).coefficients_ for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_library_without_a_compiled_form_is_evaluated_by_pysindy(swinging, tmp_path, monkeypatch):
    strange = ps.SINDy(feature_library=ps.CustomLibrary([lambda a, b: a * b, lambda a: a / (1.0 + a * a)]))
    model = as_model(strange).fit(swinging, rng=0)
    states, controls = swinging.episodes[0].states[:3], swinging.episodes[0].controls[:3]
    assert model.kernel() is None
    assert "evaluated by pysindy" in model.fit_note
    expected = fitted(strange, swinging).predict(states, controls)
    np.testing.assert_allclose(model.right_side(states, controls), expected, rtol=1e-9)
    save_model(model, tmp_path / "model")
    found = load_model(tmp_path / "model")
    np.testing.assert_array_equal(found.right_side(states, controls), model.right_side(states, controls))
    monkeypatch.setattr("sysid_evo.registry.objects._objects", {})
    with pytest.raises(ArtefactError, match="was given in Python, and only its results are stored"):
        load_model(tmp_path / "model")


def test_what_cannot_be_stepped_is_refused_with_the_reason(swinging):
    spatial = ps.PDELibrary(function_library=ps.PolynomialLibrary(1))
    with pytest.raises(InvalidArgument, match="PDELibrary is not supported: there are no spatial derivatives"):
        as_model(ps.SINDy(feature_library=spatial)).fit(swinging, rng=0)
    with pytest.raises(InvalidArgument, match=r"expected a SINDy, .*SINDy\(optimizer=STLSQ\(\.\.\.\)\)"):
        as_model(ps.STLSQ())
    with pytest.raises(InvalidArgument, match="expected a fitted SINDy; without fitted=True it is fitted"):
        as_model(ps.SINDy(), fitted=True).fit(swinging, rng=0)
    alone = ps.SINDy(optimizer=ps.STLSQ(threshold=0.0)).fit(swinging.episodes[0].states[:, :1], t=0.05)
    with pytest.raises(InvalidArgument, match="fitted to 2 states and 1 controls, got 1 and 0"):
        as_model(alone, fitted=True).fit(swinging, rng=0)
