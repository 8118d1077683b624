"""Advice after a fit: a planted fault is called, a recording without it is not, and the list is short."""

import functools
import json
from dataclasses import replace

import numpy as np
import pytest

from evaluation.advice.advise import MAX_REMARKS, MODEL_CHECKS, PLACE_CHECKS, advise_model, advise_recording, ranked
from evaluation.advice.evidence import Evidence, ModelAdvice
from evaluation.advice.generalisation import halved, overfit, shift, too_few_data
from evaluation.advice.one_step import estimate_noise, hidden_state, late_controls, noise_floor
from evaluation.advice.recording import CHECKS
from evaluation.advice.regions import (
    dead_command,
    missing_excitation,
    often_outside,
    other_states,
    untried_command,
    weak_region,
)
from evaluation.coverage import largest_gap, suggest_recordings, untried_pair
from evaluation.steps import Steps
from evaluation.storage import from_plain, plain
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.data.support import Support
from sysid_evo.models.base import make_model
from sysid_evo.system import Channel, System
from tests.fixtures.faulty_recordings import Fault, drive

recorded = functools.cache(drive)
NONE, LATE = Fault(), Fault(late=6)


def linear(training, test=None, visited=None, fitted_to=None, **lags):
    """Return what a linear model of ``training`` is judged on; ``visited`` is what controllers were driven through."""
    model = make_model("linear", **lags).fit(training if fitted_to is None else fitted_to)
    steps = None if visited is None else Steps.of(visited.system, visited.episodes)
    return Evidence(name="linear", model=model, training=training, test=test, visited=steps)


@functools.cache
def evidence(fault=NONE, seed=0, *, noise=0.02, **lags):
    """Return a linear model of the machine on three quarters of each recording, and the rest."""
    return linear(*recorded(fault, seed, noise=noise).split(0.25), **lags)


def advised(where, **keywords):
    return advise_model(where.model, where.training, where.test, **keywords)


@pytest.mark.parametrize(("recordings", "most"), [(3, 0), pytest.param(8, 1, marks=pytest.mark.nightly)])
def test_on_a_machine_without_a_fault_hardly_ever_anything_but_the_noise_is_spoken_of(recordings, most):
    more = 0
    for seed in range(recordings):
        looks = (*MODEL_CHECKS, *PLACE_CHECKS, *CHECKS)
        remarks = [remark for look in looks if (remark := look(evidence(seed=seed))) is not None]
        assert remarks[0].topic == "noise"
        more += len(remarks) - 1
    assert more <= most


@pytest.mark.parametrize(
    ("look", "fault", "topic", "said"),
    [
        (noise_floor, Fault(bend=1.5), "form", ["a plain regression on the same inputs explains 4"]),
        (late_controls, LATE, "late controls", ["Controls act up to 300 ms later", "of speed", "control_lags=6"]),
        (hidden_state, Fault(drift=0.03), "hidden state", ["residual of speed is not white (linear, correlation +0.4"]),
        (hidden_state, Fault(measured=0.03), "noisy states", ["state_lags=2"]),
        (shift, Fault(grip=0.4), "shift", ["day 3 differs from the other recordings: "]),
        (dead_command, Fault(dead=True), "dead command", ["steer has no effect on turn with speed below -0."]),
    ],
)
def test_a_fault_is_named(look, fault, topic, said):
    remark = look(evidence(fault))
    assert remark.topic == topic
    for words in said:
        assert words in remark.sentence


def test_a_weak_region_is_named_where_there_are_blocks_enough_to_be_sure():
    remark = weak_region(linear(*recorded(Fault(loud=4.0)).split(0.5)))
    assert remark.topic == "weak region"
    assert "linear is least accurate with speed above 0.3" in remark.sentence
    assert weak_region(linear(*recorded().split(0.5))) is None


def recorded_again(usual, other, seed):
    """Return recordings of which the last was made another way, as training and test part."""
    (last,) = recorded(other, seed, episodes=1).episodes
    data = recorded(usual)
    return data.with_episodes([*data.episodes[:2], replace(last, name="day 3")]).split(0.25)


SLOW, WILD = Fault(push=0.15, bend=1.5), Fault(bend=1.5)


