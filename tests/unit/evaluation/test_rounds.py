"""Rounds of recording: plan, claims against recorded episodes, the choice among all rounds, the report."""

from dataclasses import replace

import numpy as np
import pytest

from evaluation.cells.rounds import (
    ChooseRound,
    Round,
    RoundData,
    RoundsSoFar,
    continued,
    default_rounds,
    error_ahead,
    in_trials_of,
    record_until,
    search_horizon,
    searches,
)
from evaluation.experiment import Experiment
from evaluation.experiment import with_rounds as with_settings_of_rounds
from evaluation.planning import plan_comparison
from evaluation.report.render.html import page_of
from evaluation.report.report import brief, story_of
from evaluation.report.sections.controllers import fitness_table
from evaluation.report.sections.rounds import rounds_sentence, rounds_table
from evaluation.rounds import (
    RecordingRound,
    RoundsSummary,
    labels_to_search,
    reason_to_end,
    round_to_continue,
    rounds_to_try_again,
)
from evaluation.running import with_further_families
from sysid_evo.data import Dataset
from sysid_evo.engine import Rollouts
from sysid_evo.errors import DataWarning, InvalidArgument
from sysid_evo.evolution import ControllerEvolution
from sysid_evo.evolution.margins import with_horizon
from sysid_evo.plan import Store
from sysid_evo.registry import Spec, make_robot, robot_spec
from tests.fixtures.known_models import Known, fitted, recording
from tests.fixtures.reports import matrix, printed, report

ROBOT = 'gymnasium(id="CartPole-v1")'


def made(number, claimed, achieved, steps=None, controller="linear"):
    """Return a round with the fitness of its trials."""
    steps = np.full(len(achieved), 100) if steps is None else np.array(steps)
    parameters = np.full(5, float(number))
    return RecordingRound(number, controller, parameters, np.array(claimed), np.array(achieved), steps, {"a": 0.3})


def test_each_round_needs_the_one_before_and_the_models_need_the_last():
    planned = plan_comparison(Experiment(robot=ROBOT, rounds=3))
    rounds = [cell for cell in planned.plan if cell.kind == "round"]
    assert [cell.settings.number for cell in rounds] == [1, 2, 3]
    assert [needed.kind for cell in rounds for needed in cell.needs] == ["data", "round", "round"]
    assert isinstance(planned.data.settings, RoundData)
    assert all(fit.needs == (planned.data,) for fit in planned.fits.values())
    assert tuple(planned.fits) == ("gaussian_process", "mlp_ensemble")
    assert not any(fit.settings.spec.parameters["control_lags"] for fit in planned.fits.values())  # short episodes
    assert [cell.name for cell in planned.matrix.controllers] == ["rounds", "rest", "random"]
    assert planned.experiment.data_digest == rounds[0].needs[0].digest  # with it a run folder is planned again
    again = plan_comparison(planned.experiment, held=(rounds[0].needs[0], system()))
    assert [cell.digest for cell in again.plan] == [cell.digest for cell in planned.plan]


def system():
    return make_robot(robot_spec(ROBOT)).system


def test_no_further_family_is_tried_in_rounds_whose_models_are_fitted_again(tmp_path):
    comparison = plan_comparison(Experiment(robot="pendulum", rounds=2))
    assert with_further_families(comparison, Store(tmp_path), pytest.fail) is comparison


def test_one_round_is_the_usual_comparison():
    one, usual = (
        plan_comparison(Experiment(models=("linear",), reference=False, rounds=rounds)) for rounds in (1, None)
    )
    assert [cell.digest for cell in one.plan] == [cell.digest for cell in usual.plan]
    assert not usual.plan.of_kind("round")


