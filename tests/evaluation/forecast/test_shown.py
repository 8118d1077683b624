"""What a report shows of forecasts: what was said before beside what came of it."""

from __future__ import annotations

import json

import pytest

from evaluation.report import Report, to_json
from evaluation.report.report import sections
from evaluation.report.sections.controllers import forecast_sheet, model_forecast_sheet, why_chosen
from tests.fixtures.reports import matrix, prediction, report

FITNESS = {
    "a": {"a": 10.0, "b": 9.0, "c": 8.0, "car": 8.5},
    "b": {"a": 3.0, "b": 12.0, "c": 5.0, "car": 8.0},
    "c": {"a": 1.0, "b": 2.0, "c": 14.0, "car": 2.0},
}
ALONE = {row: {name: value for name, value in columns.items() if name != "car"} for row, columns in FITNESS.items()}


def driven() -> Report:
    return report(transfer=matrix(FITNESS, robot="car"))


def test_forecasts_stand_beside_what_was_achieved_the_highest_first() -> None:
    sheet = forecast_sheet(driven())
    assert sheet is not None
    assert [row[0] for row in sheet.rows] == ["a\n(chosen)", "b", "c"]
    assert sheet.rows[0][2:] == ("8.8 (7.6 to 9.4)", "8.50 ±0.03", "yes")
    assert sheet.rows[1][4] == "no"
    assert sheet.note.endswith("2 of 3 were inside.")


def test_without_a_robot_nothing_is_said_of_it() -> None:
    sheet = forecast_sheet(report(transfer=matrix(ALONE)))
    assert sheet is not None
    assert sheet.columns == ("controller", "claimed", "forecast")
    assert "inside" not in sheet.note
    assert "robot," not in str(why_chosen(report(transfer=matrix(ALONE))))


def test_a_model_is_shown_with_the_share_of_a_claim_that_is_expected_to_be_kept() -> None:
    sheet = model_forecast_sheet(driven())
    assert sheet is not None
    assert [row[0] for row in sheet.rows] == ["a", "b", "c"]
    assert sheet.rows[0][1:4] == ("10.0", "8.8 (7.6 to 9.4)", "88 % (76 % to 94 %)")
    assert sheet.rows[0][4] == "20 %"


def test_a_model_that_predicts_badly_weighs_less_in_the_report() -> None:
    errors = prediction({"persistence": 0.9, "a": 0.1, "b": 0.1, "c": 1.0})
    weights = report(errors, matrix(FITNESS, robot="car")).forecasts["a"].weights
    assert weights["b"] == pytest.approx(2.0 * weights["a"])
    assert weights["b"] == pytest.approx(100.0 * weights["c"])


def test_a_report_without_a_forecast_has_no_section_of_it() -> None:
    assert "Forecast" in [section.title for section in sections(driven())]
    alone = report(transfer=matrix({"a": {"a": 9.0, "car": 8.0}}, robot="car"))
    assert "Forecast" not in [section.title for section in sections(alone)]
    assert why_chosen(alone) is None


def test_the_document_holds_what_was_predicted_and_what_came_of_it() -> None:
    found = json.loads(json.dumps(to_json(driven())["forecast"], allow_nan=False))
    first = found["controllers"][0]
    assert (first["controller"], first["achieved"], first["held"]) == ("a", 8.5, True)
    assert first["low"] < first["value"] < first["high"]
    assert found["models"][0]["model"] == "a"
    assert found["rule"]["share"] == 0.9
