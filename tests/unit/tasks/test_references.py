"""Tasks that lead states of any system, against cases worked out by hand."""

import itertools
import math

import numpy as np
import pytest

from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks.references import Balance, SetPoint, SwingUp, TrackReference
from sysid_evo.testing.examples import bare_system, pendulum
from tests.fixtures.systems import TANK

SEEDS = trial_seeds(5, 6)
IDLE = np.zeros((1, 2))


def followed(task, path, control=IDLE):
    """Return one trial after the states of ``path``, the first of which is its start."""
    trial = task.begin(SEEDS[:1])
    states = np.array(path)[:, None]
    for before, after in itertools.pairwise(states):
        trial, _ = task.advance(trial, before, after, control=control)
    return trial


def test_a_step_scores_one_on_the_target_and_a_half_at_one_tolerance():
    task = SetPoint(channels="level", low=2.0, high=2.0, tolerance=0.5, horizon=4).bind(TANK)
    path = [[0.0, 0.0], [2.0, 9.0], [2.5, 0.0], [1.0, 0.0], [2.0, 0.0]]
    assert task.fitness(followed(task, path))[0] == pytest.approx(100.0 * (1.0 + 0.5 + 0.2 + 1.0) / 4.0)


def test_of_two_channels_the_one_with_the_smaller_tolerance_weighs_more():
    task = SetPoint(channels=["level", "warmth"], low=0.0, high=0.0, tolerance=[1.0, 2.0], horizon=1).bind(TANK)
    assert task.fitness(followed(task, [[0.0, 0.0], [1.0, 0.0]]))[0] == pytest.approx(50.0)
    assert task.fitness(followed(task, [[0.0, 0.0], [0.0, 1.0]]))[0] == pytest.approx(80.0)
    assert task.fitness(followed(task, [[0.0, 0.0], [1.0, 2.0]]))[0] == pytest.approx(100.0 / 3.0)


def test_effort_is_the_mean_square_share_of_the_full_controls():
    task = SetPoint(low=0.0, high=0.0, effort=0.5, horizon=1).bind(TANK)
    path = [[0.0, 0.0], [0.0, 0.0]]
    for control, power in (([0.0, 0.0], 0.0), ([2.0, 0.0], 0.5), ([1.0, -1.0], 0.625)):
        score = task.fitness(followed(task, path, np.array([control])))[0]
        assert score == pytest.approx(100.0 * (1.0 + 0.5 * (1.0 - power)) / 1.5)


def test_a_change_of_still_per_second_costs_half_of_the_score_the_shorter_way_round_too():
    task = SetPoint(low=0.0, high=0.0, tolerance=9e9, rate_tolerance=2.0, horizon=1).bind(TANK)
    assert task.fitness(followed(task, [[1.0, 0.0], [2.0, 0.0]]))[0] == pytest.approx(50.0)
    round_the_top = SwingUp(tolerance=9e9, rate_tolerance=10.0, horizon=1).bind(pendulum())
    path = [[math.pi - 0.1, 0.0], [-math.pi + 0.1, 0.0]]
    assert round_the_top.fitness(followed(round_the_top, path, np.zeros((1, 1))))[0] == pytest.approx(50.0)


def test_targets_are_drawn_between_low_and_high_and_each_trial_begins_within_its_spread():
    task = SetPoint(channels=["warmth", "level"], low=[1.0, 2.0], high=[3.0, 2.5], start_spread=[0.2, 0.1]).bind(TANK)
    trials = task.begin(trial_seeds(1, 200))
    drawn = trials.reference[:, 0]
    for column, low, high in zip(drawn.T, (1.0, 2.0), (3.0, 2.5), strict=True):
        assert low <= column.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < column.max() <= high
    assert 0.19 < np.abs(trials.state[:, 1]).max() <= 0.2
    assert 0.09 < np.abs(trials.state[:, 0]).max() <= 0.1


def test_without_limits_given_the_middle_half_of_the_channel_is_drawn_from():
    goal = SetPoint(channels="level").bind(TANK).goals[0]
    assert (goal.low, goal.high, goal.tolerance) == (1.0, 3.0, 0.1)
    free = SetPoint(channels="warmth").bind(TANK).goals[0]
    assert (free.low, free.high) == (-1.0, 1.0)


def test_states_are_observed_by_their_limits_and_errors_in_tens_of_tolerances():
    task = SetPoint(channels="warmth", low=8.0, high=8.0, tolerance=0.5).bind(TANK)
    assert [channel.name for channel in task.observations] == ["bias", "level", "warmth", "warmth_error"]
    shown = task.observe(task.begin(SEEDS[:1]), np.array([[3.0, 7.0]]))
    np.testing.assert_allclose(shown, [[1.0, 0.5, 7.0, 0.2]])


def test_what_is_periodic_is_observed_by_sine_and_cosine_and_goes_the_shorter_way():
    task = SwingUp(tolerance=0.5, rate_tolerance=9e9, horizon=1).bind(pendulum())
    names = [channel.name for channel in task.observations]
    assert names == ["bias", "sin_angle", "cos_angle", "angular_speed", "sin_angle_error", "cos_angle_error"]
    shown = task.observe(task.begin(SEEDS[:1]), np.array([[0.5, 2.0]]))
    np.testing.assert_allclose(shown, [[1.0, math.sin(0.5), math.cos(0.5), 2.0, math.sin(0.5), -math.cos(0.5)]])
    for angle in (math.pi - 0.5, math.pi + 0.5, -math.pi + 0.5, 3.0 * math.pi - 0.5):
        assert task.fitness(followed(task, [[0.0, 0.0], [angle, 0.0]], np.zeros((1, 1))))[0] == pytest.approx(50.0)


