"""The horizons at which `auto` compares candidates."""

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.system import Channel, System
from sysid_evo.validation.folds import make_folds
from sysid_evo.validation.simulation_error import (
    MOST_STEPS,
    held_out_tests,
    long_test,
    response_steps,
    selection_horizons,
)


def recorded(steps, response, *, scale=1.0):
    """Return episodes of these ``steps`` of a lag of first order under white noise, and of a much faster one."""
    system, rng = System(("slow", "fast"), ("u",), dt=0.1), np.random.default_rng(0)
    states = []
    for count in steps:
        x, drawn = np.zeros((count + 1, 2)), rng.standard_normal((count, 2))
        for k in range(count):
            x[k + 1] = np.exp([-1.0 / response, -1.0]) * x[k] + drawn[k]
        states.append(scale * x + 5.0)
    return Dataset.from_arrays(system, states, [np.zeros((count, 1)) for count in steps])


@pytest.mark.parametrize("scale", [1.0, 1e-6])
def test_the_response_is_the_time_constant_of_the_slowest_state(scale):
    assert response_steps(recorded([20_000, 10_000], 40.0, scale=scale)) == pytest.approx(40.0, rel=0.2)


def test_the_response_of_an_angle_does_not_depend_on_its_origin():
    system = System((Channel("angle", "rad", period=2.0 * np.pi),), ("u",), dt=0.1)
    angle = np.cumsum(np.random.default_rng(0).normal(0.0, 0.2, 4001))
    found = []
    for origin in (0.0, 2.0):
        wrapped = (angle + origin + np.pi) % (2.0 * np.pi) - np.pi
        found.append(response_steps(Dataset.from_arrays(system, [wrapped[:, None]], [np.zeros((4000, 1))])))
    assert found[0] == found[1]
    assert found[0] == pytest.approx(2.0 / 0.2**2, rel=0.4), "the time in which a random walk turns by a radian"


def test_without_motion_the_response_is_a_sample():
    assert response_steps(recorded([50], 40.0, scale=0.0)) == 1


@pytest.mark.parametrize(
    ("steps", "response", "expected"),
    [
        ([600, 600, 600], 4.0, [10, 20, 60, 200]),
        ([150, 150, 150], 4.0, [10, 20, 60]),
        ([30, 30, 30], 4.0, [10, 20]),
        ([6, 6, 6], 4.0, [3]),
    ],
)
def test_fast_responses_are_compared_after_few_samples_and_after_a_third_of_the_block(steps, response, expected):
    data = recorded(steps, response)
    assert selection_horizons(data, make_folds(data, 3)) == expected


def test_slow_responses_are_compared_later():
    data = recorded([3000, 3000, 3000], 150.0)
    response = response_steps(data)
    assert response > 100
    expected = [round(0.2 * response), round(0.5 * response), response, 1000]
    assert selection_horizons(data, make_folds(data, 3)) == expected


@pytest.mark.parametrize(("horizon", "windows"), [(60, 800), (2000, MOST_STEPS // 2000)])
def test_long_simulations_start_from_fewer_samples(horizon, windows):
    data = recorded([8000, 8000], 4.0)
    assert [len(test.windows) for test in held_out_tests(make_folds(data, 2), [10, horizon])] == [windows, windows]


def test_long_simulations_go_through_the_whole_data_if_a_recording_is_far_longer_than_the_horizons():
    data = recorded([1000, 300], 4.0)
    test = long_test(data, [10, 60], history=20)
    assert test is not None
    assert (len(test.horizons), test.horizons[0], max(test.horizons)) == (20, 48, 979)
    assert set(test.windows.episode) == {0}
    assert max(long_test(recorded([9000], 4.0), [10, 60], 20).horizons) == 1000
    assert long_test(data, [10, 60, 245], history=20) is None, "4 x 245 > 979"


def test_long_simulations_are_a_tenth_of_those_in_a_fold():
    test = long_test(recorded([20_000], 4.0), [10, 60], 20)
    assert len(test.windows) * max(test.horizons) == MOST_STEPS // 10