def test_given_settings_replace_those_of_rounds():
    asked = Experiment(robot=ROBOT, rounds=2, models=("linear",), controller="feed_forward", minutes=2.0, max_steps=500)
    round_, *_ = plan_comparison(asked).plan.of_kind("round")
    settings = round_.settings
    assert (str(settings.evolution.controller), settings.max_steps) == ("feed_forward", 500)
    assert (settings.evolution.generations, [spec.label for spec in settings.specs]) == (80, ["linear"])
    assert (settings.data.settings.minutes, settings.noisy_share) == (2.0, 1.0)
    longer, *_ = plan_comparison(asked.model_copy(update={"robot": 'gymnasium(id="Pendulum-v1")'})).plan.of_kind(
        "round"
    )
    evolution = longer.settings.evolution
    assert (str(evolution.controller), evolution.generations, longer.settings.noisy_share) == (
        "feed_forward",
        250,
        0.5,
    )


def test_a_robot_whose_trials_last_gets_a_network_and_episodes_without_noise():
    round_, *_ = plan_comparison(Experiment(robot='gymnasium(id="Pendulum-v1")', rounds=2)).plan.of_kind("round")
    settings = round_.settings
    assert (settings.evolution.controller.text, settings.noisy_share) == ("feed_forward(hidden=16)", 0.5)
    assert [spec.label for spec in settings.specs] == ["mlp_ensemble", "narx"]


def test_a_robot_that_moves_gets_two_networks_and_noise_unless_they_are_given():
    body = make_robot(robot_spec("emulated_car")).system
    found = with_settings_of_rounds(Experiment(), body, early=False)
    assert len(found.models) == 2
    assert found.noise.startswith("domain_randomisation")
    assert found.searched == ("mlp_ensemble",)
    given = with_settings_of_rounds(Experiment(noise="none", models=("linear",)), body, early=False)
    assert (given.noise, given.models, given.searched) == ("none", ("linear",), None)
    assert with_settings_of_rounds(Experiment(), body, early=True).noise is None


def test_rounds_search_in_the_named_models_alone():
    asked = Experiment(robot=ROBOT, rounds=2, models=("linear", "narx"), searched=("narx",))
    planned = plan_comparison(asked)
    round_, *_ = planned.plan.of_kind("round")
    assert [spec.label for spec in round_.settings.specs] == ["narx"]
    assert tuple(planned.fits) == ("linear", "narx")
    with pytest.raises(InvalidArgument, match="searched: expected some of the models linear, narx, got narx, other"):
        plan_comparison(asked.model_copy(update={"searched": ("narx", "other")}))


def test_a_planar_simulator_is_recorded_in_rounds(monkeypatch):
    pytest.importorskip("vehiclemodels")
    monkeypatch.setattr("evaluation.cells.rounds.RECORDING_SECONDS", np.inf)  # a busy machine is slower
    assert default_rounds(Experiment(), robot_spec("drift_car")) == 10


def test_the_start_of_the_best_round_comes_first_and_continues_from_it():
    starts = "start(controller=feed_forward), start(controller=linear)"
    evolution = ControllerEvolution(starts=starts)
    best = made(1, [1.0] * 2, [1.0] * 2, controller="linear")
    assert [one.controller.text for one in continued(evolution, best).starts] == ["linear", "feed_forward"]
    assert continued(evolution, None) is evolution


def test_a_run_that_only_continues_has_a_tenth_of_its_sigma_and_one_from_the_beginning_all_of_it():
    best, wide = made(1, [1.0] * 2, [1.0] * 2), "cma_es(sigma=0.3)"
    alone = continued(ControllerEvolution(strategy=wide), best)
    assert alone.strategy.parameters["sigma"] == pytest.approx(0.03)
    assert continued(ControllerEvolution(strategy=wide, repeats=2), best).strategy.text == wide
    assert continued(ControllerEvolution(strategy="niches"), best).strategy.text == "niches"
    both = f"start(controller=feed_forward, strategy={wide}), start(controller=linear, strategy={wide})"
    sigmas = [one.strategy.parameters["sigma"] for one in continued(ControllerEvolution(starts=both), best).starts]
    assert sigmas == pytest.approx([0.03, 0.3])


