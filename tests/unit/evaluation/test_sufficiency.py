"""A figure is stated only with enough data behind it, and a choice praised only if it beats doing nothing."""

from dataclasses import replace

import numpy as np
import pytest

from evaluation.advice.advise import INTERVAL_TOPICS, advise_model
from evaluation.prediction.cases import PredictionProtocol, measured_cases
from evaluation.prediction.scoring import assess_prediction
from evaluation.report.report import brief, to_json
from evaluation.report.sections.controllers import fitness_table
from evaluation.report.sections.prediction import difference_table, error_table
from evaluation.report.sections.summary import headlines, verdict
from evaluation.results import EpisodeSummary
from evaluation.sufficiency import FEWEST_BLOCKS, beats_rest, none_beats_rest
from sysid_evo.data import Dataset
from sysid_evo.models.base import make_model
from sysid_evo.system import Channel, System
from tests.fixtures.known_models import SYSTEM, Known, fitted, recording
from tests.fixtures.reports import exploited, matrix, prediction, printed, report

pytestmark = pytest.mark.filterwarnings("ignore::sysid_evo.errors.DataWarning")  # some recordings stand still

GOOD = {"persistence": 0.9, "linear": 0.036, "sindy": 0.6}


def headline(made, question):
    return next(one for one in headlines(made) if one.question.startswith(question))


def first_sentence(made, question):
    return next(finding.sentence for finding in verdict(made) if finding.question == question)


@pytest.mark.parametrize("episodes", [2, FEWEST_BLOCKS - 1, FEWEST_BLOCKS])
def test_models_are_compared_from_ten_blocks_of_test_data(episodes):
    made = report(prediction(GOOD, GOOD, episodes=episodes))
    enough = episodes >= FEWEST_BLOCKS
    card, said = headline(made, "Which models predict?"), first_sentence(made, "Which models predict?")
    assert (card.tone == "good") == enough
    assert ("its simulation error N is" in said) == enough
    assert (f"Too little test data to compare models: {episodes} blocks of 3 s, 10 are needed." in said) != enough
    rows = {row[0]: row[1:] for row in error_table(made.prediction).rows}
    assert rows["linear"] == (("* 0.036\n0.016 to 0.056",) * 2 if enough else ("0.036",) * 2)
    assert (difference_table(made.prediction) is not None) == enough
    document = to_json(made)["prediction"]
    (score,) = next(model["scores"] for model in document["models"] if model["name"] == "linear")
    assert (score["interval"] != [None, None]) == enough
    assert bool(document["differences"]) == enough


def test_blocks_are_those_in_which_targets_move():
    training, test = recording(2, steps=200), recording(3, steps=200)
    cases = measured_cases(training, test, PredictionProtocol(horizons=(20,)))
    assert cases.blocks(20) == len(np.unique(cases.window_block))
    for episode in range(3):  # fifteen windows after another are a block, and none crosses an episode
        _, counts = np.unique(cases.window_block[cases.windows.episode == episode], return_counts=True)
        assert (counts[:-1] == 15).all()
        assert 1 < len(counts) < counts.sum() / 10
    assert len(set(zip(cases.window_block, cases.windows.episode, strict=True))) == cases.blocks(20)
    still = replace(cases, moving=cases.moving & (cases.windows.episode == 0)[:, None])
    assert still.blocks(20) == len(np.unique(cases.window_block[cases.windows.episode == 0]))
    assert cases.blocks(None) == 3 * 2


@pytest.mark.parametrize("value", [0.0, 0.1, 1e6 / 3.0])
def test_a_state_that_is_constant_but_for_rounding_has_no_score(value):
    states = np.full((400, 3), value) * (1.0 + 1e-16 * np.arange(1200).reshape(400, 3))
    states[:, 0] = np.sin(0.1 * np.arange(400))
    constant = Dataset.from_arrays(SYSTEM, [states], [np.ones((399, 2))])
    found = assess_prediction({"known": fitted(Known())}, constant, constant)
    score = found.model("known").score(20)
    assert np.isnan(score.nrmse[1:]).all()
    assert "lateral_speed, yaw_rate is constant in the test set and left out of N" in found.cases.notes


def test_without_variation_in_the_data_that_is_the_only_remark():
    system = System((Channel("x"),), (Channel("u", low=-1.0, high=1.0),), dt=0.1)
    pushes = np.random.default_rng(0).uniform(-1.0, 1.0, size=(399, 1))
    training = Dataset.from_arrays(system, [np.full((400, 1), 0.1)], [pushes])
    model = make_model("linear").fit(training, rng=np.random.default_rng(0))
    for test in (training, None):
        (remark,) = advise_model(model, training, test, name="linear").remarks
        assert remark.sentence.startswith("No state varies in the data that linear is evaluated on")


def test_advice_that_rests_on_an_interval_wants_ten_blocks(monkeypatch):
    monkeypatch.setattr("evaluation.advice.advise.MAX_REMARKS", 20)
    training, short, long = recording(1, steps=60), recording(1, steps=540, seed=8), recording(3, steps=400, seed=8)
    (episode,), noise = training.episodes, 0.05 * np.random.default_rng(0).normal(size=(61, 3))
    training = training.with_episodes([replace(episode, states=episode.states + noise)])
    model = make_model("linear").fit(training, rng=np.random.default_rng(0))
    topics = [{one.topic for one in advise_model(model, training, test).remarks} for test in (short, long)]
    assert not topics[0] & set(INTERVAL_TOPICS)
    assert topics[1] & set(INTERVAL_TOPICS)


