"""Which models are believed about a controller."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from evaluation.cells.data import GivenData, Split
from evaluation.cells.models import PredictCell
from evaluation.cells.plants import Plant, believed
from evaluation.prediction import ErrorScore, Interval, ModelPrediction
from sysid_evo.plan import Work
from sysid_evo.testing import example_dataset

DATA = GivenData(example_dataset(), Split())
MEASURED: dict[str, dict[int, float] | None] = {}


def column(label, family, errors=None):
    MEASURED[label] = errors
    return Plant(label, family, prediction=PredictCell(label, family, DATA))


def measured(cell):
    errors = MEASURED[cell.label]
    if errors is None:
        return None
    kinds = ("rmse", "error_std", "relative_percent", "nrmse")
    scores = (
        ErrorScore(
            horizon, 10, interval=Interval(n, n), resampled_n=np.array([n]), **{kind: np.full(3, n) for kind in kinds}
        )
        for horizon, n in errors.items()
    )
    return ModelPrediction(cell.label, cell.family, tuple(scores))


def no_progress(done, total, note=""):
    pass


def nowhere(cell):
    raise AssertionError(f"nobody asks where {cell.title} stands")


def names(*columns):
    work = Work(measured, no_progress, Path("unused"), Path("unused"), nowhere)  # type: ignore[arg-type]  # predictions only
    return tuple(one.label for one in believed(columns, work))


def test_a_model_is_believed_whose_error_at_one_second_is_near_that_of_the_best():
    good, near, far = (column(f"{n}", f"{n}", {1: 1.0 - n, 20: n, 60: 1.0}) for n in (0.10, 0.149, 0.151))
    assert names(far, near, good) == ("0.149", "0.1")


def test_where_it_was_not_measured_at_one_second_the_longest_horizon_counts():
    assert names(
        column("a", "a", {1: 0.9, 10: 0.1}), column("b", "b", {1: 0.1, 10: 0.1}), column("c", "c", {10: 0.9})
    ) == (
        "a",
        "b",
    )


def test_the_best_of_two_families_are_believed_so_that_one_can_judge_the_other():
    first, again = column("first", "narx", {20: 0.1}), column("again", "narx", {20: 0.12})
    second, third = column("second", "linear", {20: 0.4}), column("third", "sindy", {20: 0.5})
    assert names(first, again, second, third) == ("first", "again", "second")


def test_a_robot_and_what_was_not_measured_are_believed():
    robot, failed = Plant("car", "car"), column("failed", "failed")
    assert names(robot, failed) == ("car", "failed")
    assert names(
        robot, failed, column("a", "a", {20: 0.1}), column("b", "b", {20: 0.2}), column("c", "c", {20: 0.3})
    ) == (
        "car",
        "failed",
        "a",
        "b",
    )