def test_trials_of_the_evolution_with_fewer_steps_get_more_generations():
    task, evolution = Spec.parse('environment(id="CartPole-v1")'), ControllerEvolution(generations=50)
    for horizon, generations in ((50, 120), (120, 50), (160, 37), (500, 25)):
        found = in_trials_of(evolution, task, horizon)
        assert (found.task.parameters["horizon"], found.generations) == (horizon, generations)


def test_the_evolution_looks_beyond_the_end_of_the_best_judged_episodes():
    assert search_horizon([], 1000) == 120
    assert search_horizon([], 50) == 50
    low, level, ends = made(1, [0.0] * 3, [0.0] * 3, steps=[9, 9, 9]), [1.0] * 3, [350, 400, 300]
    assert search_horizon([made(2, level, level, steps=ends), low], 1000) == 420
    assert search_horizon([low, made(2, level, level, steps=[5, 5, *ends])], 1000) == 420  # two are not judged
    assert search_horizon([low, made(2, level, level, steps=ends)], 400) == 400
    assert search_horizon([low, made(2, level, level, steps=[30, 40, 20])], 1000) == 120
    assert search_horizon([made(2, level, level, steps=[50, 50, 60]), low], 1000, 400) == 400


def test_the_evolution_looks_no_farther_where_nothing_ends_episodes():
    whole = made(1, [1.0] * 3, [1.0] * 3, steps=[1000] * 3)
    assert search_horizon([whole], 1000) == 120
    assert search_horizon([whole, made(2, [0.0] * 3, [0.0] * 3, steps=[1000, 700, 1000])], 1000) == 1000


def test_evolutions_with_trials_of_more_than_240_steps_count_as_several():
    level, falls = [1.0] * 3, made(1, [0.0] * 3, [0.0] * 3, steps=[50, 60, 70])
    lasts = made(2, level, level, steps=[390, 410, 400])
    assert searches([], 1000) == 1.0
    assert searches([falls], 1000) == 2.0
    assert searches([falls, lasts], 1000) == 4.0  # 480 steps
    assert searches([falls, lasts, falls], 1000) == 6.0
    assert searches([falls, falls], 480, 480) == 6.0


@pytest.mark.parametrize(("lasts", "fewest", "episodes"), [(30, 3, 10), (150, 3, 7), (400, 3, 3), (1000, 4, 4)])
def test_the_longer_a_controller_lasts_the_fewer_episodes_are_recorded(lasts, fewest, episodes):
    began = []

    def drive(parameters, seeds, *, record):
        began.extend(seeds)
        return Rollouts(
            fitness=np.ones((1, 1)), survived=np.full((1, 1), lasts), clipped=None, task_state=None, engine=""
        )

    driven = record_until(drive, np.zeros(2), np.arange(10), 1000, fewest)
    assert len(driven) == episodes
    np.testing.assert_array_equal(began, np.arange(episodes))


@pytest.mark.parametrize(("robot", "longer"), [("emulated_car", True), ("cart_pole", False)])
def test_the_planned_time_of_a_round_follows_the_trials_of_a_robot_that_moves(robot, longer):
    planned, *_ = plan_comparison(Experiment(robot=robot, rounds=2)).plan.of_kind("round")
    evolution = planned.settings.evolution
    task = with_horizon(evolution.task, 100_000)
    long = replace(planned.settings, evolution=replace(evolution, task=task)).cell()
    assert (long.expected_seconds > 2.0 * planned.expected_seconds) == longer


def test_rounds_need_a_robot_that_is_a_program():
    with pytest.raises(InvalidArgument, match="rounds: expected a robot that is a program"):
        plan_comparison(Experiment(rounds=2, models=("linear",)), dataset=recording(3, steps=400))


