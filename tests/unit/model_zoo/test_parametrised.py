"""The paper's parametrised car against its own equation."""

import dataclasses

import numpy as np
import pytest

from model_zoo.car.parametrised import PARAMETERS
from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.models.base import make_model
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System

DT = 0.05
TRUTH = {
    "thrust_forward": 4.0,
    "thrust_backward": 2.4,
    "turn_left": 6.0,
    "turn_right": 3.6,
    "drag_linear": 1.0,
    "drag_viscous": 0.4,
    "yaw_drag_linear": 2.0,
    "yaw_drag_viscous": 0.3,
    "min_speed": 0.05,
    "min_yaw_rate": 0.1,
    "max_speed": 2.5,
    "max_yaw_rate": 4.0,
}


def drive(model, controls, start=(0.0, 0.0, 0.0)):
    """The states (H + 1, 3) of one run."""
    states = model.simulate(np.array([[start]]), np.zeros((1, 0, 2)), np.asarray(controls, dtype=float)[None])[0]
    return np.concatenate([[start], states])


def parametrised(system, **changed):
    """Return the car with the parameters `TRUTH`, some of them ``changed``, as if it had been fitted."""
    model = make_model("parametrised")
    model.system_, model.parameters_ = system, np.array(list({**TRUTH, **changed}.values()))
    return model


@pytest.fixture(scope="module")
def known_car(car):
    return parametrised(car)


@pytest.fixture(scope="module")
def driven(known_car, car):
    """Three half minutes of the known car, commands held for 0.1 to 1 s."""
    rng = np.random.default_rng(6)
    episodes = []
    for _ in range(3):
        commands = rng.integers(-1, 2, (600, 2)).repeat(rng.integers(2, 21, 600), axis=0)[:600]
        episodes.append((drive(known_car, commands), commands))
    return Dataset.from_arrays(car, [x for x, _ in episodes], [u for _, u in episodes])


@pytest.fixture(scope="module")
def fitted(driven):
    train, _ = driven.split(["episode-2"])
    return make_model("parametrised", generations=150).fit(train, rng=np.random.default_rng(2))


def value(model, name):
    return float(model.parameters_[[n for n, _ in PARAMETERS].index(name)])


def test_it_has_the_twelve_parameters_of_the_paper():
    assert [name for name, _ in PARAMETERS] == list(TRUTH)
    assert len(PARAMETERS) == 12


@pytest.mark.parametrize(
    "state, control, acceleration",
    [
        ((0.0, 0.0, 0.0), (1, 0), (4.0, 0.0)),  # thrust forward
        ((0.0, 0.0, 0.0), (-1, 0), (-2.4, 0.0)),  # thrust backward
        ((1.0, 0.0, 0.0), (0, 0), (-1.4, 0.0)),  # 1.0 u + 0.4 u^2
        ((-1.0, 0.0, 0.0), (0, 0), (1.4, 0.0)),  # drag always brakes
        ((2.0, 0.0, 0.0), (0, 1), (-3.6, 12.0)),  # 6 u to the left
        ((2.0, 0.0, 0.0), (0, -1), (-3.6, -7.2)),  # 3.6 u to the right
        ((-1.0, 0.0, 0.0), (0, 1), (1.4, -6.0)),  # backwards the nose swings the other way
        ((0.0, 0.0, 2.0), (0, 0), (0.0, -5.2)),  # 2 r + 0.3 r^2
        ((0.0, 0.0, -2.0), (0, 0), (0.0, 5.2)),
        ((1.0, 0.3, 1.0), (0.5, -0.5), (0.6, -1.8 - 2.3)),  # a proportional command is a share
    ],
)
def test_a_step_is_equation_1(known_car, state, control, acceleration):
    after = known_car.step(np.array([state]), np.array([control], dtype=float))
    expected = (state[0] + DT * acceleration[0], 0.0, state[2] + DT * acceleration[1])
    np.testing.assert_allclose(after[0], expected, rtol=1e-12)


def test_a_car_at_rest_without_a_command_stays_at_rest(known_car, fitted):
    for model in (known_car, fitted):
        np.testing.assert_array_equal(drive(model, np.zeros((50, 2))), 0.0)


def test_static_friction_stops_a_slow_car_but_not_a_driven_one(known_car):
    coasting = drive(known_car, np.zeros((100, 2)), start=(0.5, 0.0, 1.0))
    assert (coasting[-1] == 0.0).all()
    moving = coasting[:, 0] != 0
    assert np.abs(coasting[moving, 0]).min() >= TRUTH["min_speed"]
    assert np.abs(coasting[coasting[:, 2] != 0, 2]).min() >= TRUTH["min_yaw_rate"]
    held = known_car.step(np.array([[0.04, 0.0, 0.09], [0.04, 0.0, 0.09]]), np.array([[0.0, 0.0], [0.001, 0.001]]))
    assert (held[0] == 0.0).all()
    assert (held[1, [0, 2]] > 0.0).all()


