"""Advice after a fit: a planted fault is called, a recording without it is not, and the list is short."""

import functools
import json
from dataclasses import replace

import numpy as np
import pytest

from evaluation.advice import MOST, Evidence, advice_from_json, advice_to_json, advise_model
from evaluation.advice.advise import LOOKS
from evaluation.advice.generalisation import halved, overfit, shift, too_few_data
from evaluation.advice.one_step import estimate_noise, hidden_state, late_controls, noise_floor
from evaluation.advice.regions import dead_command, missing_excitation, other_states, weak_region
from evaluation.coverage import largest_gap
from evaluation.exploitability import what_to_record
from evaluation.steps import Steps
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.data.support import Support
from sysid_evo.models.base import make_model
from sysid_evo.system import Channel, System
from tests.fixtures.faulty_recordings import Fault, drive

NONE = Fault()


@functools.cache
def evidence(fault=NONE, seed=0, *, noise=0.02):
    """Return a linear model of the machine on three quarters of each recording, and the rest."""
    training, test = drive(fault, seed, noise=noise).split(0.25)
    return Evidence("linear", make_model("linear").fit(training), training, test)


def visiting(where, visited):
    return Evidence(where.name, where.model, where.training, where.test, Steps.of(visited.system, visited.episodes))


@pytest.mark.parametrize(("recordings", "most"), [(3, 0), pytest.param(8, 1, marks=pytest.mark.nightly)])
def test_on_a_machine_without_a_fault_hardly_ever_anything_but_the_noise_is_spoken_of(recordings, most):
    more = 0
    for seed in range(recordings):
        remarks = [remark for look in LOOKS if (remark := look(evidence(NONE, seed))) is not None]
        assert remarks[0].topic == "noise"
        more += len(remarks) - 1
    assert more <= most


@pytest.mark.parametrize("noise", [0.02, 0.05])
def test_the_noise_is_estimated_to_a_tenth(noise):
    where = evidence(noise=noise)
    found = estimate_noise(where)
    assert found.floor == pytest.approx(float(np.mean(noise / where.std)), rel=0.1)
    assert found.n == pytest.approx(found.floor, rel=0.1)


def test_a_model_whose_form_is_wrong_is_told_so_and_not_that_little_is_left():
    remark = noise_floor(evidence(Fault(bend=1.5)))
    assert remark.topic == "form"
    assert "a plain regression on the same inputs explains 4" in remark.sentence
    found = estimate_noise(evidence(Fault(bend=1.5)))
    assert found.n > 1.5 * found.floor


def test_a_control_that_acts_later_than_the_model_knows_is_named_with_its_time():
    remark = late_controls(evidence(Fault(late=6)))
    assert "Controls act up to 300 ms later" in remark.sentence
    assert "of speed" in remark.sentence
    assert "control_lags=6" in remark.sentence
    training, test = drive(Fault(drift=0.03), steps=2400).split(0.25)
    assert late_controls(Evidence("linear", make_model("linear").fit(training), training, test)) is None
    where = evidence(Fault(late=6))
    knowing = Evidence("linear", make_model("linear", control_lags=6).fit(where.training), where.training, where.test)
    assert late_controls(knowing) is None


def test_a_push_that_nobody_measures_is_a_hidden_state_and_noisy_measurements_are_none():
    unseen, noisy = (hidden_state(evidence(fault)) for fault in (Fault(drift=0.03), Fault(measured=0.03)))
    assert unseen.topic == "hidden state"
    assert "leaves of speed one step ahead is not white (correlation +0.4" in unseen.sentence
    assert noisy.topic == "noisy states"
    assert "state_lags=2" in noisy.sentence
    assert hidden_state(evidence(Fault(late=6))) is None


def test_a_day_with_less_grip_is_named_and_other_driving_on_the_same_machine_is_not():
    remark = shift(evidence(Fault(grip=0.4)))
    assert remark.sentence.startswith("day 3 behaves unlike the other recordings: ")
    assert remark.weight > 0.15
    gentle = drive(Fault(push=0.3), 3, episodes=1)
    data = drive().with_episodes([*drive().episodes[:2], replace(gentle.episodes[0], name="day 3")])
    training, test = data.split(0.25)
    assert shift(Evidence("linear", make_model("linear").fit(training), training, test)) is None


def test_a_recording_of_states_that_no_other_has_seen_is_no_other_condition():
    gentle, wild = drive(Fault(push=0.15, bend=1.5), episodes=3), drive(Fault(bend=1.5), 4, episodes=1)
    data = gentle.with_episodes([*gentle.episodes[:2], replace(wild.episodes[0], name="wild")])
    training, test = data.split(0.25)
    assert shift(Evidence("linear", make_model("linear").fit(gentle), training, test)) is None


def test_one_recording_alone_differs_from_no_other():
    training, test = drive(episodes=1).split(0.25)
    assert shift(Evidence("linear", make_model("linear").fit(training), training, test)) is None


def test_where_controllers_go_and_the_data_do_not_is_named():
    slow = evidence(Fault(push=0.5))
    remark = missing_excitation(visiting(slow, drive(seed=5)))
    assert remark.sentence.startswith("Controllers spend 2")
    assert "of their time with push " in remark.sentence
    assert missing_excitation(visiting(evidence(), drive(seed=5))) is None


