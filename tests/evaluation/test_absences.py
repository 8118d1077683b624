"""What a report cannot show it names, with the reason, on the page and in the terminal."""

from __future__ import annotations

from dataclasses import replace

from evaluation.report import Report, tables
from evaluation.report.report import sections, to_html
from sysid_evo.system import System
from tests.fixtures.reports import exploited, matrix, prediction, printed, report

FITNESS = {"a": {"a": 10.0, "b": 9.0, "car": 4.0}, "b": {"a": 8.0, "b": 8.0, "car": 8.1}}
ALONE = {row: {column: cells[column] for column in ("a", "b")} for row, cells in FITNESS.items()}


def absent(of: Report) -> dict[str, str]:
    return {section.title: " ".join(section.absent) for section in sections(of)}


def test_a_report_with_everything_leaves_nothing_to_explain_but_what_no_model_gives() -> None:
    whole = report(prediction({"persistence": 0.9, "a": 0.3}, {"a": 0.4}), matrix(FITNESS, robot="car"))
    found = absent(replace(whole, exploitability=(exploited(model="a"),)))
    assert found["Transfer"] == found["Exploitability"] == ""
    assert found["Prediction"].startswith("No model gives a spread")


def test_without_a_robot_every_section_says_what_stands_for_it() -> None:
    found = absent(replace(report(None, matrix(ALONE)), exploitability=(exploited(model="a", achieved=None),)))
    assert found["Transfer"].startswith("Nothing was run on a robot")
    assert "to the other models" in found["Exploitability"]


def test_a_robot_that_ran_nothing_is_named() -> None:
    dead = {row: {**cells, "car": float("nan")} for row, cells in FITNESS.items()}
    assert absent(report(None, matrix(dead, robot="car")))["Transfer"].startswith("No controller could be run on car")


def test_without_controllers_the_reason_is_told_on_the_page_and_in_the_terminal() -> None:
    alone = replace(report(prediction({"persistence": 0.9, "a": 0.3})), settings={"only": "prediction"})
    sentence = "since only 'prediction' was asked for"
    assert sentence in absent(alone)["Transfer"]
    assert sentence in to_html(alone).replace("&#39;", "'")
    assert sentence in " ".join(" ".join(printed(tables(alone))).split())


def test_without_a_motion_probes_of_driving_are_explained() -> None:
    made = replace(report(None, matrix(FITNESS, robot="car")), exploitability=(exploited(model="a"),))
    still = System(made.data.system.states, made.data.system.controls, 0.05)
    assert "need a body on a plane" in absent(replace(made, data=replace(made.data, system=still)))["Exploitability"]
    assert "need a body on a plane" not in absent(made)["Exploitability"]


def test_a_test_set_that_is_too_short_is_explained() -> None:
    assert "No horizon fits" in absent(report(prediction(free={"a": 0.4}, steps=20)))["Prediction"]
    assert "long enough for a free run" in absent(report(prediction(steps=5)))["Prediction"]
