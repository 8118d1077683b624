"""A model in python-control does what it does here."""

import numpy as np
import pytest

from sysid_evo.errors import IncompatibleSystem
from sysid_evo.interoperation import to_control
from sysid_evo.models.base import make_model


@pytest.fixture
def control():
    return pytest.importorskip("control")


@pytest.mark.parametrize("lags", [{}, {"state_lags": 1, "control_lags": 2}])
def test_its_response_is_the_free_run_of_the_model(lags, car_data, control):
    model = make_model("linear", **lags).fit(car_data, rng=np.random.default_rng(0))
    windows = car_data.windows(30, history=model.n_lags)[:1]
    start = model.start(windows.past_states, windows.past_controls)[0]
    times = np.arange(31) * car_data.system.dt
    inputs = np.concatenate([windows.controls[0], windows.controls[0, -1:]]).T
    response = control.input_output_response(to_control(model), times, inputs, start)
    free_run = model.simulate(windows.past_states, windows.past_controls, windows.controls)[0]
    np.testing.assert_allclose(response.outputs[:, 1:].T, free_run, atol=1e-9)


def test_names_and_sampling_time_are_those_of_the_system(car_data, control):
    system = to_control(make_model("linear", control_lags=1).fit(car_data, rng=np.random.default_rng(0)), name="car")
    assert (system.name, system.dt) == ("car", car_data.system.dt)
    assert system.input_labels == ["drive", "steer"]
    assert system.output_labels == ["forward_speed", "lateral_speed", "yaw_rate"]
    assert system.state_labels[3:] == ["drive[-1]", "steer[-1]"]


@pytest.mark.usefixtures("control")
def test_a_model_whose_steps_have_the_control_logged_after_them_is_refused(car_data):
    model = make_model("linear").fit(car_data.advanced(), rng=np.random.default_rng(0))
    with pytest.raises(IncompatibleSystem, match="to_control: the data have advance"):
        to_control(model)


def test_linearising_a_linear_model_gives_its_matrices(car_data, control):
    model = make_model("linear").fit(car_data, rng=np.random.default_rng(0))
    linear = control.linearize(to_control(model), np.zeros(3), np.zeros(2))
    np.testing.assert_allclose(linear.A, model.coefficients_[:3].T, atol=1e-6)
    np.testing.assert_allclose(linear.B, model.coefficients_[3:].T, atol=1e-6)
    assert linear.dt == car_data.system.dt