@pytest.mark.parametrize(
    ("look", "make"),
    [
        (late_controls, lambda: linear(*recorded(Fault(drift=0.03), steps=2400).split(0.25))),
        (late_controls, lambda: evidence(LATE, control_lags=6)),  # the model knows how late
        (hidden_state, lambda: evidence(LATE)),
        (shift, lambda: linear(*recorded_again(NONE, Fault(push=0.3), 3))),
        (shift, lambda: linear(*recorded_again(SLOW, WILD, 4), fitted_to=recorded(SLOW))),  # only the states are others
        (shift, lambda: linear(*recorded(episodes=1).split(0.25))),
        (missing_excitation, lambda: linear(*recorded().split(0.25), recorded(seed=5))),
        (untried_command, evidence),
        (often_outside, lambda: linear(*recorded().split(0.25), recorded(seed=5))),
        (other_states, evidence),
        (dead_command, lambda: evidence(Fault(bend=0.5))),
        (overfit, evidence),
    ],
)
def test_what_is_no_fault_is_not_named(look, make):
    assert look(make()) is None


@pytest.mark.parametrize("noise", [0.02, 0.05])
def test_the_noise_is_estimated_to_a_tenth(noise):
    where = evidence(noise=noise)
    n, floor, _ = estimate_noise(where)
    assert floor == pytest.approx(float(np.mean(noise / where.std)), rel=0.1)
    assert n == pytest.approx(floor, rel=0.1)


def test_a_wrong_form_and_a_day_with_less_grip_cost_much():
    n, floor, _ = estimate_noise(evidence(Fault(bend=1.5)))
    assert n > 1.5 * floor
    assert shift(evidence(Fault(grip=0.4))).weight > 0.15


def test_where_controllers_go_and_the_data_do_not_is_named():
    remark = missing_excitation(linear(*recorded(Fault(push=0.5)).split(0.25), recorded(seed=5)))
    assert remark.sentence.startswith("Controllers spend 2")
    assert "of their time with push " in remark.sentence


def test_the_share_outside_the_data_is_reported_unless_one_region_explains_it():
    where = linear(*recorded(Fault(push=0.5)).split(0.25), recorded(seed=5))
    remark = often_outside(where)
    assert 0.2 < remark.weight == remark.figures["outside"] < 0.9
    assert remark.sentence.startswith(
        f"{100 * remark.weight:.0f} % of the controllers' steps are outside the training data"
    )
    assert remark.sentence.count(" of the steps") == 3
    assert "outside the data" not in {one.topic for one in ranked([remark, missing_excitation(where)])}
    alone = advise_recording(where.training, visited=recorded(seed=5).episodes)
    assert {one.topic for one in alone} == {"slow switching", "excitation"}, "nothing of commands that nobody gives"


def test_controllers_at_the_limit_of_a_command_are_not_beyond_it():
    data, system = recorded(), recorded().system
    assert system.controls[0].high == 1.0
    never_both = [np.minimum(e.controls, 0.9) for e in data]
    for number, controls in enumerate(never_both):
        controls[:, number % 2] = 1.0
    seen, needed = (
        Steps.of(system, Dataset.from_arrays(system, [e.states for e in data], controls).episodes)
        for controls in (never_both, [np.ones_like(u) for u in never_both])
    )
    assert largest_gap(seen, needed).words == "push at 1 and steer at 1"


def test_a_command_that_was_never_tried_at_speed_is_named_without_controllers():
    data = recorded()
    kept = [np.where((e.states[:-1, :1] > 0.2) & [False, True], np.minimum(e.controls, 0.0), e.controls) for e in data]
    remark = untried_command(linear(Dataset.from_arrays(data.system, [e.states for e in data], kept)))
    assert remark.sentence.startswith("steer above ")
    assert " is rare with speed above " in remark.sentence


def test_a_test_part_that_lies_elsewhere_is_named():
    remark = other_states(linear(recorded(Fault(push=0.4)), recorded(seed=5)))
    assert "of the test part has push " in remark.sentence


def test_controllers_that_go_where_no_test_is_made_are_named():
    remark = other_states(linear(recorded(seed=5), recorded(Fault(push=0.4)), recorded(seed=6)))
    assert "test errors do not show how accurate models are there" in remark.sentence


def test_two_channels_make_a_place_where_each_alone_was_visited():
    seen, needed = Steps.moving(recorded()), Steps.moving(recorded(seed=1))
    corner = (seen.before[:, 0] > 0.1) & (seen.control[:, 1] > 0.0)
    apart = Steps(seen.system, seen.before[~corner], seen.control[~corner], seen.after[~corner])
    gap = largest_gap(apart, needed)
    assert {region.channel for region in gap.place} == {"speed", "steer"}
    assert largest_gap(seen, needed) is None
    few, short = (Steps(one.system, one.before[:199], one.control[:199], one.after[:199]) for one in (needed, apart))
    assert largest_gap(apart, few) is None
    assert largest_gap(short, needed) is None


