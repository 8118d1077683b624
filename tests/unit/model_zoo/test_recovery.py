"""Every family that contains linear systems recovers one from data without noise, also on a free run."""

from typing import Any

import numpy as np
import pytest

from sysid_evo.models.base import make_model
from sysid_evo.types import Array
from tests.fixtures.systems import AUTONOMOUS, DRIVEN, ONE_STATE, LinearSystem

EXACT = 1e-8
EXACT_FAMILIES: dict[str, dict[str, Any]] = {
    "linear": {},
    "narx": {"degree": 1, "terms": 4, "state_lags": 0, "control_lags": 0},
    "sindy_discrete": {"degree": 1, "threshold": 0.0, "ridge": 0.0, "state_lags": 0, "control_lags": 0},
}
SYSTEMS = {"driven": DRIVEN, "autonomous": AUTONOMOUS, "one state": ONE_STATE}


@pytest.fixture(scope="module", autouse=True)
def pysindy():
    """SINDy imports it in its first fit, which takes longer than a unit test may."""
    return pytest.importorskip("pysindy")


def free_run_error(model, fresh):
    """The largest error of whole episodes from their first states."""
    return max(float(np.abs(model.simulate(e.states[0], e.controls) - e.states[1:]).max()) for e in fresh)


def later(learned):
    """Return pieces that begin later: other starts, inside the training range."""
    return learned.with_episodes([episode[7:90] for episode in learned.episodes])


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("family", EXACT_FAMILIES)
def test_a_linear_system_is_recovered_exactly(family, name):
    """Every step, and every free run, to rounding."""
    system: LinearSystem = SYSTEMS[name]
    learned = system.recording(seed=1)
    model = make_model(family, **EXACT_FAMILIES[family]).fit(learned)
    data = learned.transitions()
    expected: Array = data.state @ system.a.T + data.control @ system.b.T
    np.testing.assert_allclose(model.step(data.carry, data.control), expected, atol=EXACT)
    assert free_run_error(model, later(learned)) < EXACT


def test_the_linear_family_is_exact_outside_the_training_range_too():
    """The others clip their inputs to it."""
    model = make_model("linear").fit(DRIVEN.recording(seed=1))
    assert free_run_error(model, DRIVEN.recording(seed=2)) < EXACT


def test_a_linear_differential_equation_is_recovered_to_the_order_of_its_difference():
    """The data follow its trapezoidal rule, of which the difference is the exact inverse; RK4 differs by dt^2."""
    rate = np.array([[0.0, 1.0], [-1.0, -0.3]])
    for dt in (0.1, 0.01):
        half = np.linalg.inv(np.eye(2) - 0.5 * dt * rate)
        exact = half @ (np.eye(2) + 0.5 * dt * rate)
        system = LinearSystem(DRIVEN.system.with_dt(dt), exact, half @ np.array([[0.0], [dt]]))
        learned = system.recording(seed=1)
        model = make_model("sindy", degree=1, threshold=0.0, ridge=0.0, control_lags=0).fit(learned)
        found = {tuple(int(p) for p in e): c for e, c in zip(model.exponents_, model.coefficients_, strict=True)}
        np.testing.assert_allclose(found[1, 0, 0], rate[:, 0], atol=1e-6)
        np.testing.assert_allclose(found[0, 1, 0], rate[:, 1], atol=1e-6)
        np.testing.assert_allclose(found[0, 0, 1], [0.0, 1.0], atol=1e-6)
        assert free_run_error(model, later(learned)) < 0.5 * dt**2


@pytest.mark.parametrize("system", [DRIVEN, AUTONOMOUS], ids=["driven", "autonomous"])
def test_a_gaussian_process_recovers_a_linear_system_to_a_thousandth(system):
    """Its covariance is singular in double precision; the process makes up for the shrunk linear part."""
    learned = system.recording(seed=1)
    model = make_model("gaussian_process", inducing=60, state_lags=0, control_lags=0).fit(learned)
    data = learned.transitions()
    assert np.abs(model.step(data.carry, data.control) - data.after).max() < 1e-3
    assert free_run_error(model, later(learned)) < 0.01


def test_the_plane_through_neighbours_follows_a_linear_system_where_it_has_neighbours():
    learned = DRIVEN.recording(seed=1, episodes=8)
    model = make_model("k_neighbours", neighbours=8, state_lags=0, control_lags=0).fit(learned)
    data = learned.transitions()
    error, change = model.step(data.carry, data.control) - data.after, data.after - data.state
    assert np.sqrt(np.mean(error**2)) < 0.05 * np.sqrt(np.mean(change**2))
    assert model.score(learned) > -0.1


def test_nearest_neighbour_repeats_what_it_recorded():
    learned = DRIVEN.recording(seed=1)
    model = make_model("nearest_neighbour").fit(learned)
    assert free_run_error(model, learned) < EXACT
