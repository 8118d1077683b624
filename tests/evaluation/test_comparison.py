"""The main job on a small made-up car."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sysid_evo.experiment import Silent

from evaluation.comparison import ComparisonSettings, compare
from evaluation.report import Report, save_report, to_json
from evaluation.transfer import summarise
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.engine import DynamicsRunner
from sysid_evo.errors import InvalidArgument, InvalidData
from sysid_evo.evolution import ControllerEvolution
from sysid_evo.registry import Registry, models
from sysid_evo.store import RunFolder
from sysid_evo.testing import example_dataset

SHORT = ControllerEvolution(
    generations=2, trials=2, selection_trials=2, task_parameters={"horizon": 60}, strategy_parameters={"children": 5}
)


class FailsInFit(DynamicsModel):
    """A family that cannot be fitted to anything."""

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: object = None) -> FailsInFit:
        raise InvalidData("this family never fits")

    def next_state(self, carry: np.ndarray, control: np.ndarray) -> np.ndarray:
        return carry


@pytest.fixture(autouse=True)
def _a_family_that_fails(register: Callable[[Registry[Any], str, Any], Any]) -> None:
    register(models, "fails_in_fit", FailsInFit)


class Watching(Silent):
    """Keeps what the observer is told."""

    def __init__(self) -> None:
        self.finished: list[tuple[str, bool, str | None]] = []

    def finish(self, cell: str, *, cached: bool, reason: str | None) -> None:
        self.finished.append((cell, cached, reason))


def settings(*models: str, **changes: object) -> ComparisonSettings:
    return ComparisonSettings(models=models, evolution=SHORT, transfer_trials=3, traces=2, **changes)  # type: ignore[arg-type]


def run_in(folder: Path, chosen: ComparisonSettings, observer: Silent | None = None) -> Report:
    training, test = example_dataset().split(0.3)
    run = RunFolder.open(folder, chosen.to_dict())
    return compare(run, training, test, chosen, observer=observer or Silent())


def without_timings(report: Report) -> dict[str, object]:
    found = to_json(report)
    del found["timings"]
    return found


def test_the_same_seed_gives_the_same_report_twice(tmp_path: Path) -> None:
    chosen = settings("linear", "nearest_neighbour", ensembles=(("linear", "nearest_neighbour"),))
    first, second = (run_in(tmp_path / name, chosen) for name in ("first", "second"))
    assert without_timings(first) == without_timings(second)


def test_another_seed_gives_another_report(tmp_path: Path) -> None:
    first, second = (run_in(tmp_path / str(seed), settings("linear", seed=seed)) for seed in (0, 1))
    assert first.matrix is not None
    assert second.matrix is not None
    assert not np.array_equal(first.matrix.champions[0].parameters, second.matrix.champions[0].parameters)


def test_a_run_goes_on_where_it_was_and_gives_the_same_report(tmp_path: Path) -> None:
    chosen = settings("linear", "nearest_neighbour")
    first = run_in(tmp_path, chosen)
    watching = Watching()
    again = run_in(tmp_path, chosen, watching)
    assert {cell for cell, cached, _ in watching.finished if not cached} == {"prediction"}
    assert without_timings(first) == without_timings(again)


def test_a_family_that_fails_is_a_row_with_its_reason_and_the_rest_goes_on(tmp_path: Path) -> None:
    chosen = settings("fails_in_fit", "linear", ensembles=(("fails_in_fit", "linear"),))
    report = run_in(tmp_path, chosen)
    reasons = {failure.what: failure.reason for failure in report.all_failures}
    assert reasons["fit fails_in_fit"] == "this family never fits"
    assert "no model fails_in_fit to evolve against" in reasons["evolve fails_in_fit"]
    assert "evolve fails_in_fit+linear" in reasons
    assert report.matrix is not None
    assert report.matrix.rows == ("linear",)
    assert not report.matrix.cell("linear", "linear").failed


def test_no_model_at_all_is_an_error_that_gives_the_reasons(tmp_path: Path) -> None:
    with pytest.raises(InvalidData, match="no model could be fitted: fails_in_fit: this family never fits"):
        run_in(tmp_path, settings("fails_in_fit"))


def test_an_ensemble_of_unknown_members_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="an ensemble names parametrised, but the models are linear"):
        settings("linear", ensembles=(("linear", "parametrised"),))


def test_the_robot_is_the_last_column(tmp_path: Path) -> None:
    training, test = example_dataset().split(0.3)
    chosen = settings("linear")
    robot = DynamicsRunner(FittedElsewhere().fit(training, rng=np.random.default_rng(0)))
    run = RunFolder.open(tmp_path, chosen.to_dict())
    report = compare(run, training, test, chosen, observer=Silent(), robot=("car", robot))
    assert report.matrix is not None
    assert report.matrix.columns == ("linear", "car")
    assert report.matrix.robot == "car"


def test_the_yardstick_is_a_controller_evolved_on_the_robot_itself(tmp_path: Path) -> None:
    training, test = example_dataset().split(0.3)
    chosen = settings("linear", yardstick=True)
    robot = DynamicsRunner(FittedElsewhere().fit(training, rng=np.random.default_rng(0)))
    run = RunFolder.open(tmp_path, chosen.to_dict())
    report = compare(run, training, test, chosen, observer=Silent(), robot=("car:3", robot))
    assert report.matrix is not None
    assert report.matrix.rows == ("linear", "car:3")
    yardstick = report.matrix.champions[-1]
    assert yardstick.against == ("car:3",)
    assert not report.matrix.cell("car:3", "linear").failed
    summary = summarise(report.matrix).controller("car:3")
    assert summary.on_robot
    assert summary.claimed == summary.achieved
    assert not report.failures
    _, page = save_report(report, tmp_path)
    assert "car:3" in page.read_text()
    watching = Watching()
    again = compare(run, training, test, chosen, observer=watching, robot=("car:3", robot))
    assert ("evolve car:3", True, None) in watching.finished
    assert without_timings(again) == without_timings(report)


def test_a_yardstick_without_a_robot_or_without_controllers_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgument, match="a yardstick is evolved on an emulated robot, but none is given"):
        run_in(tmp_path, settings("linear", yardstick=True))
    with pytest.raises(InvalidArgument, match="only prediction is to be compared"):
        settings("linear", yardstick=True, controllers=False)


def test_prediction_alone_evolves_nothing(tmp_path: Path) -> None:
    report = run_in(tmp_path, settings("linear", controllers=False))
    assert report.matrix is None
    assert report.prediction is not None
    assert report.prediction.names == ("persistence", "linear")


def test_the_saved_report_is_strict_json_and_one_page(tmp_path: Path) -> None:
    report = run_in(tmp_path, settings("linear"))
    document, page = save_report(report, tmp_path)
    assert json.loads(document.read_text())["timings"]
    assert "linear" in page.read_text()


class FittedElsewhere(DynamicsModel):
    """Stands in for a robot: drag on every state, whatever the control."""

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: object = None) -> FittedElsewhere:
        return self

    def acceleration(self, carry: np.ndarray, control: np.ndarray) -> np.ndarray:
        return -carry