def test_a_rare_pair_is_untried_and_has_its_share():
    """Fast in 40 of 100 steps, steered in 50, both in 2."""
    high = np.tile([[1, 0]] * 38 + [[0, 1]] * 48 + [[1, 1]] * 2 + [[0, 0]] * 12, (5, 1)).astype(float)
    system = System((Channel("speed"),), (Channel("steer", levels=(0.0, 1.0)),), 0.1)
    gap = untried_pair(Steps(system, high[:, :1], high[:, 1:], high[:, :1]))
    assert (gap.needed, gap.seen, gap.words) == (pytest.approx(0.2), 0.02, "speed at 1 and steer at 1")


@pytest.mark.parametrize(
    "slow, words", [(True, "speed above 0.5 and steer at 1"), (False, "speed below 0.5 and steer at 1")]
)
def test_a_channel_is_cut_at_its_median(slow, words):
    speed = np.linspace(0.0, 1.0, 1001)[:, None]
    steer = ((speed < 0.44) if slow else (speed > 0.56)).astype(float)
    system = System((Channel("speed"),), (Channel("steer", levels=(0.0, 1.0)),), 0.1)
    gap = untried_pair(Steps(system, speed, steer, speed))
    assert (gap.needed, gap.words) == (pytest.approx(0.22, abs=0.001), words)


def test_a_model_with_too_much_to_choose_from_is_overfit_and_still_learns():
    lags = {"state_lags": 20, "control_lags": 20}
    remark = overfit(linear(recorded(episodes=1, steps=200), recorded(seed=9), **lags))
    assert " times its training error" in remark.sentence
    data = recorded(episodes=1, steps=400)
    more = Evidence(
        name="linear",
        model=linear(data, **lags).model,
        training=recorded(episodes=1, steps=200),
        test=recorded(seed=9),
    )
    remark = too_few_data(more, linear(halved(data), **lags).model)
    assert remark.figures["half"] > 1.05 * remark.figures["all"]


def test_a_model_with_enough_data_is_not_in_want_of_more():
    assert too_few_data(evidence(), linear(halved(evidence().training)).model) is None


def test_half_the_data_are_every_other_piece_of_each_episode():
    data = recorded(episodes=1, steps=800)
    half = halved(data)
    assert [len(episode) for episode in half] == [200, 200]
    np.testing.assert_array_equal(half.episodes[1].controls, data.episodes[0].controls[400:600])


def test_the_most_important_comes_first_and_there_are_five_at_most():
    where = evidence(Fault(late=6, dead=True, loud=3.0, push=0.6))
    advice = advised(where, visited=recorded(seed=5).episodes, name="linear")
    weights = [remark.weight for remark in advice.remarks]
    assert weights == sorted(weights, reverse=True)
    assert 3 <= len(weights) <= MAX_REMARKS
    assert advice.remarks[0].topic == "late controls"
    assert "noise" not in [remark.topic for remark in advice.remarks]


def test_the_form_of_a_model_that_is_nearly_right_does_not_limit_it():
    where = evidence(Fault(bend=0.1), noise=1e-4)
    assert noise_floor(where).topic == "form"
    assert where.test_windows.n(where.std) < 0.05
    topics = {remark.topic for remark in advised(where).remarks}
    assert not {"form", "weak region", "shift", "hidden state"} & topics
    assert advised(evidence(Fault(bend=1.5), noise=1e-4)).remarks[0].topic == "form"


def test_what_follows_from_something_else_is_left_out():
    assert noise_floor(evidence(LATE)) is not None
    assert [remark.topic for remark in advised(evidence(LATE)).remarks] == ["late controls"]


def test_without_a_test_part_a_copy_is_judged_on_a_part_held_back():
    advice = advised(linear(recorded(LATE)))
    assert advice.model == "Linear"
    assert advice.evaluated_on.startswith("the last quarter of each episode")
    assert advice.remarks[0].topic == "late controls"
    assert advised(linear(recorded(episodes=1, steps=30))).evaluated_on == "its own training data"


def test_a_family_that_takes_long_is_never_fitted_again():
    family = type(make_model("linear"))
    once = type("Slow", (family,), {"fast_fit": False, "__module__": __name__})().fit(recorded())
    once.clone_unfitted = lambda: pytest.fail("fitted again")
    assert advise_model(once, recorded()).evaluated_on == "its own training data"
    assert advise_model(once, *recorded().split(0.25)).evaluated_on == "the test part"