def test_controllers_at_the_end_of_a_command_are_not_said_to_be_beyond_it():
    data = drive()
    system = data.system
    assert system.controls[0].high == 1.0
    never_both = [np.minimum(e.controls, 0.9) for e in data]
    for number, controls in enumerate(never_both):
        controls[:, number % 2] = 1.0
    seen = Dataset.from_arrays(system, [e.states for e in data], never_both)
    asked = Dataset.from_arrays(system, [e.states for e in data], [np.ones_like(u) for u in never_both])
    gap = largest_gap(Steps.of(system, seen.episodes), Steps.of(system, asked.episodes))
    assert gap.words == "push at 1 and steer at 1"


def test_a_command_that_was_never_tried_at_speed_is_named_without_controllers():
    data = drive()
    kept = []
    for episode in data:
        controls = episode.controls.copy()
        controls[:, 1] = np.where(episode.states[:-1, 0] > 0.2, np.minimum(controls[:, 1], 0.0), controls[:, 1])
        kept.append((episode.states, controls))
    careful = Dataset.from_arrays(data.system, [x for x, _ in kept], [u for _, u in kept])
    remark = missing_excitation(Evidence("linear", make_model("linear").fit(careful), careful))
    assert remark.sentence.startswith("steer above ")
    assert " was hardly tried with speed above " in remark.sentence


def test_a_test_part_that_lies_elsewhere_is_named():
    gentle, wild = drive(Fault(push=0.4)), drive(seed=5)
    model = make_model("linear").fit(gentle)
    remark = other_states(Evidence("linear", model, gentle, wild))
    assert "of the test part has push " in remark.sentence
    assert other_states(evidence()) is None


def test_controllers_that_go_where_no_test_is_made_are_named():
    wild, gentle = drive(seed=5), drive(Fault(push=0.4))
    where = visiting(Evidence("linear", make_model("linear").fit(wild), wild, gentle), drive(seed=6))
    remark = other_states(where)
    assert "its errors say nothing of what models do there" in remark.sentence


def test_two_channels_make_a_place_where_each_alone_was_visited():
    seen, asked = Steps.moving(drive()), Steps.moving(drive(seed=1))
    corner = (seen.before[:, 0] > 0.1) & (seen.control[:, 1] > 0.0)
    apart = Steps(seen.system, seen.before[~corner], seen.control[~corner], seen.after[~corner])
    gap = largest_gap(apart, asked)
    assert {region.channel for region in gap.place} == {"speed", "steer"}
    assert largest_gap(seen, asked) is None


def test_a_command_without_effect_in_one_region_is_named():
    remark = dead_command(evidence(Fault(dead=True)))
    assert remark.sentence.startswith("steer has no effect on turn with speed below -0.")
    assert dead_command(evidence(Fault(bend=0.5))) is None


def test_a_region_where_the_error_is_larger_is_named():
    remark = weak_region(evidence(Fault(loud=4.0)))
    assert "linear is worst with speed above 0.3" in remark.sentence


def few(lags):
    """Return a linear model with so many lags of little data, and much to test it on."""
    training = drive(episodes=1, steps=200)
    model = make_model("linear", state_lags=lags, control_lags=lags).fit(training)
    return Evidence("linear", model, training, drive(seed=9)), training


def test_a_model_with_too_much_to_choose_from_is_overfit_and_still_learns():
    where, training = few(20)
    remark = overfit(where)
    assert " times that in the training part" in remark.sentence
    half = where.model.unfitted().fit(halved(drive(episodes=1, steps=400)))
    more = Evidence("linear", where.model.unfitted().fit(drive(episodes=1, steps=400)), training, where.test)
    remark = too_few_data(more, half)
    assert remark.figures["half"] > 1.05 * remark.figures["all"]


def test_a_model_with_enough_data_is_neither_overfit_nor_in_want_of_more():
    where = evidence()
    assert overfit(where) is None
    assert too_few_data(where, where.model.unfitted().fit(halved(where.training))) is None


def test_half_the_data_are_every_other_piece_of_each_episode():
    data = drive(episodes=1, steps=800)
    half = halved(data)
    assert [len(episode) for episode in half] == [200, 200]
    np.testing.assert_array_equal(half.episodes[1].controls, data.episodes[0].controls[400:600])


def test_the_most_important_comes_first_and_there_are_five_at_most():
    where = evidence(Fault(late=6, dead=True, loud=3.0, push=0.6))
    advice = advise_model(where.model, where.training, where.test, visited=drive(seed=5).episodes, name="linear")
    weights = [remark.weight for remark in advice.remarks]
    assert weights == sorted(weights, reverse=True)
    assert 3 <= len(weights) <= MOST
    assert advice.remarks[0].topic == "late controls"
    assert "noise" not in [remark.topic for remark in advice.remarks]