def test_a_claim_holds_up_to_a_tenth_and_two_standard_errors():
    claim = np.full(4, 10.0)
    assert made(1, claim, [9.1] * 4).holds
    assert not made(1, claim, [8.9] * 4).holds
    assert made(1, claim, [6.0, 12.0, 6.0, 12.0]).holds  # its standard error is 1.7
    assert not made(1, -claim, [-11.2] * 4).holds


def test_rounds_end_if_two_claims_were_exact_without_a_gain_in_whole_episodes():
    claim, level = np.full(4, 10.0), [10.0] * 4
    first, same = made(1, claim, level), made(2, claim, level)
    assert reason_to_end([first], same, 100)
    assert not reason_to_end([], same, 100)  # a single round
    assert not reason_to_end([first], made(2, claim, [12.0] * 4), 100)  # a gain
    assert not reason_to_end([first], made(2, claim, [5.0] * 4), 100)  # a claim that does not hold
    assert not reason_to_end([made(1, claim, [5.0] * 4)], same, 100)
    assert not reason_to_end([first], made(2, 0.8 * claim, level), 100)  # a claim that is exceeded
    falls = made(2, claim, level, steps=[20, 30, 20, 100])
    assert reason_to_end([first], falls, 100)  # its models predict it, with an error of 0.3
    assert not reason_to_end([first], replace(falls, errors={"a": 2.0}), 100)
    assert not reason_to_end([first], replace(same, steps=np.full(8, 100)), 100)  # half of its episodes have noise


def test_rounds_go_on_though_the_last_ones_were_worse():
    rounds = [made(number, [9.0] * 4, [level] * 4) for number, level in enumerate((9, 3, 2, 3, 4, 5, 6, 5), 1)]
    assert not any(reason_to_end(rounds[:count], rounds[count], 100) for count in range(len(rounds)))


def test_a_model_that_is_worse_than_a_constant_is_left_out_of_the_next_evolution_if_another_one_predicts():
    one = made(1, [1.0] * 2, [1.0] * 2)
    known, none = replace(one, errors={"a": 1.1, "b": 0.4, "c": 0.9}), replace(one, errors={"a": 1.1, "b": 0.6})
    assert labels_to_search([], ("a", "b")) == ["a", "b"]
    assert labels_to_search([none, known], ("a", "b", "c")) == ["b", "c"]
    assert labels_to_search([known, none], ("a", "b")) == ["a", "b"]


def test_the_next_round_continues_from_the_last_one_that_is_no_worse_than_the_best():
    spread = np.array([-1.0, 0.0, 1.0])  # a standard error of 0.58
    best, near, worse = (made(number, spread, spread + level) for number, level in ((1, 5.0), (2, 4.5), (3, 4.3)))
    assert round_to_continue([]) is None
    assert round_to_continue([best]) is best
    assert round_to_continue([best, near]) is near
    assert round_to_continue([best, near, worse]) is near
    assert round_to_continue([near, best, worse]) is best


class Work:
    """The context of a cell with fixed results of those that it needs."""

    def __init__(self, *results):
        self._results = list(results)
        self.progress = None

    def result(self, cell):
        return self._results[cell]


def test_after_the_end_a_round_changes_nothing_and_without_steps_left_there_is_none():
    data = Dataset.from_arrays(system(), [np.zeros((81, 4))], [np.zeros((80, 1))])
    first = RoundsSoFar(data, RoundsSummary(first=900, first_episode=80))
    planned, *_ = plan_comparison(Experiment(robot=ROBOT, rounds=2, max_steps=1000)).plan.of_kind("round")
    over = replace(first, summary=replace(first.summary, ended="it ended"))
    step = replace(planned.settings, previous=0)
    assert step.compute(Work(over)) is over
    for recorded in (900, 500):  # 6 whole episodes of 50 steps are kept to try the best again
        spent = step.compute(Work(replace(first, summary=replace(first.summary, first=recorded)))).summary
        assert (spent.rounds, spent.ended) == ((), "1000 recorded steps are the most")