def test_advice_is_the_same_every_time_and_comes_back_from_json():
    once, again = (advised(evidence(LATE)) for _ in range(2))
    assert once == again
    assert from_plain(ModelAdvice, json.loads(json.dumps(plain(once), allow_nan=False))) == once


SYSTEM = System(
    (Channel("speed", "m/s"),), (Channel("drive", levels=(-1.0, 1.0)), Channel("steer", "rad", -0.3, 0.3)), 0.1
)
DRIVEN = Support.of(SYSTEM, np.linspace(0.0, 1.0, 300)[:, None], np.tile([1.0, 0.0], (300, 1)))
"""Speeds from 0 to 1 m/s, whose standard deviation is 0.29, driven forwards and straight on."""


def driven(speeds, drive=1.0, steer=0.0):
    states = np.array([*speeds, 0.0])[:, None]
    return Trajectory(states, np.tile([drive, steer], (len(speeds), 1)), 0.1)


def test_the_most_visited_box_outside_the_data_comes_first():
    regions = suggest_recordings(DRIVEN, [driven([0.5] * 60 + [1.7] * 30), driven([1.25] * 10)])
    assert [region.share for region in regions] == [0.3, 0.1]
    boxes = [(region.low[0], region.high[0]) for region in regions]
    np.testing.assert_allclose(boxes, [(1.6, 1.8), (1.2, 1.4)], err_msg="0.2 wide, at round numbers")
    assert regions[0].words == "speed 1.6 to 1.8 m/s, drive 1, steer -0.1 to 0.1 rad"


def test_a_command_that_was_not_given_at_a_known_speed_is_outside():
    backwards, turning = driven([0.5] * 50, drive=-1.0), driven([0.5] * 50, steer=0.25)
    first, second = suggest_recordings(DRIVEN, [backwards, turning, backwards])
    assert first.low[1] == first.high[1] == -1.0
    np.testing.assert_allclose([second.low[2], second.high[2]], [0.1, 0.3])


def test_driving_within_the_data_or_not_at_all_asks_for_nothing():
    assert suggest_recordings(DRIVEN, [driven([0.1, 0.9])]) == ()
    assert suggest_recordings(DRIVEN, []) == ()


def test_no_more_regions_than_requested_are_returned_and_no_rare_ones():
    speeds = [2.0 + 0.2 * i for i in range(20) for _ in range(20 - i)]
    assert len(suggest_recordings(DRIVEN, [driven(speeds)], most=3)) == 3
    assert suggest_recordings(DRIVEN, [driven([0.5] * 9999 + [3.0])]) == ()
    (rare,) = suggest_recordings(DRIVEN, [driven([0.5] * 997 + [3.0] * 3)])
    assert rare.share == 0.003


@pytest.mark.parametrize("fastest, width", [(1.0, 0.2), (2.0, 0.5), (6.0, 1.0), (20.0, 5.0), (10.0, 2.0)])
def test_boxes_are_one_two_or_five_times_a_power_of_ten_wide_and_one_begins_at_0(fastest, width):
    """A uniform speed from 0 to the fastest has a standard deviation of 0.29 of it."""
    seen = Support.of(SYSTEM, np.linspace(0.0, fastest, 300)[:, None], np.tile([1.0, 0.0], (300, 1)))
    (box,) = suggest_recordings(seen, [driven([3.1 * fastest] * 9)])
    assert box.high[0] - box.low[0] == pytest.approx(width)
    assert box.low[0] / width == pytest.approx(round(box.low[0] / width))


@pytest.mark.parametrize("angle", [3.0, 3.0 + 2.0 * np.pi])
def test_an_angle_that_comes_round_is_as_near_as_it_is_on_the_circle(angle):
    pendulum = System((Channel("angle", "rad", period=2.0 * np.pi),), (Channel("torque", "N m", -1.0, 1.0),), 0.1)
    angles = np.linspace(-0.5, 0.5, 100)[:, None]
    seen = Support.of(pendulum, angles, np.zeros((100, 1)))
    inside = Trajectory(np.full((5, 1), 0.2 + 2.0 * np.pi), np.zeros((4, 1)), 0.1)
    outside = Trajectory(np.full((5, 1), angle), np.zeros((4, 1)), 0.1)
    (region,) = suggest_recordings(seen, [inside, outside])
    assert region.share == 0.5
    assert region.high[0] - region.low[0] == pytest.approx(np.pi / 6.0)
