"""Periodic states: differences go the shortest way round, however far an angle has turned."""

import numpy as np
import pytest

from sysid_evo.angles import wrap
from sysid_evo.data import Dataset
from sysid_evo.data.preparation import RawLog, prepare
from sysid_evo.errors import InvalidSystem
from sysid_evo.models import DynamicsModel
from sysid_evo.system import Channel, System
from tests.fixtures.systems import SWING

TURN = 2.0 * np.pi


class Spinning(DynamicsModel):
    """d angle / dt = rate, known exactly; there is nothing to learn."""

    def fit(self, dataset, **keywords):
        return self

    def acceleration(self, carry, control):
        return np.stack([carry[:, 1], np.zeros(len(carry))], axis=1)


def spin(steps=200, rate=3.0):
    """The states of a pendulum that turns over and over, its angle within (-pi, pi]."""
    angle = 3.0 + rate * SWING.dt * np.arange(steps + 1)
    return np.stack([wrap(angle), np.full(steps + 1, rate)], axis=1)


@pytest.mark.parametrize("turns", [-1000, -1, 0, 3, 1000])
def test_an_angle_is_wrapped_into_half_a_turn_either_way(turns):
    angles = np.array([-3.0, -0.1, 0.0, 1.0, 3.1])
    np.testing.assert_allclose(wrap(angles + turns * TURN), angles, atol=1e-9)
    assert wrap(np.array([np.pi, -np.pi])).tolist() == [np.pi, np.pi]


def test_a_difference_across_pi_is_the_short_one():
    before, after = np.array([3.1, 1.0]), np.array([-3.1, 1.5])
    np.testing.assert_allclose(SWING.difference(after, before), [TURN - 6.2, 0.5])
    np.testing.assert_allclose(SWING.acceleration(before, after), [(TURN - 6.2) / 0.05, 10.0])
    np.testing.assert_allclose(SWING.unwrap_towards(after, before), [TURN - 3.1, 1.5])


def test_integration_inverts_differentiation_up_to_whole_turns():
    states = spin()
    again = SWING.integrate(states[:-1], SWING.acceleration(states[:-1], states[1:]))
    np.testing.assert_allclose(SWING.wrap(again), states[1:], atol=1e-12)


def test_other_channels_and_other_systems_are_left_alone(car, rng):
    a, b = 10.0 * rng.standard_normal((2, 5, 3))
    np.testing.assert_array_equal(car.difference(a, b), a - b)
    np.testing.assert_array_equal(car.wrap(a), a)
    np.testing.assert_array_equal(car.regressors(a), a)
    assert car.regressor_names == car.state_names


def test_a_data_set_runs_on_across_pi():
    data = Dataset.from_arrays(SWING, [spin()], [np.zeros((200, 1))])
    np.testing.assert_allclose(np.diff(data.episodes[0].states[:, 0]), 0.15, atol=1e-12)
    assert data.episodes[0].states[-1, 0] > 20.0


def test_a_logged_angle_is_interpolated_the_short_way():
    time, angle = np.arange(0.0, 4.0, 0.005), 3.0 + 2.0 * np.arange(0.0, 4.0, 0.005)
    time[1::2] += 0.001  # an uneven clock, so that there is something to interpolate
    angle = 3.0 + 2.0 * time
    extra = {"angle": wrap(angle), "rate": np.full(len(time), 2.0)}
    log = RawLog("log", time, np.empty((len(time), 0)), np.zeros((len(time), 1)), extra)
    (episode,) = prepare(log, SWING).episodes
    np.testing.assert_allclose(np.diff(episode.states[:, 0]), 2.0 * SWING.dt, atol=1e-3)


def test_a_simulation_turns_over_and_is_never_clipped():
    data = Dataset.from_arrays(SWING, [spin(20)], [np.zeros((20, 1))])
    model = Spinning().fit(data, rng=np.random.default_rng(0))
    assert model.state_bounds is not None
    assert np.isinf(model.state_bounds[:, 0]).all()
    run = model.simulate(np.array([[[3.0, 3.0]]]), np.zeros((1, 0, 1)), np.zeros((1, 400, 1)))
    np.testing.assert_allclose(run[0, :, 0], 3.0 + 0.15 * np.arange(1, 401), atol=1e-9)


def test_regressors_are_the_same_after_a_whole_turn():
    states = np.array([[0.3, 2.0], [0.3 + TURN, 2.0], [np.pi / 2, 0.0]])
    found = SWING.regressors(states)
    assert SWING.regressor_names == ("sin angle", "cos angle", "rate")
    np.testing.assert_allclose(found[0], found[1], atol=1e-12)
    np.testing.assert_allclose(found[2], [1.0, 0.0, 0.0], atol=1e-12)


def test_a_period_is_stored_and_older_systems_without_one_are_read():
    assert System.from_dict(SWING.to_dict()) == SWING
    old = SWING.to_dict()
    assert [channel.get("period") for channel in (*old["states"], *old["controls"])] == [TURN, None, None]
    assert "period" not in old["controls"][0]
    del old["states"][0]["period"]
    assert not System.from_dict(old).periods


def test_a_period_that_makes_no_sense_is_refused():
    for period in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(InvalidSystem, match="channel 'a': expected a finite period > 0"):
            Channel("a", period=period)
    with pytest.raises(InvalidSystem, match="channel 'a': expected a period or limits, got both"):
        Channel("a", low=-1.0, period=TURN)
    with pytest.raises(InvalidSystem, match="control 'u': expected no period, only states have one"):
        System((Channel("x"),), (Channel("u", period=TURN),), 0.1)