def test_no_steps_are_kept_where_judged_episodes_have_no_noise():
    """400 steps are left: enough for three judged episodes of 50 steps and others, but not for six more."""
    data = Dataset.from_arrays(system(), [np.zeros((81, 4))], [np.zeros((80, 1))])
    planned, *_ = plan_comparison(Experiment(robot=ROBOT, rounds=2, max_steps=1000)).plan.of_kind("round")
    begun = RoundsSoFar(data, RoundsSummary(first=600, first_episode=80))
    noisy = replace(planned.settings, previous=0)
    assert noisy.compute(Work(begun)).summary.ended
    with pytest.raises(DataWarning, match="in which no state changes"):  # the round is made, with this recording
        replace(noisy, noisy_share=0.5).compute(Work(begun))


def test_a_model_that_is_right_has_no_error_ahead():
    data, model = recording(2, steps=80), fitted(Known())
    assert error_ahead(model, data, data.episodes) < 1e-6
    short = Dataset(
        data.system,
        (replace(data.episodes[0], states=data.episodes[0].states[:4], controls=data.episodes[0].controls[:3]),),
    )
    assert error_ahead(model, data, short.episodes) < 1e-6


ROUNDS = (made(1, [30.0] * 3, [8.0, 9.0, 10.0]), made(2, [20.0] * 3, [20.0] * 3), made(3, [40.0] * 3, [12.0] * 3))


def with_rounds(summary):
    return replace(report(transfer=matrix({"rounds": {"a": 9.0, "b": 9.0, "car": 8.0}}, robot="car")), rounds=summary)


def test_the_report_has_a_row_for_each_round_and_says_why_there_are_no_more():
    ended, rest = "1900 recorded steps are the most", np.array([3.0, 4.0])
    rounds = (ROUNDS[0], replace(ROUNDS[1], again=np.array([13.0, 15.0])), ROUNDS[2])
    shown = with_rounds(RoundsSummary(1600, 7, rounds, ended, rest))
    table = rounds_table(shown)
    assert [row[0] for row in table.rows] == ["first", "1", "2", "3", "rest"]
    assert [row[1] for row in table.rows] == ["1600", "1900", "2200", "2500", "–"]
    assert table.rows[-1][4] == "3.50"
    assert table.rows[2][3:] == ("20.0", "20.0\nagain 14.0", "a 0.300")
    sentence = rounds_sentence(shown)
    assert sentence.startswith("Half of the episodes of the first recording end within 7 steps")
    assert sentence.endswith("claims that held: round 2; no further round: 1900 recorded steps are the most.")
    assert "stabilise" not in rounds_sentence(with_rounds(RoundsSummary(1600, 200, ROUNDS)))
    assert "Rounds of recording" in "\n".join(printed(brief(shown)))
    assert "Rounds of recording" in page_of(story_of(shown))
    assert rounds_table(report()) is None
    assert "Rows are in the order of the forecast. Claimed" in fitness_table(shown).note  # recordings decide, too
    assert "forecast, the only figure by which" in fitness_table(replace(shown, rounds=None)).note


def test_a_baseline_is_chosen_only_if_controls_at_rest_achieved_more_than_the_controllers_tried_again():
    rows = {"rounds": {"a": -20.0, "b": -21.0}, "rest": {"a": -12.0, "b": -12.0}}
    found = report(transfer=matrix(rows, against={"rounds": ("a", "b")}))
    assert found.transfer.pick == "rest"
    lucky = replace(made(1, [-20.0] * 2, [-2.0, -3.0]), again=np.array([-8.0, -7.0]))
    others = made(2, [-20.0] * 2, [-4.0, -4.0])  # it was not tried again
    for rest, pick in (([-9.0, -8.0], "rounds"), ([-5.0, -5.0], "rest")):
        summary = RoundsSummary(100, 50, (lucky, others), rest=np.array(rest))
        assert replace(found, rounds=summary).transfer.pick == pick
    assert replace(found, rounds=RoundsSummary(first=100, first_episode=50)).transfer.pick == "rest"