def test_settling_is_the_last_time_outside_the_tolerance_and_overshoot_a_share_of_the_first_error():
    task = SetPoint(channels="level", low=2.0, high=2.0, tolerance=0.5, horizon=7).bind(TANK)
    levels = [0.0, 1.0, 1.9, 2.8, 2.2, 1.9, 2.0, 2.0]
    told = task.measures(followed(task, [[level, 0.0] for level in levels]))
    assert {name: float(values[0]) for name, values in told.items()} == pytest.approx(
        {"settled (% of trials)": 100.0, "settling time (s)": 1.5, "overshoot (%)": 40.0}
    )
    late = task.measures(followed(task, [[level, 0.0] for level in [*levels[:-1], 2.0, 2.6]]))
    assert late["settled (% of trials)"][0] == 0.0
    never = task.measures(followed(task, [[0.0, 0.0], [1.0, 0.0], [3.0, 0.0]]))
    assert never["settled (% of trials)"][0] == 0.0
    assert np.isnan([never["settling time (s)"][0], never["overshoot (%)"][0]]).all()


def test_balance_begins_near_the_top_and_is_over_once_it_has_fallen():
    task = Balance(start_spread=0.2, abort_error=0.8, horizon=10).bind(pendulum())
    starts = task.begin(trial_seeds(1, 100)).state[:, 0]
    assert 0.19 < np.abs(starts - math.pi).max() <= 0.2
    near, far = (followed(task, [[math.pi, 0.0], [math.pi - off, 0.0]], np.zeros((1, 1))) for off in (0.79, 0.81))
    assert near.alive[0]
    assert not far.alive[0]


@pytest.mark.parametrize("kind", ["sine", "steps", "random_walk"])
def test_a_reference_stays_in_its_range_changes_and_is_what_is_scored(kind):
    task = TrackReference(channels="level", kind=kind, low=1.0, high=3.0, tolerance=0.5, horizon=80).bind(TANK)
    trials = task.begin(trial_seeds(2, 50))
    assert trials.reference.shape == (50, 81, 1)
    assert 1.0 <= trials.reference.min() < 1.1
    assert 2.9 < trials.reference.max() <= 3.0
    np.testing.assert_array_equal(trials.state[:, 0], trials.reference[:, 0, 0])
    path = [[level, 0.0] for level in task.begin(SEEDS[:1]).reference[0, :, 0]]
    followed_exactly, half_off = followed(task, path), followed(task, [[level + 0.5, 0.0] for level, _ in path])
    assert task.fitness(followed_exactly)[0] == pytest.approx(100.0)
    assert task.fitness(half_off)[0] == pytest.approx(50.0)
    assert task.measures(half_off)["error (tolerances, rms)"][0] == pytest.approx(1.0)


def test_a_sine_has_the_period_that_is_asked_for():
    task = TrackReference(kind="sine", period=10.0, horizon=400).bind(TANK)
    reference = task.begin(trial_seeds(3, 20)).reference[:, :, 0]
    centred = reference - reference.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(centred, axis=1))
    periods = 401 * TANK.dt / power.argmax(axis=1)
    assert 9.0 < periods.min() < 12.0
    assert 17.0 < periods.max() < 22.0


def test_the_scene_names_the_targets_of_each_trial():
    task = SetPoint(channels=["level", "warmth"], tolerance=0.3).bind(TANK)
    trials = task.begin(SEEDS)
    for number in (0, 4):
        level, warmth = SetPoint().scene(trials, number).targets
        assert (level.channel, level.place, warmth.place) == (TANK.states[0], 0, 1)
        assert warmth.tolerance == 0.3
        np.testing.assert_array_equal(level.values, trials.reference[number, :, 0])


def test_a_state_that_is_missing_is_named():
    for task, system, message in (
        (SetPoint(channels="depth"), TANK, "set_point needs the state 'depth'; the states are level, warmth"),
        (SwingUp(), bare_system(), "swing_up needs a periodic state such as an angle"),
        (Balance(channel="height"), pendulum(), "balance needs the state 'height'"),
    ):
        with pytest.raises(IncompatibleTask, match=message):
            task.bind(system)


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: SetPoint(low=3.0, high=1.0), "expected low <= high"),
        (lambda: SetPoint(tolerance=0.0), "tolerance, rate_tolerance and abort_error > 0"),
        (lambda: SetPoint(low=[1.0, 2.0, 3.0]), "low: expected one number, or one for each of 1 channels, got 3"),
        (lambda: SetPoint(low="much"), "low: expected"),
        (lambda: SetPoint(channels=["level", "level"]), "expected every state once"),
        (lambda: SetPoint(horizon=0), "horizon >= 1"),
        (lambda: SetPoint(effort=-1.0), "effort >= 0"),
        (lambda: TrackReference(kind="square"), "expected kind sine, steps, random_walk"),
    ],
)
def test_values_that_make_no_sense_are_refused(made, message):
    with pytest.raises(InvalidArgument, match=message):
        made().bind(TANK)
