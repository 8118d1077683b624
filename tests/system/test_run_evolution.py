"""What is planned for one controller against members of a run, and what is reported of it."""

from dataclasses import replace

import pytest

from evaluation.experiment import Experiment
from evaluation.run_evolution import (
    EvolutionResult,
    driven_by,
    evolution_result,
    exploit_result,
    plan_evolution,
    plan_exploit,
)
from evaluation.transfer.forecast import Forecast
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.champion import load_champion
from sysid_evo.plan import Plan, Store, execute

SETTINGS = {
    "generations": 1, "polish_generations": 1, "trials": 2, "selection_trials": 2, "repeats": 1,
    "task": "point_to_point(horizon=40)", "strategy": "mu_plus_lambda(parents=2, children=2)",
}  # fmt: skip


def planned(folder, *members, **settings):
    return plan_evolution(Experiment.of(SETTINGS | settings), Store(folder), members)


def columns_of(cells):
    return [cell.settings.column.label for cell in cells]


@pytest.mark.parametrize(
    ("members", "claims", "elsewhere", "predictions"),
    [
        (["linear"], ["linear"], ["near"], 2),
        (["linear", "near"], ["linear", "near"], [], 2),
        (["emulated_car"], ["emulated_car"], [], 0),
        (["linear", "emulated_car"], ["linear", "emulated_car"], [], 0),
    ],
)
def test_claims_are_made_on_the_members_and_a_forecast_from_the_other_models(
    finished_run, members, claims, elsewhere, predictions
):
    found = planned(finished_run, *members, estimator_delay=0.1, seed=3, procedure="plain")
    assert columns_of(found.claims) == claims
    assert columns_of(found.elsewhere) == elsewhere
    runs = [cell.settings for cell in (*found.claims, *found.elsewhere)]
    assert {(run.delay, run.trials, run.traces, run.seed) for run in runs} == {(0.1, 100, 0, 3)}
    assert sum(cell.kind == "predict" for cell in found.plan.cells) == predictions


class Warned(Store):
    """A run in which the model near failed the sanity check."""

    def outcome(self, cell):
        found = super().outcome(cell)
        if cell.kind != "predict" or found.value.name != "near":
            return found
        return replace(found, value=replace(found.value, warning="near is worse than no change"))


def test_a_controller_is_forecast_from_at_least_two_models_and_recorded_where_it_leaves_the_data(run_copy):
    store, results = Store(run_copy), {}
    for members in (("linear",), ("emulated_car",)):
        plan = planned(run_copy, *members, noise="domain_randomisation(sensor=0.1)")
        execute(plan.plan, store)
        results[members] = evolution_result(plan, store)
        warned = evolution_result(plan, Warned(run_copy)).forecast
        assert (warned is None or warned.weights == results[members].forecast.weights) is (members != ("linear",))
    alone, on_robot = results.values()
    assert sorted(alone.forecast.weights) == ["linear", "near"]
    assert alone.unit == "waypoints"
    assert set(alone.claims) == {"linear"}
    assert alone.claims["linear"].fitness.size == 100
    assert alone.chosen == 1
    assert on_robot.forecast is None
    assert on_robot.forecast_sentence == ""
    assert on_robot.remarks == ()


@pytest.mark.parametrize(("chosen", "said"), [(0, False), (1, False), (2, True)])
def test_the_number_of_finalists_is_given_where_there_was_a_choice(chosen, said):
    forecast = Forecast("c", 3.0, 2.0, 4.0, {"a": 0.5, "b": 0.5})
    result = EvolutionResult({}, "waypoints", forecast, chosen, ())
    assert (f"{chosen} finalists" in result.forecast_sentence) is said
    assert "2 models" in result.forecast_sentence
    assert "3.0" in result.forecast_sentence


def test_what_a_stored_controller_drives_is_some_trials_in_each_of_its_models(finished_run):
    file = next(
        file
        for file in sorted((finished_run / "controllers").glob("*.json"))
        if load_champion(file).against == ("linear", "near")
    )
    champion = load_champion(file)
    driven = driven_by(file, champion.system)
    assert len(driven) == 2 * 10
    assert {len(trajectory.states) for trajectory in driven} == {41}


def test_a_controller_outside_a_run_has_no_models(finished_run, tmp_path):
    file = next((finished_run / "controllers").glob("*.json"))
    for suffix in (".json", ".safetensors"):
        (tmp_path / "mine.json").with_suffix(suffix).write_bytes(file.with_suffix(suffix).read_bytes())
    with pytest.raises(InvalidArgument, match="controllers/ of a run"):
        driven_by(tmp_path / "mine.json", load_champion(file).system)


def test_an_exploit_is_compared_with_models_of_other_families(finished_run):
    plan = plan_exploit(Experiment.of(SETTINGS), Store(finished_run), "linear")
    assert plan.target.label == "linear"
    assert [one.label for one in plan.others] == ["near"]


@pytest.mark.parametrize("robot", [None, "emulated_car"])
def test_the_exploit_of_a_model_is_run_on_all_others_and_on_the_robot(run_copy, robot):
    store = Store(run_copy)
    plan = plan_exploit(Experiment.of(SETTINGS), store, "linear")
    execute(Plan.of([plan.cell]), store)
    matrix, found = exploit_result(plan, store, seed=1, robot=robot)
    assert matrix.robot == robot
    assert list(matrix.columns) == ["linear", "near", *([robot] if robot else [])]
    assert found.model == "linear"


def test_finalists_are_scored_by_the_members_and_by_all_other_models(finished_run):
    assert [one.label for one in planned(finished_run, "linear").champion.settings.scoring_models] == ["linear", "near"]