def test_the_forecast_of_rounds_and_of_rest_is_their_mean_in_whole_episodes_tried_again():
    rows = {"rounds": {"a": -20.0, "b": -21.0}, "random": {"a": 5.0, "b": 5.0}, "rest": {"a": -12.0, "b": -12.0}}
    found = report(transfer=matrix(rows, against={"rounds": ("a", "b")}))
    first, *others = found.matrix.champions
    assert first.name == "rounds"
    of_first_round = replace(first, parameters=np.full(5, 1.0))
    found = replace(found, matrix=replace(found.matrix, champions=(of_first_round, *others)))
    chosen = replace(made(1, [-20.0] * 2, [-3.0, -7.0]), again=np.array([-8.0, -7.0, -6.0]))
    rounds = (chosen, made(2, [0.0] * 2, [0.0] * 2))
    summary = RoundsSummary(100, 50, rounds, rest=np.full(3, -9.0), whole=True)
    known = replace(found, rounds=summary).forecasts
    half = 2.920 * np.sqrt(8.0) / np.sqrt(3.0)  # the spread of the judged episodes is the larger one
    own = known["rounds"]
    assert (own.low, own.value, own.high) == pytest.approx((-7.0 - half, -7.0, -7.0 + half), abs=1e-2)
    assert (known["rest"].low, known["rest"].value) == (-9.0, -9.0)
    assert known["random"] == found.forecasts["random"]
    assert replace(found, rounds=replace(summary, whole=False)).forecasts == found.forecasts  # other trials
    not_again = replace(summary, rounds=(replace(chosen, again=None),))
    assert replace(found, rounds=not_again).forecasts["rounds"] == found.forecasts["rounds"]


def test_those_are_tried_again_that_may_be_the_best_the_latest_of_equals_first():
    spread = np.array([-2.0, 0.0, 2.0])  # a standard error of 1.15, of a difference 1.63
    means = (9.0, 7.0, 10.0, 10.0, 6.5)
    rounds = [made(number, spread, spread + level) for number, level in enumerate(means, 1)]
    assert [one.number for one in rounds_to_try_again(rounds)] == [4, 3, 1, 2]  # the fifth is 3.5 below
    assert [one.number for one in rounds_to_try_again([*rounds, made(6, spread, spread + 10.0)])] == [6, 4, 3, 1]
    assert [
        one.number for one in rounds_to_try_again([made(1, [9.0] * 2, [9.0] * 2), made(2, [8.0] * 2, [8.0] * 2)])
    ] == [1]


@pytest.mark.parametrize(
    ("left", "better", "first", "second"),
    [
        (9000, 2.0, 20, 20),
        (4000, 2.0, 20, 16),
        (2000, 2.0, 10, 6),
        (2000, 1.0, 6, 10),
        (1600, 1.0, 12, 0),
        (1400, 2.0, 0, 0),
    ],
)
def test_the_steps_left_decide_how_many_controllers_are_tried_again_and_the_worst_is_left_out(
    left, better, first, second
):
    planned, *_ = plan_comparison(Experiment(robot=ROBOT, rounds=2, max_steps=10_000)).plan.of_kind("round")
    driven = {0.0: [], 1.0: [], 2.0: []}  # at rest, the first and the second round

    class Cart:
        def runner(self, work, *, delay):
            return self

        def bind(self, law, task):
            def drive(parameters, trials):
                which = float(parameters[0, 0]) if parameters.size else 0.0
                driven[which] += trials.tolist()
                lasts = np.full((1, len(trials)), 100)
                fitness = lasts / 10.0 + (1.0 if which == better else 0.0)
                return Rollouts(fitness=fitness, survived=lasts, clipped=None, task_state=None, engine="")

            return drive

    settings = replace(planned.settings, robot=Cart(), max_steps=10_000)
    rounds = (made(1, [9.0] * 2, [9.0] * 2), made(2, [9.0] * 2, [9.0] * 2))  # two episodes of 100 steps each
    summary = RoundsSummary(10_000 - 400 - left, 80, rounds)
    found = settings.tried_again(summary, None, system(), Spec.parse('environment(id="CartPole-v1")'))
    assert (len(driven[2.0]), len(driven[1.0])) == (first, second)
    assert [one.again is not None for one in found.rounds] == [second > 0, first > 0]
    assert found.steps_again == (first + second) * 100
    episodes = max(first, second, 3)
    assert driven[0.0][: min(first, second)] == driven[1.0][: min(first, second)]  # in the same trials
    assert found.rest.tolist() == [10.0] * episodes
    assert found.steps <= 10_000
    assert found.whole


