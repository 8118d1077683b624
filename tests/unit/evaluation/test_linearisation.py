"""Linearised models against linear systems whose poles and responses are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from evaluation.linearisation import MOST, LinearResponse, OperatingPoint, least_squares, linearised
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidData
from sysid_evo.models.base import make_model
from sysid_evo.testing.examples import pendulum
from tests.fixtures.known_models import DECAY, GAIN, Broken, Exploding, Known, Remembering, Undefined, fitted, recording
from tests.fixtures.systems import DRIVEN, SMALL_SYSTEMS


@pytest.fixture(scope="module")
def point():
    return OperatingPoint.of(recording())


class Curved(Known):
    """Has a drag with the square of the speed."""

    def next_state(self, carry, control):
        after = super().next_state(carry, control)
        after[:, 0] -= 0.1 * carry[:, 0] * np.abs(carry[:, 0])
        return after


class Stepped(Known):
    """Knows its state in steps of a tenth only."""

    def next_state(self, carry, control):
        return super().next_state(np.round(carry, 1), control)


class Switched(Known):
    """Knows full commands only."""

    def next_state(self, carry, control):
        return super().next_state(carry, np.where(np.abs(control) > 0.4, np.sign(control), 0.0))


@pytest.mark.parametrize("family", [Known, Remembering])
def test_a_linear_model_has_its_own_matrices_and_memory_adds_no_pole(family, point):
    found = linearised(fitted(family()), point)
    np.testing.assert_allclose(found.a[:3, :3], np.diag(DECAY), atol=1e-9)
    np.testing.assert_allclose(found.b[:3], GAIN.T, atol=1e-9)
    np.testing.assert_allclose(found.poles, sorted(DECAY, reverse=True), atol=1e-9)


def test_the_operating_point_is_the_mean_of_what_moves():
    data = recording(standstill=100)
    states = np.concatenate([one.states[:-1][moving[:-1]] for one, moving in zip(data, data.moving, strict=True)])
    assert len(states) < 0.9 * sum(len(one.controls) for one in data)
    np.testing.assert_allclose(OperatingPoint.of(data).state, states.mean(axis=0))
    at_rest = Dataset.from_arrays(data.system, [np.zeros((50, 3))], [np.zeros((49, 2))])
    np.testing.assert_array_equal(OperatingPoint.of(at_rest).state, 0.0)


def test_a_curve_is_linearised_at_the_operating_point(point):
    speed = 0.7
    there = linearised(fitted(Curved()), replace(point, state=np.array([speed, 0.0, 0.0])))
    assert there.a[0, 0] == pytest.approx(DECAY[0] - 0.2 * speed, abs=1e-3)


def test_a_pole_has_the_frequency_and_the_damping_of_the_oscillation_that_was_sampled():
    frequency, damping, dt = 3.0, 0.2, 0.05
    oscillator = np.array([[0.0, 1.0], [-(frequency**2), -2.0 * damping * frequency]])
    found = LinearResponse(expm(oscillator * dt), np.zeros((2, 1)), 2, dt)
    s = found.continuous(*found.poles)
    assert abs(s) == pytest.approx(frequency)
    assert -s.real / abs(s) == pytest.approx(damping)


def test_memory_of_controls_adds_no_pole():
    data = DRIVEN.recording()
    found = linearised(make_model("linear", control_lags=1).fit(data, rng=0), OperatingPoint.of(data))
    assert found.a.shape == (3, 3)
    (z,) = found.poles
    wanted = np.linalg.eigvals(DRIVEN.a)[0]
    assert z == pytest.approx(complex(wanted.real, abs(wanted.imag)), abs=1e-6)


@pytest.mark.parametrize("name", SMALL_SYSTEMS)
def test_small_systems_are_linearised_too(name):
    system = SMALL_SYSTEMS[name]
    point = OperatingPoint.of(system.recording())
    found = linearised(make_model("linear").fit(system.recording(), rng=0), point)
    np.testing.assert_allclose(found.a, system.a, atol=1e-6)
    assert least_squares(point).b.shape == system.b.shape


class Rotor(Known):
    """An angle that turns with its rate, given within half a turn of zero."""

    def next_state(self, carry, control):
        angle = carry[:, 0] + 0.02 * carry[:, 1]
        return np.stack([(angle + np.pi) % (2.0 * np.pi) - np.pi, 0.9 * carry[:, 1] + control[:, 0]], axis=1)


def test_an_angle_is_not_torn_where_it_wraps():
    rng = np.random.default_rng(0)
    data = Dataset.from_arrays(pendulum(), [rng.normal(size=(100, 2))], [rng.uniform(-1.0, 1.0, (99, 1))])
    half_turn = replace(OperatingPoint.of(data), state=np.array([np.pi, 0.0]))
    found = linearised(fitted(Rotor(), data), half_turn)
    np.testing.assert_allclose(found.a, [[1.0, 0.02], [0.0, 0.9]], atol=1e-9)


def test_responses_are_those_of_the_system():
    space = LinearResponse(DRIVEN.a, DRIVEN.b, 2, 0.1)
    state, steps = np.zeros(2), [np.zeros(2)]
    for _ in range(20):
        state = DRIVEN.a @ state + DRIVEN.b[:, 0]
        steps.append(state)
    np.testing.assert_allclose(space.to_step(20)[..., 0], steps)
    w = np.array([0.5, 2.0])
    control = pytest.importorskip("control")
    wanted = control.frequency_response(control.ss(DRIVEN.a, DRIVEN.b, np.eye(2), np.zeros((2, 1)), 0.1), w).frdata
    np.testing.assert_allclose(space.to_frequency(w)[:, :, 0].T, wanted[:, 0])


def test_least_squares_finds_a_linear_system(point):
    found = least_squares(point)
    np.testing.assert_allclose(found.a, np.diag(DECAY), atol=1e-9)
    np.testing.assert_allclose(found.b, GAIN.T, atol=1e-9)
    assert least_squares(replace(point, steps=point.steps[:17])) is None


@pytest.mark.parametrize(
    ("family", "reason"),
    [
        pytest.param(Stepped, "not smooth", id="steps of the state"),
        pytest.param(Switched, "small changes of drive have no effect", id="steps of the control"),
        pytest.param(Undefined, "not a number", id="no number"),
        pytest.param(Broken, "the network is not there", id="it breaks"),
    ],
)
def test_a_model_without_slopes_is_not_linearised(family, reason, point):
    with pytest.raises((InvalidData, RuntimeError), match=reason):
        linearised(fitted(family()), point)


class Longer(Remembering):
    """Asks for more samples than are linearised."""

    state_lags = MOST


def test_a_long_memory_is_not_linearised(point):
    with pytest.raises(InvalidData, match=f"more than {MOST}"):
        linearised(fitted(Longer()), point)


def test_a_model_that_grows_is_linearised(point):
    assert linearised(fitted(Exploding()), point).poles == pytest.approx((2.0, 2.0, 2.0))