def on_each(a, b, rest, robot="car"):
    """Return the report of two controllers and controls at rest by their fitness in two models and on the robot."""
    columns, rows = ("a", "b", *([robot] if robot else ())), {"a": a, "b": b, "rest": rest}
    fitness = {row: dict(zip(columns, values, strict=False)) for row, values in rows.items() if values}
    return report(transfer=matrix(fitness, robot=robot))


def idle(rest, robot="car"):
    """Two controllers that reach 9.5 and 5, and controls at rest."""
    return on_each((10.0, 9.0, 9.5), (3.0, 9.5, 5.0), (rest,) * 3, robot)


@pytest.mark.parametrize("robot", ["car", None])
def test_that_rest_scores_best_is_the_first_thing_that_is_said(robot):
    useless, fine = idle(12.0, robot), idle(1.0, robot)
    assert none_beats_rest(useless.matrix)
    assert headlines(useless)[0].tone == "warn"
    assert headlines(useless)[0].sentence.startswith(
        "No controller does better than controls at rest. Look at the reward"
    )
    assert verdict(useless)[0].sentence.startswith("No controller does better than controls at rest")
    assert "at rest" not in verdict(fine)[0].sentence
    assert headline(fine, "Which controller").tone == "good"


def test_if_rest_has_the_highest_forecast_there_is_no_choice_and_the_sentence_says_what_to_record():
    made = on_each((5.0, 5.0, 9.0), (5.0, 5.0, 9.0), (6.0,) * 3)
    assert made.transfer.pick == "rest"
    card = headline(made, "Which controller")
    assert (card.answer, card.command) == ("None", "")
    assert card.sentence.startswith("No evolved controller has a higher forecast than the baseline rest.")
    assert "a does better on the robot, 9.00" in card.sentence
    short = replace(made, data=replace(made.data, training=(EpisodeSummary("a", 7, 0.1, 1.0),)))
    assert headline(short, "Which controller").sentence.endswith(
        "within 7 steps: record under controllers, with --rounds 6."
    )


def test_a_choice_that_is_worse_than_rest_is_no_good_choice_and_the_first_sentence_says_so():
    made, better = (
        replace(on_each((10.0, 9.0, 4.0), (3.0, 8.0, 7.0), rest), controllers={"a": "controllers/a.json"})
        for rest in ((6.0,) * 3, None)
    )
    assert made.transfer.pick == "a"
    assert "Use the chosen controller" not in "\n".join(printed(brief(made)))
    assert "Use the chosen controller" in "\n".join(printed(brief(better)))
    card = headline(made, "Which controller")
    assert (card.tone, card.command) == ("bad", "")
    assert card.sentence.startswith("a is worse than controls at rest (difference -2.00 ±")
    assert first_sentence(made, "Which controller to use?").startswith("a is worse than controls at rest")
    claimed = on_each((10.0, 9.0, 10.0), (3.0, 8.0, 13.0), (6.0, 6.0, 12.0))
    assert claimed.transfer.controller("a").exploited is False
    assert headline(claimed, "Which controller").tone == "bad"


def test_better_than_rest_in_all_of_ten_trials_is_better_even_if_the_mean_at_rest_is_uncertain():
    made = idle(9.0).matrix
    key = ("rest", "car")
    wide = replace(made.cells[key], fitness=made.cells["a", "car"].fitness - np.geomspace(0.01, 800.0, 10))
    few = replace(wide, fitness=made.cells["a", "car"].fitness - np.append(np.full(9, -0.1), 800.0))
    assert beats_rest(replace(made, cells={**made.cells, key: wide}), "a") is True
    assert beats_rest(replace(made, cells={**made.cells, key: few}), "a") is False


def test_as_good_as_rest_is_no_better_and_one_trial_goes_by_its_value():
    level = idle(9.5).matrix
    assert beats_rest(level, "a") is False
    assert beats_rest(replace(level, robot=None, other_robots=("car",)), "b") is False
    single = report(transfer=matrix({"a": {"a": 3.0, "b": 2.0}, "rest": {"a": 1.0, "b": 1.0}}, trials=1)).matrix
    assert beats_rest(single, "a") is True


def test_if_rest_was_not_run_on_the_robot_models_are_used():
    driven = idle(1.0).matrix
    not_run = {("rest", "car"): replace(driven.cell("rest", "car"), reason="not run")}
    assert beats_rest(replace(driven, cells={**driven.cells, **not_run}), "a") is True


def test_without_controls_at_rest_they_count_as_nothing_unless_fitness_is_negative():
    nothing, reached, below = (matrix({"a": {"a": value, "b": value}}) for value in (0.0, 3.0, -3.0))
    assert [beats_rest(one, "a") for one in (nothing, reached, below)] == [False, True, None]
    assert not none_beats_rest(below)


def test_a_forecast_for_where_there_are_no_data_comes_with_a_warning_and_no_praise():
    made = idle(1.0, None)
    card = replace(exploited(model="a"), controllers=("a",), outside=(("a", 0.37),), outside_held_out=0.02)
    elsewhere = replace(card, model="b", controllers=("b",), outside=(("a", 0.9),))
    guess = replace(made, exploitability=(card, elsewhere))
    found = headline(guess, "Which controller")
    assert found.tone == "warn"
    assert "37 % of its time is outside the data: its forecast is an extrapolation." in found.sentence
    assert "time spent outside the data: a (37 %)" in fitness_table(guess).note
    for share, normal, warned in ((0.05, 0.0, False), (0.37, 0.2, False), (0.61, 0.2, True), (0.61, 0.3, True)):
        other = replace(made, exploitability=(replace(card, outside=(("a", share),), outside_held_out=normal),))
        assert ("an extrapolation" in headline(other, "Which controller").sentence) == warned
    assert brief(guess)
