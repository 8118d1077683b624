"""What sparse families see of states and controls, which setting they choose, and the units they print."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from model_zoo.features import Features, powers, quotient
from sysid_evo.data import Dataset
from sysid_evo.engine import kernel_step
from sysid_evo.errors import InvalidArgument
from sysid_evo.models.base import make_model
from sysid_evo.system import Channel, System
from sysid_evo.validation.held_out import best

PENDULUM = System(
    (Channel("angle", "rad", period=2 * np.pi), Channel("rate", "rad/s")), (Channel("torque", "N m", -3.0, 3.0),), 0.05
)


def swung(seed: int, steps: int = 300) -> Dataset:
    """A pendulum that goes over the top, stepped as its discrete equation says."""
    rng = np.random.default_rng(seed)
    torque = np.repeat(rng.uniform(-3.0, 3.0, (3, steps // 10, 1)), 10, axis=1)
    states = np.zeros((3, steps + 1, 2))
    for k in range(steps):
        angle, rate = states[:, k].T
        after = rate + 0.05 * (-9.0 * np.sin(angle) - 0.2 * rate + 4.0 * torque[:, k, 0])
        states[:, k + 1] = np.stack([angle + 0.05 * rate, after], axis=1)
    return Dataset.from_arrays(PENDULUM, list(states), list(torque))


def test_a_periodic_state_stands_as_sine_and_cosine_with_its_lags() -> None:
    features = Features(PENDULUM, (1, 1))
    carry, control = np.array([[0.5, 2.0, 0.25, 3.0, 7.0]]), np.array([[8.0]])
    expected = [np.sin(0.5), np.cos(0.5), 2.0, np.sin(0.25), np.cos(0.25), 3.0, 7.0, 8.0]
    np.testing.assert_allclose(features(carry, control)[0], expected)
    assert features.names[3:5] == ["sin angle[-1]", "cos angle[-1]"]
    assert features.units == ["", "", "rad/s", "", "", "rad/s", "N m", "N m"]
    assert not features.plain


def test_functions_of_single_channels_join_the_features() -> None:
    system = System((Channel("speed", "m/s"),), (Channel("drive"),), 0.1)
    features = Features(system, (0, 1), ("abs(speed)", "tanh(drive)"))
    found = features(np.array([[-2.0, 0.5]]), np.array([[1.0]]))
    np.testing.assert_allclose(found[0], [-2.0, 0.5, 1.0, 2.0, np.tanh(1.0)])
    assert features.names[-2:] == ["abs(speed)", "tanh(drive)"]
    assert features.units[-2:] == ["m/s", ""]
    for wrong in ("cube(speed)", "abs(height)", "speed"):
        with pytest.raises(InvalidArgument, match=r"expected NAME\(CHANNEL\) with one of abs, .*speed, drive, got"):
            make_model("sindy", functions=[wrong]).check_system(system)


def test_a_pendulum_is_recovered_over_the_top() -> None:
    """Sine and cosine of the angle are in the library, and a free run goes round as the pendulum does."""
    data = swung(1)
    assert max(np.abs(e.states[:, 0]).max() for e in data) > np.pi
    model = make_model("sindy_discrete", degree=1, threshold=1e-4, ridge=0.0, state_lags=0, control_lags=0)
    model.fit(data)
    assert model.score(data) > -1e-6
    assert "sin angle" in model.equations()[1]
    assert model.equations()[0].startswith("angle[+1] - angle = 0.05 [s] rate")
    turn = np.array([2 * np.pi, 0.0])
    carry, control = data.episodes[0].states[:-1], data.episodes[0].controls
    np.testing.assert_allclose(model.step(carry + turn, control), model.step(carry, control) + turn)


QUICK: dict[str, dict[str, Any]] = {
    "backprop27": {"epochs": 60},
    "evolved3": {"generations": 8},
    "gaussian_process": {"inducing": 20},
    "k_neighbours": {"neighbours": 8},
    "mlp_ensemble": {"members": 2, "hidden": [12], "one_step_updates": 60, "updates": 5},
    "narx": {"terms": 6},
    "nearest_neighbour": {},
    "neural_ode_history": {"hidden": [12], "one_step_updates": 100, "updates": 10},
    "sindy": {"degree": 2},
    "sindy_discrete": {"degree": 2},
}


@pytest.mark.parametrize("family", QUICK)
def test_a_full_turn_of_a_periodic_state_changes_nothing(family: str) -> None:
    """Also for lags: every family that compares or multiplies states sees sine and cosine."""
    data = swung(1, steps=120)
    model = make_model(family, **QUICK[family], state_lags=1, control_lags=1).fit(data)
    steps = data.transitions(state_lags=1, control_lags=1)
    turn = np.array([2 * np.pi, 0.0, 2 * np.pi, 0.0, 0.0])
    expected = model.step(steps.carry, steps.control)
    np.testing.assert_allclose(model.step(steps.carry + turn, steps.control), expected + turn, atol=1e-7)
    assert model.score(data) > -0.8
    kernel = model.kernel()
    assert kernel is not None
    compiled = kernel_step(kernel, steps.carry, steps.control, precision="float64")
    np.testing.assert_allclose(compiled, expected, rtol=1e-6, atol=1e-6)


def test_drag_that_is_no_polynomial_is_found_among_the_functions_asked_for() -> None:
    system = System((Channel("speed", "m/s"),), (Channel("drive", low=-1.0, high=1.0),), 0.02)
    rng = np.random.default_rng(0)
    drive = np.repeat(rng.uniform(-1.0, 1.0, (60, 1)), 10, axis=0)
    speed = [np.zeros(1)]
    for u in drive:
        speed.append(speed[-1] + 0.02 * (3.0 * u - 0.8 * speed[-1] * np.abs(speed[-1])))
    data = Dataset.from_arrays(system, [np.array(speed)], [drive])
    options = {"degree": 2, "threshold": 0.001, "ridge": 0.0, "control_lags": 0, "state_lags": 0}
    with_drag = make_model("sindy_discrete", functions=["abs(speed)"], **options).fit(data)
    assert "0.016 [s/m] speed abs(speed)" in with_drag.equations()[0]
    assert with_drag.score(data) > -1e-6 > make_model("sindy_discrete", **options).fit(data).score(data)


def test_among_settings_as_good_as_each_other_the_smallest_is_chosen() -> None:
    errors, sizes = {"large": 1.0, "small": 1.04, "smaller": 1.2}, {"large": 9, "small": 3, "smaller": 1}
    assert best(list(errors), errors.__getitem__) == "large"
    assert best(list(errors), errors.__getitem__, size=sizes.__getitem__) == "small"
    assert best(["only"], errors.__getitem__) == "only"


@pytest.mark.parametrize(
    ("unit", "divisors", "expected"),
    [
        ("m/s/s", [("m/s", 1)], "1/s"),
        ("m/s^2", [("", 3)], "m/s^2"),
        ("rad/s/s", [("m/s", 1), ("", 1)], "rad/s/m"),
        ("m/s", [("m/s", 1)], ""),
        ("m/s/s", [("m/s", 2)], "1/m"),
        ("rad/s", [("N m", 1)], "rad/s/N/m"),
        ("1/s", [], "1/s"),
        ("m s", [("s", 1)], "m"),
    ],
)
def test_units_are_reduced(unit: str, divisors: list[tuple[str, int]], expected: str) -> None:
    assert quotient(unit, divisors) == expected


def test_what_cannot_be_read_as_a_unit_stays_one_symbol() -> None:
    assert powers("(m/s)^x") == {"(m/s)^x": 1}
