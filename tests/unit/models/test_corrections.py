"""A correction does what its coefficients say, is learned by free runs, and stays within what was recorded."""

from dataclasses import replace

import numpy as np
import pytest

from sysid_evo.models.adaptation.action import ActionCorrection, action_corrections
from sysid_evo.models.adaptation.correction import (
    AdaptationWindows,
    CorrectionTerms,
    acceleration_from_coasting,
    corrections,
    sensitivities,
    simulate_corrections,
)
from sysid_evo.models.adaptation.selection import LearnedCorrection
from sysid_evo.models.base import make_model
from sysid_evo.testing.examples import example_dataset
from sysid_evo.validation.simulation_error import error_of
from tests.fixtures.systems import FloorCar, drive


def test_a_correction_moves_the_next_state_by_its_acceleration_in_the_turning_frame():
    data = drive(FloorCar(), seconds=5.0, seed=0)
    terms = CorrectionTerms.of(data)
    coefficients = np.zeros(terms.shape)
    coefficients[0] = [0.5, -0.3, 0.2]
    state, control = np.array([[1.0, 0.2, 3.0]]), np.array([[0.4, -0.1]])
    after = FloorCar().step(state, control)
    moved = terms.corrected(state, control, after, coefficients)
    acceleration = data.system.acceleration(state, moved) - data.system.acceleration(state, after)
    np.testing.assert_allclose(acceleration, [coefficients[0] * terms.unit])


def test_simulations_find_the_correction_that_was_left_out():
    """Thrust 2 instead of 3 m/s2 is linear in the drive."""
    data = drive(FloorCar(thrust=2.0), seconds=10.0, seed=1, noise=0.0)
    model, terms = FloorCar(), CorrectionTerms.of(data)
    found = list(corrections(model, terms, AdaptationWindows.of(model, data), [1e-2, 1e-4], 10.0))[-1]
    expected = np.zeros(terms.shape)
    expected[4, 0] = -1.0 * terms.scale[3] / terms.unit[0]
    expected[0, 0] = -1.0 * terms.centre[3] / terms.unit[0]
    np.testing.assert_allclose(found, expected, atol=0.01)


def test_of_a_body_that_does_less_of_everything_gains_take_the_error_that_a_linear_correction_leaves():
    model = FloorCar()
    data = drive(Weaker(), seconds=15.0, seed=1, noise=0.0)
    pieces = AdaptationWindows.of(model, data)
    left = []
    for terms in (CorrectionTerms.of(data), CorrectionTerms.of(data, model=model)):
        found = list(corrections(model, terms, pieces, [1e-2, 1e-4], 15.0))[-1]
        left.append(error_of(pieces.errors(simulate_corrections(model, terms, found[None], pieces))[0]))
    assert left[1] < 0.1 * left[0]
    assert terms.names[-3:] == [f"predicted d {name}/dt" for name in data.system.state_names]


class Weaker(FloorCar):
    """Three quarters of the acceleration of the car."""

    def step(self, carry, control, noise=None):
        acceleration = acceleration_from_coasting(self.system, carry, super().step(carry, control))
        return self.system.integrate(carry, 0.75 * acceleration)


@pytest.mark.parametrize("lags", [0, 2])
def test_derivatives_along_a_run_are_those_of_differences(lags):
    data = drive(FloorCar(), seconds=6.0, seed=1)
    model = make_model("narx", degree=2, terms=8, state_lags=lags, control_lags=1).fit(data, rng=0)
    terms, pieces = CorrectionTerms.of(data, products=True, model=model), AdaptationWindows.of(model, data)
    some = np.random.default_rng(0).normal(0.0, 0.01, terms.shape)
    runs, derivatives = sensitivities(model, terms, some, pieces)
    np.testing.assert_allclose(runs, simulate_corrections(model, terms, some[None], pieces)[0])
    for place in (0, 5, 20, terms.size * 3 - 1):
        change = np.zeros(terms.shape)
        change.flat[place] = 1e-5
        more, less = simulate_corrections(model, terms, np.stack([some + change, some - change]), pieces)
        expected = (more - less) / 2e-5
        wrong = np.abs(derivatives[place] - expected)
        assert np.median(wrong) < 1e-5
        assert np.mean(wrong > 1e-3 * (np.abs(expected).max() + 1e-6)) < 0.02, "but where a bound is met"


def test_a_stronger_ridge_leaves_less_of_a_correction():
    data = drive(FloorCar(thrust=2.0), seconds=5.0, seed=1)
    model, terms = FloorCar(), CorrectionTerms.of(data, products=True)
    strong, weak = corrections(model, terms, AdaptationWindows.of(model, data), [100.0, 0.1], 5.0)
    assert 0.0 < np.abs(strong).sum() < 0.5 * np.abs(weak).sum()


def test_outside_the_recording_a_correction_is_what_it_is_at_the_edge():
    terms = CorrectionTerms.of(drive(FloorCar(), seconds=5.0, seed=0), products=True)
    far, control = np.array([[50.0, -50.0, 80.0]]), np.array([[9.0, -9.0]])
    edge = np.array([[terms.high[0], terms.low[1], terms.high[2]]]), np.array([[terms.high[3], terms.low[4]]])
    at_edge = terms(*edge, edge[0])
    np.testing.assert_array_equal(terms(far, control, far), at_edge)
    assert (np.abs(at_edge[0, 1 + terms.n_inputs :]) <= np.maximum(np.abs(terms.least), np.abs(terms.most))).all()


