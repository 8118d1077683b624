"""The linear family against systems that are linear."""

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidArgument
from sysid_evo.models.base import make_model
from sysid_evo.system import Channel, System

SYSTEM = System((Channel("a"), Channel("b")), (Channel("u"),), dt=0.1)
A = np.array([[0.9, 0.2], [-0.1, 0.7]])
B = np.array([[0.5], [-1.0]])
C = np.array([0.3, -0.2])


def record(step, seed=1, length=60, low=-1.0, high=1.0):
    """Two episodes of ``step(states, controls, k)``, which looks back two samples, under random controls."""
    rng = np.random.default_rng(seed)
    episodes = []
    for _ in range(2):
        u = rng.uniform(low, high, (length, 1))
        x = [*rng.standard_normal((3, 2))]
        for k in range(2, length):
            x.append(step(x, u, k))
        episodes.append((np.array(x), u))
    return Dataset.from_arrays(SYSTEM, [x for x, _ in episodes], [u for _, u in episodes])


def led_to(step, **options):
    """Return what `record` returns without the first two samples, which no equation leads to."""
    dataset = record(step, **options)
    return dataset.with_episodes([episode[2:] for episode in dataset.episodes])


def affine(x, u, k):
    return A @ x[k] + B @ u[k] + C


def arx(x, u, k):
    return A @ x[k] - 0.3 * x[k - 1] + 0.05 * x[k - 2] + B @ u[k] + 0.4 * B @ u[k - 1] + C


def test_a_linear_system_is_recovered_exactly():
    model = make_model("linear").fit(led_to(affine), rng=0)
    np.testing.assert_allclose(model.coefficients_, np.concatenate([A.T, B.T]), atol=1e-12)
    np.testing.assert_allclose(model.intercept_, C, atol=1e-12)


def test_a_system_with_memory_is_recovered_exactly_with_lags():
    model = make_model("linear", state_lags=2, control_lags=1).fit(record(arx), rng=0)
    expected = np.concatenate([A.T, -0.3 * np.eye(2), 0.05 * np.eye(2), 0.4 * B.T, B.T])
    np.testing.assert_allclose(model.coefficients_, expected, atol=1e-11)
    np.testing.assert_allclose(model.intercept_, C, atol=1e-11)
    fresh = record(arx, seed=2)
    windows = fresh.windows(30, history=2, stride=10)
    simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)
    np.testing.assert_allclose(simulated, windows.states, atol=1e-9)


def test_without_the_lags_it_needs_it_errs():
    fresh = record(arx, seed=2)
    model = make_model("linear").fit(record(arx), rng=0)
    windows = fresh.windows(1, history=2)
    simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)
    assert np.abs(simulated - windows.states).max() > 0.1


def test_without_an_intercept_the_line_goes_through_the_origin():
    def homogeneous(x, u, k):
        return A @ x[k] + B @ u[k]

    model = make_model("linear", intercept=False).fit(led_to(homogeneous), rng=0)
    np.testing.assert_allclose(model.coefficients_, np.concatenate([A.T, B.T]), atol=1e-12)
    np.testing.assert_array_equal(model.intercept_, [0.0, 0.0])
    biased = make_model("linear", intercept=False).fit(led_to(affine), rng=0)
    np.testing.assert_array_equal(biased.next_state(np.zeros((1, 2)), np.zeros((1, 1))), [[0.0, 0.0]])


def test_ridge_is_the_closed_form_on_standardised_inputs():
    dataset = led_to(affine)
    data = dataset.transitions()
    inputs = np.concatenate([data.carry, data.control], axis=1)
    z = (inputs - inputs.mean(axis=0)) / inputs.std(axis=0)
    y = data.after - data.after.mean(axis=0)
    expected = np.linalg.solve(z.T @ z / len(z) + 0.7 * np.eye(3), z.T @ y / len(z)) / inputs.std(axis=0)[:, None]
    model = make_model("linear", ridge=0.7).fit(dataset, rng=0)
    np.testing.assert_allclose(model.coefficients_, expected, rtol=1e-9)
    mean = model.next_state(inputs[:, :2].mean(axis=0)[None], inputs[:, 2:].mean(axis=0)[None])
    np.testing.assert_allclose(mean[0], data.after.mean(axis=0), rtol=1e-9)


@pytest.mark.parametrize("constant", [0.0, 0.1, -0.3])
def test_a_control_that_never_changed_has_no_effect(constant):
    """0.1 has a standard deviation of 1e-17 in floating point, which must not become a gain."""
    dataset = led_to(affine, low=constant, high=constant)
    model = make_model("linear").fit(dataset, rng=0)
    np.testing.assert_allclose(model.coefficients_[2], 0.0, atol=1e-9)
    np.testing.assert_allclose(model.coefficients_[:2], A.T, atol=1e-9)


@pytest.mark.parametrize("name", ["ridge", "state_lags", "control_lags"])
def test_negative_parameters_are_refused_when_they_are_given(name):
    with pytest.raises(InvalidArgument, match=rf"^Linear: {name}: expected a (whole )?number >= 0, got -1"):
        make_model("linear", **{name: -1.0 if name == "ridge" else -1})