def test_a_car_cannot_turn_on_the_spot(known_car, fitted):
    for model in (known_car, fitted):
        for steer in (-1.0, 1.0):
            np.testing.assert_array_equal(drive(model, np.tile([0.0, steer], (50, 1))), 0.0)


def test_lateral_speed_is_neglected(known_car):
    states = drive(known_car, np.tile([1.0, 1.0], (20, 1)), start=(1.0, 0.7, 0.0))
    assert (states[1:, 1] == 0.0).all()


def test_speeds_never_exceed_the_maxima(known_car, rng):
    """From states of all sizes up to a thousand, under any command."""
    state = rng.choice([-1.0, 1.0], (5000, 3)) * 10.0 ** rng.uniform(-4.0, 3.0, (5000, 3))
    after = known_car.step(state, rng.uniform(-1.0, 1.0, (5000, 2)))
    assert np.abs(after[:, 0]).max() <= TRUTH["max_speed"]
    assert np.abs(after[:, 2]).max() <= TRUTH["max_yaw_rate"]


def test_the_maxima_are_reached_when_thrust_would_carry_further(known_car):
    fast = drive(parametrised(known_car.system, max_speed=0.9, max_yaw_rate=0.5), np.tile([1.0, 1.0], (100, 1)))
    np.testing.assert_array_equal(fast[-1], [0.9, 0.0, 0.5])


def test_a_fitted_car_drives_like_the_one_it_was_fitted_to(fitted, driven):
    """Two seconds ahead on an episode that was held back, with a tenth of the error of persistence."""
    _, test = driven.split(["episode-2"])
    windows = test.windows(40, stride=10)
    simulated = fitted.simulate(windows.past_states, windows.past_controls, windows.controls)
    for channel in (0, 2):
        error = simulated[..., channel] - windows.states[..., channel]
        standing = windows.start_states[:, None, channel] - windows.states[..., channel]
        assert np.sqrt(np.mean(error**2)) < 0.1 * np.sqrt(np.mean(standing**2))


def test_the_asymmetry_of_left_and_right_and_of_forward_and_backward_is_found(fitted):
    for strong, weak in (("thrust_forward", "thrust_backward"), ("turn_left", "turn_right")):
        assert value(fitted, strong) / value(fitted, weak) == pytest.approx(TRUTH[strong] / TRUTH[weak], rel=0.1)
    for name in ("thrust_forward", "thrust_backward", "turn_left", "turn_right"):
        assert value(fitted, name) == pytest.approx(TRUTH[name], rel=0.15)
    assert (fitted.parameters_ >= 0.0).all()


def test_roles_may_have_other_names_and_places(known_car):
    system = System(
        (Channel("omega"), Channel("vx")),
        (Channel("wheel", low=-1.0, high=1.0), Channel("gas", low=-1.0, high=1.0)),
        DT,
        PlanarBody(forward="vx", lateral=None, yaw_rate="omega"),
    )
    other = make_model("parametrised", drive="gas", steer="wheel")
    other.system_ = system
    other.parameters_ = known_car.parameters_
    controls = np.random.default_rng(0).uniform(-1, 1, (50, 2))
    plain = drive(known_car, controls)
    mixed = other.simulate(np.zeros((1, 1, 2)), np.zeros((1, 0, 2)), controls[None, :, ::-1])[0]
    np.testing.assert_array_equal(mixed, plain[1:, [2, 0]])


def test_a_system_without_the_roles_is_refused(car):
    model = make_model("parametrised", drive="throttle")
    dataset = Dataset.from_arrays(car, [np.zeros((30, 3))], [np.zeros((29, 2))])
    with pytest.raises(
        IncompatibleSystem, match="role drive: expected 'throttle', got drive, steer; name yours with drive="
    ):
        model.fit(dataset, rng=0)
    still = dataclasses.replace(car, motion=None)
    with pytest.raises(IncompatibleSystem, match="describes a planar body, but the system has no motion"):
        make_model("parametrised").check_system(still)


def test_with_control_lags_the_command_of_that_many_samples_ago_drives(known_car, car):
    late = parametrised(car).set_params(control_lags=2)
    controls = np.random.default_rng(5).choice([-1.0, 0.0, 1.0], (1, 30, 2))
    start, none = np.array([[[0.5, 0.0, 0.3]]]), np.zeros((1, 0, 2))
    past = np.concatenate([start, start, start], axis=1)
    prompt = known_car.simulate(start, none, controls[:, :28])
    delayed = late.simulate(past, controls[:, :2], controls[:, 2:])
    np.testing.assert_array_equal(delayed, prompt)
