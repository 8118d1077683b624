"""Channels and systems: switches, scales, limits, JSON."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.self_test import system_finding
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidSystem, ShapeError
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System

LOW, HIGH = -1.0, 1.0
STATE = (Channel("x"),)


def system_of(*controls):
    return System(STATE, controls, dt=0.05)


@pytest.mark.parametrize(
    ("control", "raw", "expected"),
    [
        (Channel("gate", levels=(2.0, 5.0), neutral=2.0), [-0.01, 0.01], [2, 5]),
        (
            Channel("drive", levels=(-1.0, 0.0, 1.0)),
            [-1.0, np.nextafter(-0.3, -1.0), -0.3, -0.1, 0.0, 0.3, np.nextafter(0.3, 1.0), 1.0],
            [-1, -1, 0, 0, 0, 0, 1, 1],
        ),
        (
            Channel("gear", levels=(-2.0, -1.0, 0.0, 1.0, 2.0)),
            [-0.55, -0.53, -0.19, -0.17, 0.17, 0.19, 0.53, 0.55],
            [-2, -1, -1, 0, 0, 1, 1, 2],
        ),
        (Channel("throttle", low=0.0, high=0.8), [-1.0, 0.0, 0.5, 1.0, 7.0], [0.0, 0.4, 0.6, 0.8, 0.8]),
        (Channel("steer", low=-0.4, high=0.4), [-1.0, 0.0, 0.5, 1.0, -7.0], [-0.4, 0.0, 0.2, 0.4, -0.4]),
    ],
    ids=lambda given: getattr(given, "name", None),
)
def test_a_switch_has_equal_parts_drawn_together_and_a_continuous_control_saturates(control, raw, expected):
    """Two levels switch at 0, three at -0.3 and 0.3; whatever other controls there are."""
    raw = np.array(raw)[:, None]
    kept = raw.copy()
    np.testing.assert_allclose(system_of(control).actuate(raw)[:, 0], expected, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(raw, kept)
    beside = system_of(Channel("other", levels=(0.0, 1.0)), control).actuate(np.stack([raw, raw], axis=-1))
    assert beside.shape == (len(raw), 1, 2)
    np.testing.assert_allclose(beside[:, 0, 1], expected, rtol=0, atol=1e-15)


@given(raw=st.floats(-2.0, 2.0), levels=st.integers(1, 4).map(lambda half: 2 * half + 1))
@settings(derandomize=True, deadline=None, database=None)
def test_an_odd_switch_treats_both_signs_alike(raw, levels):
    half = levels // 2
    system = system_of(Channel("gear", levels=tuple(np.arange(-half, half + 1.0))))
    assert system.actuate(np.array([-raw])) == -system.actuate(np.array([raw]))


def test_what_cannot_be_actuated_is_refused(car):
    with pytest.raises(InvalidSystem, match=r"'force' has no finite limits.*give low and high, or levels"):
        system_of(Channel("force", "N")).actuate(np.zeros((1, 1)))
    with pytest.raises(ShapeError, match=r"raw: expected 2 values on the last axis, got shape \(4, 3\)"):
        car.actuate(np.zeros((4, 3)))


def test_a_system_survives_json_with_absent_limits(car):
    mixed = System(
        states=(Channel("a", "m", low=-np.inf, high=3.0), Channel("b", low=0.0, neutral=1.0), Channel("c")),
        controls=(Channel("d", levels=(-1, 0, 1)), Channel("e", "N", -2.0, 2.0, neutral=0.5)),
        dt=0.02,
        motion=PlanarBody(forward="a", lateral=None, yaw_rate="c"),
        name="mixed",
    )
    for system in (car, mixed):
        text = json.dumps(system.to_dict(), allow_nan=False)
        back = System.from_dict(json.loads(text))
        assert back == system
        assert back.name == system.name
        assert back.to_dict() == system.to_dict()


def test_limits_and_neutral_values_follow_from_what_is_given():
    """Levels are limits; neutral is 0 or the limit nearest to it."""
    gear = Channel("gear", levels=(-2, 0, 3))
    assert (gear.low, gear.high, gear.bounded) == (-2.0, 3.0, True)
    assert not Channel("x", low=0.0).bounded
    neutral = [Channel("x", low=low, high=high).neutral for low, high in ((-1, 1), (6, 8.4), (-5, -2), (-np.inf, 3))]
    assert neutral == [0.0, 6.0, -2.0, 0.0]
    assert Channel("gear", levels=(2.0, 5.0)).neutral == 2.0
    assert Channel("x", low=6.0, high=8.0, neutral=7.0).neutral == 7.0
    system = System((Channel("a", neutral=1.0), Channel("b", neutral=-2.0)), (Channel("c", neutral=0.5),), dt=0.1)
    assert (system.neutral_state.tolist(), system.neutral_control.tolist()) == ([1.0, -2.0], [0.5])
    assert (system.nx, system.nu, system.n_pose) == (2, 1, 0)


def test_names_stand_for_channels_without_unit_and_limits():
    named = System(states=["theta", "theta_dot"], controls="torque", dt=0.02)
    assert named == System((Channel("theta"), Channel("theta_dot")), (Channel("torque"),), 0.02)
    with pytest.raises(InvalidSystem, match=r"expected Channel\(...\) or names as controls, got float"):
        System(states=("x",), controls=(1.0,), dt=0.1)
    with pytest.raises(InvalidSystem, match=r"expected dt > 0 s, got '0.1'"):
        System(states=("x",), controls=(), dt="0.1")  # type: ignore[arg-type]  # as from a file


def test_another_dt_changes_nothing_else(car):
    finer = car.with_dt(0.005)
    assert finer.dt == 0.005
    assert finer.with_dt(car.dt) == car
    assert finer.name == car.name


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"name": ""}, "expected a name, got an empty string"),
        ({"name": "a", "levels": (1.0,)}, r"'a': expected two or more rising levels, got \(1.0,\)"),
        ({"name": "a", "levels": (0.0, 0.0, 1.0)}, "'a': expected two or more rising levels"),
        ({"name": "a", "levels": (-1.0, np.nan, 1.0)}, "'a': expected two or more rising levels"),
        ({"name": "a", "levels": (-1.0, 1.0), "low": -0.5}, r"'a': levels \(-1.0, 1.0\) lie outside \[-0.5, 1.0\]"),
        ({"name": "a", "low": 1.0, "high": 1.0}, r"'a': expected low < high, got \[1.0, 1.0\]"),
        ({"name": "a", "low": np.nan}, "'a': expected low < high"),
        ({"name": "a", "low": 1.0, "neutral": 0.0}, r"'a': expected a neutral value within \[1.0, inf\], got 0.0"),
        ({"name": "a", "neutral": np.inf}, "'a': expected a neutral value within .*, got inf"),
    ],
)
def test_a_channel_that_contradicts_itself_is_refused(arguments, message):
    with pytest.raises(InvalidSystem, match=message):
        Channel(**arguments)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"states": ()}, "expected at least one state channel, got none"),
        ({"controls": (Channel("x"),)}, "channel names must differ, repeated: x"),
        ({"dt": 0.0}, "expected dt > 0 s, got 0.0"),
        ({"dt": np.nan}, "expected dt > 0 s, got nan"),
        ({"dt": np.inf}, "expected dt > 0 s, got inf"),
        (
            {"motion": PlanarBody(forward="x", yaw_rate="x")},
            "role 'lateral' names the channel 'lateral_speed', but the states are x",
        ),
    ],
)
def test_a_system_that_contradicts_itself_is_refused(arguments, message):
    with pytest.raises(InvalidSystem, match=message):
        System(**{"states": STATE, "controls": (Channel("u"),), "dt": 0.05, **arguments})


def test_systems_differ_in_words_where_it_matters_to_a_controller(car):
    assert car.differences(car.with_dt(car.dt)) == ()
    assert car.differences(replace(car, name="another name")) == ()
    assert car.differences(car.with_dt(0.1)) == ("20 Hz against 10 Hz",)
    swapped = replace(car, states=(car.states[2], car.states[1], car.states[0]))
    assert car.differences(swapped) == (
        "states forward_speed (m/s), lateral_speed (m/s), yaw_rate (rad/s) against "
        "yaw_rate (rad/s), lateral_speed (m/s), forward_speed (m/s)",
    )
    wider = replace(car, states=(replace(car.states[0], low=-1.0, high=1.0), *car.states[1:]))
    assert car.differences(wider) == ()
    smooth = replace(car, controls=(Channel("drive", low=-1.0, high=1.0), car.controls[1]))
    assert car.differences(smooth) == ("legal values of drive: [-1.0, 0.0, 1.0] against [-1, 1]",)
    still = replace(car, motion=None)
    roles = "forward = forward_speed, lateral = lateral_speed, yaw_rate = yaw_rate"
    assert car.differences(still) == (f"motion planar_body ({roles}) against none",)
    angle = System([Channel("theta", "rad", period=6.0)], [], dt=1.0)
    assert angle.differences(System([Channel("theta", "rad")], [], dt=1.0)) == (
        "states theta (rad, period 6) against theta (rad)",
    )


def test_a_recording_shows_which_limits_are_none():
    """Gymnasium declares a height of at most 2.5 for a lander that flies to 18."""
    lander = System((Channel("height", low=-2.5, high=2.5), Channel("lamp", low=0.0, high=1.0)), [], dt=0.02)
    inside = np.array([[0.0, 0.0], [2.52, 1.0]])  # up to noise
    assert lander.within(inside) is lander
    seen = lander.within(np.array([[0.0, 0.0], [18.0, 1.0]]))
    np.testing.assert_array_equal(seen.limits, [[-2.5, 0.0], [np.inf, 1.0]])
    below = lander.within(np.array([[0.0, -1.0], [0.0, 1.0]]))
    np.testing.assert_array_equal(below.limits, [[-2.5, -np.inf], [2.5, 1.0]])


def test_a_description_is_for_readers_alone():
    """It is stored, and changes neither what a channel is nor the fingerprint of data."""
    plain, described = (Channel("angle", "rad", description=text) for text in ("", "0 hanging"))
    assert plain == described
    assert Channel.from_dict(described.to_dict()).description == "0 hanging"
    states = np.arange(6.0)
    prints = {Dataset.from_arrays(System([angle], [], 0.1), states).fingerprint for angle in (plain, described)}
    assert len(prints) == 1
    assert system_finding(System(described, [], 0.1)).sentence.startswith("States: angle (rad; 0 hanging).")