def test_a_body_that_the_model_leaves_at_rest_stays_there():
    terms = CorrectionTerms.of(example_dataset())
    resting, idle, moved = np.zeros((1, 3)), np.zeros((1, 2)), np.full((1, 3), 0.1)
    assert np.array_equal(terms.corrected(resting, idle, resting, np.ones(terms.shape)), resting)
    assert not np.array_equal(terms.corrected(resting, idle + 1.0, moved, np.ones(terms.shape)), moved)


def test_a_simulation_with_a_correction_equals_its_chained_steps():
    data = drive(FloorCar(), seconds=4.0, seed=0)
    model = make_model("linear", state_lags=1, control_lags=2).fit(data, rng=0)
    terms, some = CorrectionTerms.of(data), np.random.default_rng(0).normal(0.0, 0.3, (2, 6, 3))
    pieces = AdaptationWindows.of(model, data)
    runs = simulate_corrections(model, terms, some, pieces)
    for one, run in zip(some, runs, strict=True):
        carry = pieces.carry
        for k in range(pieces.horizon):
            control = pieces.controls[:, k]
            after = model.step(carry, control)
            moved = terms.corrected(carry[:, :3], control, after[:, :3], one)
            carry = np.concatenate([moved, after[:, 3:]], axis=1)
            np.testing.assert_allclose(run[:, k], carry[:, :3])


GAIN, OFFSET = np.array([0.7, 1.2]), np.array([0.0, -0.15])


def commanded_otherwise(data):
    """The same motion under commands of which the car gets gain * u + offset."""
    (episode,) = data
    return data.with_episodes([replace(episode, controls=(episode.controls - OFFSET) / GAIN)])


def test_simulations_find_gain_and_offset_of_the_controls():
    data = commanded_otherwise(drive(FloorCar(), seconds=10.0, seed=1, noise=0.0))
    windows = AdaptationWindows.of(FloorCar(), data)
    found = list(action_corrections(FloorCar(), CorrectionTerms.of(data), windows, [1e-2, 1e-4, 1e-6], 10.0))[-1]
    np.testing.assert_allclose(found.gain, GAIN, atol=2e-3)
    np.testing.assert_allclose(found.offset, OFFSET, atol=2e-3)


def commanded_earlier(data):
    """The same motion, but every command was sent one sample before the car got it."""
    (episode,) = data
    return data.with_episodes([replace(episode, states=episode.states[:-1], controls=episode.controls[1:])])


def test_simulations_find_the_delay_of_the_controls():
    data = commanded_otherwise(commanded_earlier(drive(FloorCar(), seconds=10.0, seed=1, noise=0.0)))
    windows, terms = AdaptationWindows.of(FloorCar(), data), CorrectionTerms.of(data)
    ridges = [1e-2, 1e-4, 1e-6]
    found = list(action_corrections(FloorCar(), terms, windows, ridges, 10.0, delayed=True))[-1]
    assert found.delay == pytest.approx(1.0, abs=2e-3)
    np.testing.assert_allclose(found.gain, GAIN, atol=2e-3)
    np.testing.assert_allclose(found.offset, OFFSET, atol=2e-3)
    assert not any(one.delay for one in action_corrections(FloorCar(), terms, windows, ridges, 10.0))


def test_a_strong_ridge_or_none_leaves_little_of_a_correction_of_the_action():
    data = commanded_otherwise(drive(FloorCar(), seconds=10.0, seed=1, noise=0.0))
    windows, terms = AdaptationWindows.of(FloorCar(), data), CorrectionTerms.of(data)
    (strong,) = action_corrections(FloorCar(), terms, windows, [1e4], 10.0)
    np.testing.assert_allclose(strong.gain, 1.0, atol=0.01)
    assert strong.changes
    assert not ActionCorrection.none(data.system).changes


@pytest.mark.parametrize("delay", [0.0, 0.3])
def test_a_correction_of_the_action_applies_to_the_history_as_well(delay):
    data = commanded_otherwise(drive(FloorCar(), seconds=10.0, seed=1, noise=0.0))
    base = make_model("narx", degree=1, state_lags=1, control_lags=2).fit(
        drive(FloorCar(), seconds=20.0, seed=2), rng=0
    )
    nothing = CorrectionTerms.of(data)
    action = ActionCorrection(GAIN, OFFSET, delay)
    learned = LearnedCorrection(base, nothing, np.zeros(nothing.shape), action=action)
    adapted = make_model("adapted", base=None).holding(learned)
    assert adapted.n_lags == base.n_lags + (delay > 0.0)
    windows = data.windows(20, stride=50, history=3)
    history = windows.past_states[:, 3 - adapted.n_lags :], windows.past_controls[:, 3 - adapted.n_lags :]
    found = adapted.simulate(*history, windows.controls)
    commands = np.concatenate([windows.past_controls, windows.controls], axis=1)
    acting = (1.0 - delay) * commands[:, 1:] + delay * commands[:, :-1]
    past, controls = np.split(GAIN * acting + OFFSET, [2], axis=1)
    expected = base.simulate(windows.past_states[:, 1:], past, controls)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    plain = AdaptationWindows.of(base, data)
    moved = action.applied(base, plain)
    commands = np.concatenate([plain.past_controls, plain.controls], axis=1)
    acting = GAIN * ((1.0 - delay) * commands[:, 1:] + delay * commands[:, :-1]) + OFFSET
    np.testing.assert_allclose(moved.controls, acting[:, 2:])
    np.testing.assert_allclose(moved.carry, base.start(plain.past_states, acting[:, :2]))