def test_the_form_of_a_model_that_is_nearly_right_does_not_limit_it():
    where = evidence(Fault(bend=0.1), noise=1e-4)
    remark = noise_floor(where)
    assert remark.topic == "form"
    assert where.test_windows.n(where.std) < 0.05
    topics = [remark.topic for remark in advise_model(where.model, where.training, where.test).remarks]
    assert not {"form", "weak region", "shift", "hidden state"} & set(topics)
    wrong = evidence(Fault(bend=1.5), noise=1e-4)
    assert advise_model(wrong.model, wrong.training, wrong.test).remarks[0].topic == "form"


def test_what_follows_from_something_else_is_left_out():
    where = evidence(Fault(late=6))
    assert noise_floor(where) is not None
    assert [remark.topic for remark in advise_model(where.model, where.training, where.test).remarks] == [
        "late controls"
    ]


def test_without_a_test_part_a_copy_is_judged_on_a_part_held_back():
    advice = advise_model(make_model("linear").fit(drive(Fault(late=6))), drive(Fault(late=6)))
    assert advice.model == "Linear"
    assert advice.judged_on.startswith("the last quarter of each episode")
    assert advice.remarks[0].topic == "late controls"
    short = drive(episodes=1, steps=30)
    assert advise_model(make_model("linear").fit(short), short).judged_on == "its own training data"


def test_a_family_that_takes_long_is_never_fitted_again():
    family = type(make_model("linear"))
    once = type("Slow", (family,), {"cheap": False, "__module__": __name__})().fit(drive())
    once.unfitted = lambda: pytest.fail("fitted again")
    assert advise_model(once, drive()).judged_on == "its own training data"
    assert advise_model(once, *drive().split(0.25)).judged_on == "the test part"


def test_advice_is_the_same_every_time_and_comes_back_from_json():
    where = evidence(Fault(late=6))
    once, again = (advise_model(where.model, where.training, where.test) for _ in range(2))
    assert once == again
    stored = advice_from_json(json.loads(json.dumps(advice_to_json(once), allow_nan=False)))
    assert stored == once


SYSTEM = System(
    (Channel("speed", "m/s"),), (Channel("drive", levels=(-1.0, 1.0)), Channel("steer", "rad", -0.3, 0.3)), 0.1
)


def support():
    """Speeds from 0 to 1 m/s, whose standard deviation is 0.29, driven forwards and straight on."""
    speeds = np.linspace(0.0, 1.0, 300)[:, None]
    return Support.of(SYSTEM, speeds, np.tile([1.0, 0.0], (300, 1)))


def driven(speeds, drive=1.0, steer=0.0):
    states = np.array([*speeds, 0.0])[:, None]
    return Trajectory(states, np.tile([drive, steer], (len(speeds), 1)), 0.1)


def test_the_most_visited_box_outside_the_data_comes_first():
    regions = what_to_record(support(), [driven([0.5] * 60 + [1.7] * 30), driven([1.25] * 10)])
    assert [region.share for region in regions] == [0.3, 0.1]
    np.testing.assert_allclose(
        [regions[0].low[0], regions[0].high[0]], [1.6, 1.8], err_msg="0.2 wide, at round numbers"
    )
    np.testing.assert_allclose([regions[1].low[0], regions[1].high[0]], [1.2, 1.4])
    assert regions[0].sentence == "speed 1.6 to 1.8 m/s, drive 1, steer -0.1 to 0.1 rad: 30 % of the steps"


def test_a_command_that_was_not_given_at_a_known_speed_is_outside():
    backwards, turning = driven([0.5] * 50, drive=-1.0), driven([0.5] * 50, steer=0.25)
    first, second = what_to_record(support(), [backwards, turning, backwards])
    assert first.low[1] == first.high[1] == -1.0
    np.testing.assert_allclose([second.low[2], second.high[2]], [0.1, 0.3])


def test_driving_within_the_data_or_not_at_all_asks_for_nothing():
    assert what_to_record(support(), [driven([0.1, 0.9])]) == ()
    assert what_to_record(support(), []) == ()


def test_no_more_regions_are_told_than_asked_for_and_no_rare_ones():
    speeds = [2.0 + 0.2 * i for i in range(20) for _ in range(20 - i)]
    assert len(what_to_record(support(), [driven(speeds)], most=3)) == 3
    assert what_to_record(support(), [driven([0.5] * 9999 + [3.0])]) == ()


@pytest.mark.parametrize("angle", [3.0, 3.0 + 2.0 * np.pi])
def test_an_angle_that_comes_round_is_as_near_as_it_is_on_the_circle(angle):
    pendulum = System((Channel("angle", "rad", period=2.0 * np.pi),), (Channel("torque", "N m", -1.0, 1.0),), 0.1)
    angles = np.linspace(-0.5, 0.5, 100)[:, None]
    seen = Support.of(pendulum, angles, np.zeros((100, 1)))
    inside = Trajectory(np.full((5, 1), 0.2 + 2.0 * np.pi), np.zeros((4, 1)), 0.1)
    outside = Trajectory(np.full((5, 1), angle), np.zeros((4, 1)), 0.1)
    (region,) = what_to_record(seen, [inside, outside])
    assert region.share == 0.5
    assert region.high[0] - region.low[0] == pytest.approx(np.pi / 6.0)