def test_the_controller_with_the_highest_recorded_fitness_is_chosen_among_all_rounds():
    planned = plan_comparison(Experiment(robot=ROBOT, rounds=2, models=("linear",)))
    cell = planned.matrix.controllers[0]
    assert isinstance(cell.settings, ChooseRound)
    assert isinstance(cell.settings.last.settings, Round)
    found = RoundsSoFar(
        Dataset.from_arrays(system(), [np.zeros((3, 4))], [np.zeros((2, 1))]), RoundsSummary(9, 9, ROUNDS)
    )
    chosen = replace(cell.settings, members=()).compute(Everything(found))
    assert (chosen.parameters[0], chosen.controller.text) == (2.0, "linear")
    assert [(one.behaviour_class, one.fitness, one.forecast) for one in chosen.finalists] == [
        ("round 1", 30.0, 9.0), ("round 2", 20.0, 20.0), ("round 3", 40.0, 12.0),
    ]  # fmt: skip
    again = [replace(one, again=np.full(3, level)) for one, level in zip(ROUNDS[1:], (9.0, 10.0), strict=True)]
    retried = replace(found, summary=replace(found.summary, rounds=(ROUNDS[0], *again)))
    assert replace(cell.settings, members=()).compute(Everything(retried)).parameters[0] == 3.0  # not by chance
    others = replace(
        found, summary=replace(found.summary, rounds=(replace(ROUNDS[0], controller="feed_forward"), *ROUNDS[1:]))
    )
    of_its_kind = replace(cell.settings, members=()).compute(Everything(others)).finalists
    assert [one.behaviour_class for one in of_its_kind] == ["round 2", "round 3"]


class Everything(Work):
    """The same result for every cell."""

    def result(self, cell):
        return self._results[0]


@pytest.mark.parametrize(
    ("settings", "rounds"),
    [
        ({"robot": 'gymnasium(id="CartPole-v1")'}, 16),
        ({"robot": 'gymnasium(id="CartPole-v1")', "rounds": 1}, 1),
        ({"robot": 'gymnasium(id="CartPole-v1")', "models": ("linear",)}, None),
        ({"robot": 'gymnasium(id="CartPole-v1")', "controller": "feed_forward"}, None),
        ({"robot": 'gymnasium(id="CartPole-v1")', "generations": 20}, None),
        ({"robot": 'gymnasium(id="CartPole-v1")', "stop_after": "prediction"}, None),
        (
            {"robot": 'gymnasium(id="CartPole-v1")', "task": 'environment(id="CartPole-v1", horizon=8)'},
            None,
        ),
        ({"robot": 'gymnasium(id="Pendulum-v1")'}, None),  # its reward is known
        ({"robot": 'gymnasium(id="Reacher-v5")'}, 16),  # its reward is learned
        ({"robot": 'gymnasium(id="Reacher-v5")', "max_steps": 10_000_000}, None),  # an hour of steps
        ({"robot": "cart_pole", "task": "balance"}, None),
    ],
)
def test_a_program_whose_trials_end_early_or_whose_reward_is_learned_is_recorded_in_rounds(settings, rounds):
    assert plan_comparison(Experiment(**settings)).experiment.rounds == rounds
