"""The main job on a small made-up car."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluation.cells.assessment import RunCell
from evaluation.cells.controllers import EvolveCell, HandWrittenCell
from evaluation.experiment import Experiment, meaningful
from evaluation.planning import plan_comparison
from evaluation.report import save_report, to_json
from evaluation.run_folder import unneeded_files
from evaluation.running import compare, report_of
from evaluation.transfer import summarise
from hardware.robot import Robot
from sysid_evo.controllers.controller import make_controller
from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleSystem, InvalidArgument, InvalidData, LinkLost, UnknownName
from sysid_evo.evolution.champion import load_champion
from sysid_evo.models import DynamicsModel, save_model
from sysid_evo.models.base import make_model
from sysid_evo.plan import Observer, Store, execute
from sysid_evo.registry import Spec, models, robots
from sysid_evo.tasks.task import make_task
from sysid_evo.testing import ExampleDynamics, example_dataset
from sysid_evo.testing.examples import pendulum, switched_car

SHORT: dict[str, Any] = {
    "generations": 2,
    "trials": 2,
    "selection_trials": 2,
    "transfer_trials": 3,
    "traces": 2,
    "held_back": 0.3,
    "ensembles": (),
    "task": "point_to_point(horizon=60)",
    "strategy": "mu_plus_lambda(children=5)",
}


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


class Swinging(MadeUpRobot):
    """A robot that is no car."""

    def __init__(self):
        self.system = pendulum()
        self.dynamics = ExampleDynamics(self.system)


@pytest.fixture(autouse=True)
def _made_up_things(register):
    register(models, "fails_in_fit", FailsInFit)
    register(models, "predicts_badly", PredictsBadly)
    register(robots, "made_up_robot", MadeUpRobot)
    register(robots, "swinging", Swinging)


class Watching(Observer):
    """Keeps what the observer is told."""

    def __init__(self):
        self.finished: list[tuple[str, bool, str | None]] = []

    def finish(self, cell, *, cached, reason):
        self.finished.append((cell.title, cached, reason))

    @property
    def computed(self):
        return {cell for cell, cached, _ in self.finished if not cached}


def planned(*names, **changes):
    asked = Experiment.of(meaningful({**SHORT, "models": names}, changes))
    return plan_comparison(asked, dataset=example_dataset())


def run_in(folder, *names, observer=None, **changes):
    settings = meaningful({**SHORT, "models": names}, changes)
    return compare(example_dataset(), out=folder, observer=observer, **settings)


def without_timings(report):
    found = to_json(report)
    del found["timings"]
    return found


def test_the_same_seed_gives_the_same_report_twice(tmp_path):
    chosen = ("linear", "nearest_neighbour")
    first, second = (
        run_in(tmp_path / name, *chosen, ensembles=["linear+nearest_neighbour"]) for name in ("first", "second")
    )
    assert without_timings(first) == without_timings(second)


def test_another_seed_gives_another_report(tmp_path):
    first, second = (run_in(tmp_path / str(seed), "linear", seed=seed) for seed in (0, 1))
    assert first.matrix is not None
    assert second.matrix is not None
    assert not np.array_equal(first.matrix.champions[0].parameters, second.matrix.champions[0].parameters)


def test_a_run_goes_on_where_it_was_and_gives_the_same_report(tmp_path):
    first = run_in(tmp_path, "linear")
    watching = Watching()
    again = run_in(tmp_path, "linear", observer=watching)
    assert watching.computed == set()
    assert without_timings(first) == without_timings(again)
    watching = Watching()
    run_in(tmp_path, "linear", "nearest_neighbour", observer=watching)
    judged_anew = {"choose linear", "run linear on linear", "polish the best", "run polished on linear"}
    computed = {title for title in watching.computed if "nearest_neighbour" not in title}
    assert computed == {
        "assess exploitability",
        "advise on the models",
        *judged_anew,
    }  # and nothing is evolved or fitted again


def test_a_family_that_fails_is_a_row_with_its_reason_and_the_rest_goes_on(tmp_path):
    report = run_in(tmp_path, "fails_in_fit", "linear", ensembles=["fails_in_fit+linear"])
    reasons = {failure.what: failure.reason for failure in report.all_failures}
    assert reasons["fit fails_in_fit"] == "this family never fits"
    assert {failure.what for failure in report.failures} == {"fit fails_in_fit"}  # what needed it is not told again
    assert report.matrix is not None
    assert report.matrix.rows == ("linear", "polished")  # polished on those that could be fitted
    assert report.matrix.champions[1].against == ("linear",)
    assert not report.matrix.cell("linear", "linear").failed
    assert report.matrix.cell("linear", "fails_in_fit").reason == "needs fit fails_in_fit, which failed"


def test_all_models_judge_finalists_but_one_that_predicts_badly_is_not_polished_on(tmp_path):
    near = "narx=narx(degree=1, terms=6, state_lags=0, control_lags=0)"
    matrix = run_in(tmp_path, "linear", near, "predicts_badly").matrix
    assert matrix is not None
    champions = {champion.name: champion for champion in matrix.champions}
    assert set(champions["linear"].judges) == {"linear", "narx", "predicts_badly"}
    assert set(champions["polished"].against) == {"linear", "narx"}


def test_the_file_called_recommended_is_the_controller_to_take(tmp_path):
    report = run_in(tmp_path, "linear", "narx=narx(degree=1, terms=6, state_lags=0, control_lags=0)")
    assert report.transfer is not None
    assert report.matrix is not None
    assert report.transfer.pick is not None
    taken = {champion.name: champion for champion in report.matrix.champions}[report.transfer.pick]
    copied = load_champion(tmp_path / "controllers" / "recommended")
    assert (copied.name, copied.against) == (taken.name, taken.against)
    assert np.array_equal(copied.parameters, taken.parameters)
    assert not [file for file in unneeded_files(tmp_path) if "recommended" in file.name]


def test_a_controller_without_a_model_of_another_family_has_no_judges(tmp_path):
    matrix = run_in(tmp_path, "linear", "ridged=linear(ridge=0.1)", "fails_in_fit").matrix
    assert matrix is not None
    assert all(champion.judges == () for champion in matrix.champions)


def test_no_model_at_all_is_an_error_that_gives_the_reasons(tmp_path):
    with pytest.raises(InvalidData, match="no model could be fitted: fails_in_fit: this family never fits"):
        run_in(tmp_path, "fails_in_fit")


def test_the_robot_is_the_last_column(tmp_path):
    report = run_in(tmp_path, "linear", robot="made_up_robot")
    assert report.matrix is not None
    assert report.matrix.columns == ("linear", "made_up_robot")
    assert report.matrix.robot == "made_up_robot"
    assert summarise(report.matrix).controller("linear").achieved is not None


def test_the_yardstick_is_a_controller_evolved_on_the_robot_itself(tmp_path):
    report = run_in(tmp_path, "linear", robot="car-3=made_up_robot", yardstick=True)
    assert report.matrix is not None
    assert report.matrix.rows == ("linear", "car-3")
    yardstick = report.matrix.champions[-1]
    assert yardstick.against == ("car-3",)
    assert not report.matrix.cell("car-3", "linear").failed
    summary = summarise(report.matrix).controller("car-3")
    assert summary.on_robot
    assert summary.claimed == summary.achieved
    assert not report.failures
    assert "car-3" in (tmp_path / "report.html").read_text()
    watching = Watching()
    again = run_in(tmp_path, "linear", robot="car-3=made_up_robot", yardstick=True, observer=watching)
    assert ("evolve car-3", True, None) in watching.finished
    assert without_timings(again) == without_timings(report)


def test_prediction_alone_evolves_nothing(tmp_path):
    report = run_in(tmp_path, "linear", only="prediction")
    assert report.matrix is None
    assert report.prediction is not None
    assert report.prediction.names == ("persistence", "linear")


def test_the_saved_report_is_strict_json_and_one_page(tmp_path):
    report = run_in(tmp_path / "run", "linear")
    document, page = save_report(report, tmp_path)
    assert json.loads(document.read_text())["timings"]
    assert "linear" in page.read_text()


def test_a_controller_written_by_hand_is_a_row_of_the_matrix(tmp_path):
    report = run_in(tmp_path, "linear", by_hand=["pursuit", "ahead=predictive(model=made_up_robot, horizon=3)"])
    assert report.matrix is not None
    assert report.matrix.rows[-2:] == ("pursuit", "ahead")
    for row in ("pursuit", "ahead"):
        cell = report.matrix.cell(row, "linear")
        assert (cell.trials, cell.reason) == (3, "")
    save_report(report, tmp_path)


def test_a_model_of_the_comparison_stands_inside_a_controller_by_its_label(tmp_path):
    """One or several; the controller that is stored names their files, so that it can drive from anywhere."""
    by_hand = ["one=predictive(model=linear, horizon=3)", "two=predictive(model=[linear, made_up_robot], horizon=3)"]
    report = run_in(tmp_path, "linear", by_hand=by_hand)
    assert report.matrix is not None
    for row in ("one", "two"):
        cell = report.matrix.cell(row, "linear")
        assert (cell.trials, cell.reason) == (3, "")
        stored = load_champion(next((tmp_path / "controllers").glob(f"{row}-*.json")))
        inside = stored.controller.parameters["model"]
        assert Path(inside if row == "one" else inside[0]).parent == (tmp_path / "models").resolve()
        make_controller(stored.controller).bind_to(make_task(stored.task).bind(switched_car()))
    fit = planned("linear").fits["linear"]
    cells = [HandWrittenCell(Spec("lqr", {"model": n}), Spec("set_point"), switched_car(), {n: fit}) for n in "ab"]
    assert cells[0].needs == (fit,)
    assert cells[0].digest == cells[1].digest, "a label is no part of a result"


def noises_met(**changes):
    """Return the noise of every evolution of a comparison with a yardstick, by the label of what it is evolved on."""
    plan = planned("linear", robot="made_up_robot", yardstick=True, **changes).plan
    return {cell.name: cell.settings.noise for cell in plan if isinstance(cell, EvolveCell)}


def test_where_a_target_is_to_be_kept_models_meet_some_noise_unless_none_is_asked_for():
    target = "set_point(channels=yaw_rate, low=-1, high=1)"
    assert noises_met(task=target) == {"linear": "envelope(process=0.02)", "made_up_robot": ""}
    assert set(noises_met(task=target, noise="none").values()) == {""}
    assert set(noises_met(task=target, noise="envelope(sensor=0.1)").values()) == {"envelope(sensor=0.1)"}
    assert set(noises_met().values()) == {""}


def test_a_row_by_hand_depends_on_what_is_in_the_files_that_it_names(tmp_path):
    file = save_model(make_model("linear").fit(example_dataset(), rng=0), tmp_path / "body")
    spec = Spec("predictive", {"model": str(file)})
    cells = [HandWrittenCell(spec, Spec("point_to_point"), switched_car()) for _ in range(3)]
    first, same = (cell.inputs() for cell in cells[:2])
    assert len(first["files"]) == 2
    file.write_text(file.read_text() + " ")
    assert first == same != cells[2].inputs()


def test_an_ensemble_in_two_orders_is_one():
    comparison = planned("linear", "near=nearest_neighbour", ensembles=("near+linear", "linear+near", "near + linear"))
    assert comparison.experiment.ensembles == ("near+linear",)
    assert len([cell for cell in comparison.plan.of_kind("evolve") if len(cell.members) > 1]) == 1  # type: ignore[attr-defined]


@pytest.mark.parametrize(("count", "title"), [(7, "a, b, c, d, e, f, g"), (8, "8 models")])
def test_a_report_is_called_after_its_models_if_they_are_few(count, title):
    comparison = planned(*(f"{label}=linear" for label in "abcdefgh"[:count]), only="prediction")
    assert comparison.title.endswith(f": {title}")


def test_what_is_the_same_under_two_labels_is_computed_once(tmp_path):
    watching = Watching()
    run_in(tmp_path, "linear", "again=linear", observer=watching, recipe="plain")
    assert watching.computed >= {"fit linear", "predict with linear", "evolve linear", "run linear on linear"}
    assert not [title for title in watching.computed if "again" in title]


def test_a_report_is_made_of_plan_and_store_alone(tmp_path):
    report = run_in(tmp_path, "linear")
    again = report_of(planned("linear"), Store(tmp_path))
    assert without_timings(again) == without_timings(report)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"ensembles": ("linear+parametrised",)}, InvalidArgument, "names parametrised, but the models are linear"),
        ({"ensembles": ("linear",)}, InvalidArgument, "expected two or more models joined by +"),
        ({"ensembles": ("linear+linear",)}, InvalidArgument, "names a model twice"),
        ({"models": ("linear", "linear")}, InvalidArgument, "'linear' is given 2 times"),
        ({"models": ()}, InvalidArgument, "expected at least one family"),
        ({"models": ("linear(rigde=1)",)}, InvalidArgument, "has no parameter 'rigde'. Did you mean 'ridge'?"),
        ({"task": "point_to_point(horizon=0)"}, InvalidArgument, "horizon"),
        ({"strategy": "mu_plus_lambda(parents=0)"}, InvalidArgument, "parents"),
        ({"controller": "recurrent(hidden=0)"}, InvalidArgument, "hidden"),
        ({"aggregate": "min(share=0.2)"}, InvalidArgument, "'min' has no parameter 'share'"),
        ({"by_hand": ("recurrent",)}, InvalidArgument, "'recurrent' must be evolved before it can drive"),
        ({"by_hand": ("predictive(model=liner)",)}, UnknownName, "the models compared are linear"),
        ({"by_hand": ("predictive(model=linear, horizon=0)",)}, InvalidArgument, "expected horizon"),
        ({"by_hand": ("pursuit", "pursuit")}, InvalidArgument, "'pursuit' is given 2 times"),
        ({"by_hand": ("linear=pursuit",)}, InvalidArgument, "another controller is called 'linear'"),
        ({"by_hand": ("pursuit",), "only": "fit"}, InvalidArgument, "by_hand has no effect with only = 'fit'"),
        ({"yardstick": True}, InvalidArgument, "name the emulated robot"),
        ({"yardstick": True, "only": "prediction", "robot": "made_up_robot"}, InvalidArgument, "only = 'prediction'"),
        ({"robot": "swinging"}, IncompatibleSystem, "robot 'swinging' is not the one in the recordings"),
        ({"robot": "made_up_robot(seed=1)"}, InvalidArgument, "'made_up_robot' has no parameter 'seed'"),
        ({"test": ("episode-7",)}, InvalidArgument, "episode-7"),
        ({"held_back": 0.0}, InvalidArgument, "held_back: expected a share above 0"),
    ],
)
def test_a_mistake_is_found_by_the_plan_and_nothing_is_written(tmp_path, changes, error, message):
    with pytest.raises(error) as told:
        compare(example_dataset(), out=tmp_path / "run", **meaningful({**SHORT, "models": ("linear",)}, changes))
    assert message in str(told.value)
    assert not (tmp_path / "run").exists()


def test_a_task_that_does_not_fit_the_system_is_found_by_the_plan():
    system = pendulum()
    rng = np.random.default_rng(0)
    data = Dataset.from_arrays(system, [rng.standard_normal((200, 2))], [rng.uniform(-1, 1, (199, 1))])
    with pytest.raises(IncompatibleSystem.__mro__[1], match="motion"):
        plan_comparison(Experiment.of({**SHORT, "models": ("linear",)}), dataset=data)


def test_a_setting_that_there_is_not_is_told_with_the_one_that_is_meant():
    with pytest.raises(InvalidArgument, match=r"genrations is no setting of an experiment; did you mean generations\?"):
        Experiment.of({"genrations": 3})
    with pytest.raises(InvalidArgument, match="preset: expected 'quick', 'standard' or 'paper', got 'slow'"):
        Experiment.of({"preset": "slow"})


def test_an_experiment_comes_back_from_its_file(tmp_path):
    settled = planned("near2=nearest_neighbour(state_lags=2)", "linear", ensembles=("near2+linear",)).experiment
    settled.write(tmp_path / "experiment.toml")
    assert Experiment.of(Experiment.read(tmp_path)) == settled
    assert settled.runs == 1  # what was left open is named


def test_a_result_that_disappears_is_computed_again_and_the_report_is_the_same(tmp_path):
    report = run_in(tmp_path, "linear")
    (champion,) = (tmp_path / "controllers").glob("*.safetensors")
    champion.write_bytes(b"damaged")
    next((tmp_path / "results").glob("prediction-linear-*")).unlink()
    watching = Watching()
    again = run_in(tmp_path, "linear", observer=watching)
    assert watching.computed == {"evolve linear", "predict with linear"}
    assert without_timings(again) == without_timings(report)


def test_what_was_assessed_without_a_cell_is_assessed_again_when_the_cell_is_there(tmp_path, monkeypatch):
    comparison = planned("linear", "nearest_neighbour")
    whole = RunCell.compute

    def fails_once(cell, work):
        if cell.title == "run linear on nearest_neighbour":
            raise MemoryError("for a while")
        return whole(cell, work)

    monkeypatch.setattr(RunCell, "compute", fails_once)
    execute(comparison.plan, Store(tmp_path))
    first = report_of(comparison, Store(tmp_path))
    monkeypatch.undo()
    watching = Watching()
    execute(comparison.plan, Store(tmp_path), observer=watching)
    assert watching.computed == {"run linear on nearest_neighbour", "assess exploitability", "advise on the models"}
    assert without_timings(report_of(comparison, Store(tmp_path))) != without_timings(first)
    fresh = Store(tmp_path / "fresh")
    execute(comparison.plan, fresh)
    assert without_timings(report_of(comparison, Store(tmp_path))) == without_timings(report_of(comparison, fresh))
