"""A comparison that leaves whole conditions out: errors within and across them, side by side."""

from dataclasses import replace

import pytest

from evaluation.report import brief, to_json
from evaluation.running import compare
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidArgument
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
