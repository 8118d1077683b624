"""Whole comparisons: what they compute, keep, find again and say. Most tests read the finished run of the session."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evaluation.cells.assessment import Run
from evaluation.experiment import Experiment, meaningful
from evaluation.planning import comparison_in
from evaluation.report.report import brief, to_json
from evaluation.run_folder import unneeded_files
from evaluation.running import compare, gather_results, report_of
from evaluation.transfer.summary import summarise
from hardware.robot import Robot
from sysid_evo.controllers.controller import make_controller
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidData, LinkLost
from sysid_evo.evolution.champion import load_champion
from sysid_evo.models import DynamicsModel
from sysid_evo.plan import Observer, Plan, Store, execute
from sysid_evo.registry import models, robots
from sysid_evo.tasks.task import make_task
from sysid_evo.testing import ExampleDynamics, example_dataset
from sysid_evo.testing.examples import switched_car
from tests.fixtures.session import without_figures
from tests.fixtures.systems import FloorCar, drive

pytestmark = pytest.mark.usefixtures("blank_figures")

SHORT = {
    "generations": 1, "trials": 2, "selection_trials": 2, "transfer_trials": 3, "traces": 0, "held_out": 0.3,
    "ensembles": (), "task": "point_to_point(horizon=40)", "strategy": "mu_plus_lambda(parents=2, children=2)",
}  # fmt: skip
NARX = "narx=narx(degree=1, terms=6, state_lags=0, control_lags=0)"
ASSESSED = {"assess exploitability", "advise on the models"}


class FailsInFit(DynamicsModel):
    """A family that cannot be fitted to anything."""

    def fit(self, dataset, *, rng, progress=None):
        raise InvalidData("this family never fits")

    def next_state(self, carry, control):
        return carry


class PredictsBadly(DynamicsModel):
    """A family that does not see how the robot moves: everything is at its limit."""

    def fit(self, dataset, *, rng, progress=None):
        return self

    def next_state(self, carry, control):
        return np.full_like(carry, 5.0)


class MadeUpRobot(Robot):
    """A robot that is emulated by a linear system."""

    name = "made_up_robot"

    def __init__(self):
        self.system = switched_car()
        self.dynamics = ExampleDynamics(self.system)

    def connect(self, *, seed=None):
        raise LinkLost("nobody is there")


@pytest.fixture(scope="module", autouse=True)
def _made_up_things(forgotten):
    models.register("fails_in_fit")(FailsInFit)
    models.register("predicts_badly")(PredictsBadly)
    robots.register("made_up_robot")(MadeUpRobot)


class Watching(Observer):
    """Keeps what the observer is told."""

    def __init__(self):
        self.finished = []

    def finish(self, cell, *, cached, reason):
        self.finished.append((cell.title, cached, reason))

    @property
    def computed(self):
        return {cell for cell, cached, _ in self.finished if not cached}


def run_in(folder, *names, observer=None, **changes):
    settings = meaningful({**SHORT, "models": names}, changes)
    return compare(example_dataset(), out=folder, observer=observer, jobs=1, **settings)


def planned_in(run, **changes):
    """Return the comparison in the folder of a run, with ``changes``."""
    return comparison_in(Experiment.of(meaningful(Experiment.read(run), changes)), run)[0]


def without_timings(report):
    found = report if isinstance(report, dict) else to_json(report)
    return {name: part for name, part in found.items() if name != "timings"}


def written(run):
    return without_timings(json.loads((run / "report.json").read_text()))


@pytest.fixture(scope="module")
def found(finished_run):
    """The report of the finished run, read without a word written."""
    return gather_results(planned_in(finished_run), Store(finished_run))


def test_another_seed_gives_another_controller(run_copy, found):
    (evolve,) = (cell for cell in planned_in(run_copy, seed=1).plan if cell.title == "evolve linear")
    store = Store(run_copy)
    execute(Plan.of([evolve]), store)
    assert not np.array_equal(store.load(evolve).parameters, found.matrix.champions[0].parameters)


def test_a_run_goes_on_where_it_was_and_a_report_is_made_of_plan_and_store_alone(run_copy, found):
    watching = Watching()
    execute(planned_in(run_copy).plan, Store(run_copy), observer=watching)
    assert watching.computed == set()
    before = written(run_copy)
    (run_copy / "report.json").unlink()
    again = report_of(planned_in(run_copy), Store(run_copy))
    assert without_timings(again) == without_timings(found)
    assert written(run_copy) == before


def test_a_result_that_disappears_is_computed_again_and_the_report_is_the_same(run_copy, found):
    comparison, watching = planned_in(run_copy), Watching()
    (champion,) = (cell for cell in comparison.plan if cell.title == "evolve linear")
    file = Path(f"{Store(run_copy).result_path(champion)}.safetensors")
    file.unlink()  # its content is that of the session's run, too
    file.write_bytes(b"damaged")
    next((run_copy / "results").glob("prediction-linear-*")).unlink()
    execute(comparison.plan, Store(run_copy), observer=watching)
    assert watching.computed == {"evolve linear", "predict with linear"}
    assert without_timings(report_of(comparison, Store(run_copy))) == without_timings(found)


def test_what_was_assessed_without_a_cell_is_assessed_again_when_the_cell_is_there(run_copy, found, monkeypatch):
    comparison, whole = planned_in(run_copy), Run.compute
    for cell in comparison.plan:
        if cell.title in {"run linear on near", *ASSESSED}:
            (run_copy / "cells" / f"{cell.digest}.json").unlink()

    def fails_once(run, work):
        if run.cell().title == "run linear on near":
            raise MemoryError("for a while")
        return whole(run, work)

    monkeypatch.setattr(Run, "compute", fails_once)
    execute(comparison.plan, Store(run_copy))
    assert without_timings(report_of(comparison, Store(run_copy))) != without_timings(found)
    monkeypatch.undo()
    watching = Watching()
    execute(comparison.plan, Store(run_copy), observer=watching)
    assert watching.computed == {"run linear on near", *ASSESSED}
    assert without_timings(report_of(comparison, Store(run_copy))) == without_timings(found)


def test_the_file_called_recommended_is_the_controller_to_take(finished_run, found):
    taken = {champion.name: champion for champion in found.matrix.champions}[found.transfer.pick]
    copied = load_champion(finished_run / "controllers" / "recommended")
    assert (copied.name, copied.against) == (taken.name, taken.against)
    assert np.array_equal(copied.parameters, taken.parameters)
    assert not [file for file in unneeded_files(finished_run) if "recommended" in file.name]


def test_the_robot_is_the_last_column_and_a_controller_written_by_hand_the_last_row(found):
    assert found.matrix.rows == ("linear", "near", "linear+near", "polished", "pursuit")
    assert found.matrix.columns == ("linear", "near", "emulated_car")
    assert found.matrix.robot == "emulated_car"
    assert summarise(found.matrix).controller("linear").achieved is not None
    cell = found.matrix.cell("pursuit", "linear")
    assert (cell.trials, cell.reason) == (100, "")


def test_prediction_alone_evolves_nothing(finished_run):
    alone = planned_in(finished_run, stop_after="prediction", ensembles=(), baselines=(), robot=None)
    assert alone.plan.of_kind("evolve") == ()
    report = gather_results(alone, Store(finished_run))
    assert report.matrix is None
    assert report.prediction.names == ("persistence", "linear", "near")


def test_a_result_is_found_under_another_label_and_carries_it(finished_run):
    names = {"models": ("new=linear", "near=nearest_neighbour"), "ensembles": ("new+near",)}
    found = gather_results(planned_in(finished_run, **names), Store(finished_run))
    assert found.matrix.rows[:3] == ("new", "near", "new+near")
    assert found.matrix.columns == ("new", "near", "emulated_car")
    assert found.matrix.champions[0].against == ("new",)
    assert found.matrix.cell("new", "new").trials == 100
    assert found.prediction.names == ("persistence", "new", "near")


def test_families_that_come_later_judge_and_one_that_predicts_badly_is_not_polished_on(tmp_path):
    run_in(tmp_path, "linear")
    watching = Watching()
    matrix = run_in(tmp_path, "linear", NARX, "predicts_badly", observer=watching).matrix
    computed = {title for title in watching.computed if "narx" not in title and "predicts_badly" not in title}
    judged_again = {"choose linear", "run linear on linear", "polish the best", "run polished on linear"}
    assert computed == judged_again | ASSESSED, "nothing is evolved or fitted again"
    champions = {champion.name: champion for champion in matrix.champions}
    assert set(champions["linear"].scoring_models) == {"linear", "narx", "predicts_badly"}
    assert set(champions["polished"].against) == {"linear", "narx"}


def test_a_family_that_fails_is_a_row_with_its_reason_and_the_rest_goes_on_without_judges_of_another_family(tmp_path):
    report = run_in(tmp_path, "fails_in_fit", "linear", "ridged=linear(ridge=0.1)", ensembles=["fails_in_fit+linear"])
    reasons = {failure.step: failure.reason for failure in report.all_failures}
    assert reasons["fit fails_in_fit"] == "this family never fits"
    assert {failure.step for failure in report.failures} == {"fit fails_in_fit"}  # what needed it is not told again
    assert report.matrix.rows == ("linear", "ridged", "polished")
    assert report.matrix.champions[-1].against == ("linear", "ridged"), "polished on those that could be fitted"
    assert all(champion.scoring_models == () for champion in report.matrix.champions)
    assert not report.matrix.cell("linear", "linear").failed
    assert report.matrix.cell("linear", "fails_in_fit").reason == "needs fit fails_in_fit, which failed"


def test_no_model_at_all_is_an_error_that_gives_the_reasons(tmp_path):
    with pytest.raises(InvalidData, match="no model could be fitted: fails_in_fit: this family never fits"):
        run_in(tmp_path, "fails_in_fit")


LABELLED = {
    "robot": "car-3=made_up_robot", "reference": True, "procedure": "plain", "traces": 2,
    "baselines": [
        "ahead=predictive(model=made_up_robot, horizon=3)", "one=predictive(model=linear, horizon=3)",
        "two=predictive(model=[linear, made_up_robot], horizon=3)",
    ],
}  # fmt: skip


@pytest.fixture(scope="module")
@without_figures()
def labelled(tmp_path_factory):
    """One model under two labels, a robot with a label and a controller evolved on it, models in controllers."""
    folder, watching = tmp_path_factory.mktemp("labelled"), Watching()
    return run_in(folder, "linear", "again=linear", observer=watching, **LABELLED), folder, watching


def test_what_is_the_same_under_two_labels_is_computed_once_and_two_rows_of_equal_numbers(labelled):
    report, _, watching = labelled
    assert watching.computed >= {"fit linear", "predict with linear", "evolve linear", "run linear on linear"}
    assert not [title for title in watching.computed if "again" in title]
    assert report.matrix.columns == ("linear", "again", "car-3")
    np.testing.assert_array_equal(
        report.matrix.cell("linear", "linear").fitness, report.matrix.cell("again", "linear").fitness
    )


def test_the_yardstick_is_a_controller_evolved_on_the_robot_itself(labelled):
    report, folder, _ = labelled
    assert report.matrix.rows == ("linear", "again", "car-3", "ahead", "one", "two")
    assert report.matrix.champions[2].against == ("car-3",)
    assert not report.matrix.cell("car-3", "linear").failed
    summary = summarise(report.matrix).controller("car-3")
    assert summary.evolved_on_robot
    assert summary.claimed == summary.achieved
    assert not report.failures
    assert "car-3" in (folder / "report.html").read_text()
    watching = Watching()
    again = run_in(folder, "linear", "again=linear", observer=watching, **LABELLED)
    assert ("evolve car-3", True, None) in watching.finished
    assert watching.computed == set()
    assert without_timings(again) == without_timings(report)


def test_a_model_of_the_comparison_stands_inside_a_controller_by_its_label(labelled):
    """One or several; the controller that is stored names their files, so that it can drive from anywhere."""
    report, folder, _ = labelled
    for row in ("ahead", "one", "two"):
        cell = report.matrix.cell(row, "linear")
        assert (cell.trials, cell.reason) == (3, "")
    for row in ("one", "two"):
        stored = load_champion(next((folder / "controllers").glob(f"{row}-*.json")))
        inside = stored.controller.parameters["model"]
        assert Path(inside if row == "one" else inside[0]).parent == (folder / "models").resolve()
        make_controller(stored.controller).bind_to(make_task(stored.task).bind(switched_car()))


def test_claims_are_measured_with_the_delay_of_evolution(run_copy):
    late = planned_in(run_copy, estimator_delay=0.2, procedure="plain", ensembles=(), baselines=(), robot=None)
    run = next(run for run in late.matrix.runs if run.title == "run near on near")
    assert run.settings.delay == 0.2
    prompt, store = replace(run.settings, delay=0.0).cell(), Store(run_copy)
    execute(Plan.of([run, prompt]), store)
    assert not np.array_equal(*(store.load(one).traces[0].trajectory.states for one in (run, prompt)))


def test_a_condition_left_out_is_predicted_worse_and_another_name_of_it_makes_other_data(tmp_path):
    cars = [(FloorCar(), "grip"), (FloorCar(1.5, 2.0), "ice")] * 2
    pieces = [
        replace(drive(car, seconds=20.0, seed=seed).episodes[0], condition=condition)
        for seed, (car, condition) in enumerate(cars)
    ]
    floors = Dataset(FloorCar().system, tuple(pieces))
    settings = {"models": ["linear"], "stop_after": "prediction", "leave_out": "condition", "jobs": 1}
    report = compare(floors, out=tmp_path, **settings)
    grip, ice = report.conditions["linear"]
    assert (grip.condition, ice.condition, grip.horizon) == ("grip", "ice", 20)
    assert all(one.across > 1.05 * one.within for one in (grip, ice))
    assert to_json(report)["prediction"]["conditions"]["linear"][0]["condition"] == "grip"
    assert "Error N across conditions" in (tmp_path / "report.html").read_text()
    assert len(brief(report)) == len(brief(replace(report, conditions={}))) + 3
    assert compare(floors, out=tmp_path, **settings).conditions == report.conditions
    renamed = floors.with_episodes([replace(e, condition=f"the {e.condition}") for e in floors])
    found = compare(renamed, out=tmp_path, **settings).conditions["linear"]
    assert [one.condition for one in found] == ["the grip", "the ice"]
