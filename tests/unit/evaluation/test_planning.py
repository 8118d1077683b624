"""A comparison that leaves whole conditions out: errors within and across them, side by side."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from evaluation.cells.data import Split, whole_episodes
from evaluation.experiment import Experiment
from evaluation.planning import plan_comparison
from evaluation.report import brief, to_json
from evaluation.running import compare
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import models
from sysid_evo.system import Channel, System
from tests.fixtures.known_models import recording
from tests.fixtures.systems import FloorCar, drive


@pytest.fixture(scope="module")
def floors():
    """Two drives on a floor that grips and two on one that does not."""
    pieces = [
        replace(drive(car, seconds=20.0, seed=seed).episodes[0], condition=condition)
        for seed, (car, condition) in enumerate(
            [(FloorCar(), "grip"), (FloorCar(1.5, 2.0), "ice"), (FloorCar(), "grip"), (FloorCar(1.5, 2.0), "ice")]
        )
    ]
    return Dataset(FloorCar().system, tuple(pieces))


def test_a_condition_left_out_is_predicted_worse_than_one_learned_from(floors, tmp_path):
    report = compare(floors, out=tmp_path / "run", models=["linear"], only="prediction", leave_out="condition", jobs=1)
    grip, ice = report.conditions["linear"]
    assert (grip.condition, ice.condition, grip.horizon) == ("grip", "ice", 20)
    for found in (grip, ice):
        assert found.within is not None
        assert found.across is not None
        assert found.across > 1.05 * found.within
    assert to_json(report)["conditions"]["linear"][0]["condition"] == "grip"
    assert "Error N within and across conditions" in (tmp_path / "run" / "report.html").read_text()
    assert len(brief(report)) == len(brief(replace(report, conditions={}))) + 3
    again = compare(floors, out=tmp_path / "run", models=["linear"], only="prediction", leave_out="condition", jobs=1)
    assert again.conditions == report.conditions


def test_other_conditions_of_the_same_numbers_are_other_data(floors, tmp_path):
    settings = {"models": ["linear"], "only": "prediction", "leave_out": "condition", "jobs": 1}
    renamed = floors.with_episodes([replace(e, condition=f"the {e.condition}") for e in floors])
    compare(floors, out=tmp_path / "run", **settings)
    report = compare(renamed, out=tmp_path / "run", **settings)
    assert [found.condition for found in report.conditions["linear"]] == ["the grip", "the ice"]


def test_without_several_conditions_it_is_refused_before_any_work(floors, tmp_path):
    plain = floors.with_episodes([replace(e, condition="") for e in floors])
    with pytest.raises(InvalidArgument, match=r"leave_out: expected recordings of two or more conditions, got 1"):
        compare(plain, out=tmp_path / "run", models=["linear"], only="prediction", leave_out="condition")


@pytest.mark.parametrize(
    ("id", "by_hand", "rows"),
    [
        ("Pendulum-v1", (), ["linear", "rest"]),
        ("Pendulum-v1", ("still=constant",), ["linear", "still"]),
        ("CartPole-v1", (), ["linear", "rest"]),
    ],
)
def test_controls_at_rest_are_a_row_where_they_may_bring_something(id, by_hand, rows):  # noqa: A002  # as Gymnasium calls it
    task, robot = f'environment(id="{id}")', f'gymnasium(id="{id}")'
    planned = plan_comparison(Experiment(robot=robot, task=task, models=("linear",), by_hand=by_hand))
    assert planned.matrix is not None
    assert [champion.name for champion in planned.matrix.champions] == rows
    own = plan_comparison(Experiment(robot=robot, models=("linear",), by_hand=by_hand))
    assert own.experiment.task == task  # without --task it is the environment's own
    assert [cell.digest for cell in own.plan] == [cell.digest for cell in planned.plan]
    only = plan_comparison(Experiment(robot=robot, models=("linear",), only="fit"))
    assert only.matrix is None


def test_controls_at_rest_are_no_row_where_they_are_known_to_bring_nothing():
    planned = plan_comparison(Experiment(models=("linear",), yardstick=False))
    assert planned.matrix is not None
    assert [champion.name for champion in planned.matrix.champions] == ["linear"]


def test_controls_at_rest_are_a_row_without_a_robot():
    task = 'set_point(channels="forward_speed")'
    without_robot = plan_comparison(Experiment(models=("linear",), task=task), dataset=recording(3, steps=400))
    assert without_robot.matrix is not None
    assert [champion.name for champion in without_robot.matrix.champions] == ["linear", "rest"]


SWING = System(
    (Channel("angle", "rad", period=2.0 * np.pi), Channel("speed", "rad/s")),
    (Channel("torque", "N m", -1.0, 1.0),),
    0.05,
)


def swings(lengths):
    rng = np.random.default_rng(0)
    states = [np.cumsum(rng.standard_normal((length + 1, 2)), axis=0) for length in lengths]
    return Dataset.from_arrays(SWING, states, [rng.uniform(-1.0, 1.0, length) for length in lengths])


def test_families_that_predict_well_where_an_angle_comes_round_are_the_default_there():
    plan = plan_comparison(Experiment(only="prediction"), dataset=swings([400, 400]))
    assert set(plan.fits) == {"backprop27", "nearest_neighbour", "sindy", "narx", "mlp_ensemble"}
    assert plan.experiment.models is not None
    assert len(plan.experiment.models) == len(plan.fits)  # the run can be planned again from what is stored of it
    assert any("evolved3 is left out" in text and "angle comes round" in text for text in plan.plan.remarks)
    asked = plan_comparison(Experiment(only="prediction", models=("evolved3", "linear")), dataset=swings([400, 400]))
    assert set(asked.fits) == {"evolved3", "linear"}
    assert not any("left out" in text for text in asked.plan.remarks)


def test_a_family_that_says_it_is_periodic_steps_the_same_a_turn_later():
    data = swings([300])
    names = [name for name in models.names() if getattr(models.get(name), "periodic", False)]
    assert {"nearest_neighbour", "k_neighbours", "sindy", "narx", "mlp_ensemble", "gaussian_process"} <= set(names)
    assert "linear" not in names
    quick: dict[str, dict[str, Any]] = {name: models.get(name).presets.get("quick", {}) for name in names}
    for name in ("nearest_neighbour", "sindy_discrete", "narx", "backprop27"):
        model = models.make(name, **quick[name]).fit(data)
        lags, control, turn = model.n_lags, np.array([[0.5]]), np.array([[2.0 * np.pi, 0.0]])
        states = np.tile([[0.4, 1.0]], (1, lags + 1, 1))
        begun, later = (model.start(some, np.zeros((1, lags, 1))) for some in (states, states + turn))
        np.testing.assert_allclose(model.next_state(later, control), model.next_state(begun, control) + turn)


def test_whole_episodes_are_held_back_where_parts_of_them_would_be_too_short():
    short = swings([40, 90] * 10)
    names = whole_episodes(short, 0.25)
    held = sum(len(episode) for episode in short if episode.name in names)
    assert 0.15 * short.n_steps < held <= 0.25 * short.n_steps
    parts = Split().of(short)
    assert parts.test is not None
    assert set(parts.test.names) == set(names)
    assert {*parts.training.names, *names} == set(short.names)


def test_a_few_episodes_or_long_ones_are_cut_instead():
    assert whole_episodes(swings([40] * 7), 0.25) == []
    assert whole_episodes(swings([400] * 9), 0.25) == []
    assert whole_episodes(swings([400] * 9 + [20] * 9), 0.25) == []
    parts = Split().of(swings([400] * 9))
    assert parts.test is not None
    assert len(parts.test) == len(parts.training) == 9
