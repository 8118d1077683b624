"""The document and the page: strict, within the schema, drawn again only where needed; a reason for what is absent."""

import copy
import html
import json
import re
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from evaluation.exploitability.results import UnderratedController
from evaluation.prediction.scoring import assess_prediction
from evaluation.report import save
from evaluation.report.render.html import page_of
from evaluation.report.render.terminal import table_lines
from evaluation.report.report import (
    SCHEMA,
    load_report,
    report_schema,
    save_report,
    sections,
    story_of,
    tables,
    to_json,
)
from evaluation.report.sections.summary import verdict
from evaluation.report.sections.transfer import transfer_sheet
from evaluation.results import ComparisonResults, DataSummary, Failure
from evaluation.transfer.matrix import TransferMatrix
from evaluation.transfer.matrix import TransferResult as Cell
from sysid_evo.errors import ArtefactError
from sysid_evo.system import System
from tests.fixtures import reports as chosen
from tests.fixtures.known_models import Broken, Exploding, Known, Sliding, fitted, recording
from tests.fixtures.reports import EVIL, champion, exploited, make_report, matrix, prediction, printed, text_page

FITNESS = {"a": {"a": 10.0, "b": 9.0, "car": 4.0}, "b": {"a": 8.0, "b": 8.0, "car": 8.1}}
ALONE = {row: {column: cells[column] for column in ("a", "b")} for row, cells in FITNESS.items()}


def in_terminal(report):
    return "\n".join(printed(tables(report)))


def test_the_document_is_strict_json_and_names_every_part(report):
    content = json.loads(json.dumps(to_json(report), allow_nan=False))
    assert [model["name"] for model in content["prediction"]["models"]] == ["persistence", "known", "weak", "sliding"]
    assert len(content["transfer"]["cells"]) == 4 * 4
    assert content["timings"] == {"cells": {"all": 1.5}, "finished_on": None}
    assert content["data"]["notes"] == ["recorded on a linear floor"]
    assert content["run"]["settings"]["evolution"]["generations"] == 2
    weak = content["prediction"]["models"][2]
    assert weak["scores"][2]["steps"] == 20
    assert weak["scores"][2]["channels"]["yaw_rate"]["unit"] == "rad/s"


def test_timings_stand_under_one_key_alone_and_the_page_leaves_out_the_short_ones(report):
    one, two = to_json(report), to_json(replace(report, timings={"all": 99.0}))
    assert one.pop("timings") != two.pop("timings")
    assert one == two
    page = text_page(replace(report, timings={"fit linear": 0.051, "run linear on car": 0.049}))
    assert "fit linear" in page
    assert "run linear on car" not in page


def test_names_are_escaped_and_never_taken_for_mathematics():
    drawn = page_of(story_of(chosen.report(transfer=matrix({EVIL: {EVIL: 9.0, "b": 8.0}}))))
    assert any("$\\frac$" in drawing for drawing in re.findall(r"<svg.*?</svg>", drawn, re.DOTALL))
    for page in (drawn, text_page(make_report({EVIL: fitted(Known())}, robot=False))):
        assert "<b>" not in page
        assert "a&lt;b&gt;&#34;&amp;$\\frac$" in page


def test_the_tables_fit_a_terminal_of_80_columns_and_state_horizon_and_initialisation(report):
    lines = printed(tables(report))
    text = "\n".join(lines)
    assert max(map(len, lines)) <= 80
    for name in (*report.prediction.names, *report.matrix.rows):
        assert name in text
    assert "…" not in text
    for words in ("as much history as a model wants", "20 steps", "(1 s)"):
        assert words in " ".join(text.split())


def test_wide_tables_are_split_by_columns_and_nothing_is_cut_off():
    names = [f"family_number_{i}" for i in range(8)]
    sheet = transfer_sheet(matrix({row: dict.fromkeys(names, 8.5) for row in names}, trials=4))
    lines = printed(table_lines(sheet))
    text = "\n".join(lines)
    assert max(map(len, lines)) <= 80
    parts = 1 + text.count("(continued)")
    assert parts > 1
    assert all(text.count(f" {row[0]} ") == parts for row in sheet.rows)
    for cell in (*sheet.columns, *(cell for row in sheet.rows for cell in row)):
        for line in cell.split("\n"):
            assert line in text


def test_the_verdict_names_the_best_model_and_the_controller_to_use(report):
    answers = {finding.question: f"{finding.answer} {finding.sentence}" for finding in verdict(report)}
    assert answers["Which models predict?"].startswith("known")
    assert answers["Which controller to use?"].startswith("None No controller does better than controls at rest")


def test_a_report_of_prediction_alone_has_no_transfer(report):
    alone = replace(report, matrix=None, exploitability=(), failures=(Failure("fit sindy", "no such package"),))
    page = text_page(alone)
    assert "Transfer matrix" not in page
    assert "no such package" in page
    assert to_json(alone)["transfer"] is None
    assert "no such package" in in_terminal(alone)


def test_a_test_set_of_a_few_samples_still_gives_a_report(report):
    short = assess_prediction({"known": fitted(Known())}, recording(), recording(1, steps=5))
    brief = replace(report, prediction=short, matrix=None, exploitability=())
    assert "No test episode is long enough to simulate it whole" in text_page(brief)
    assert "No test episode is long enough to simulate it whole" in " ".join(in_terminal(brief).split())


def test_a_single_trial_on_the_robot_has_no_error_bar():
    cells = [Cell("c", "a", np.array([3.0, 5.0])), Cell("c", "car", np.array([2.0]))]
    transfer = TransferMatrix.of([champion("c", ("a",))], ("a", "car"), cells, robot="car")
    report = ComparisonResults("Brief", DataSummary.of(recording(), recording(1, seed=8)), matrix=transfer)
    achieved = report.transfer.controller("c").achieved
    assert achieved.value == 2.0
    assert np.isnan(achieved.standard_error)
    assert to_json(report)["controllers"]["controllers"][0]["achieved"]["standard_error"] is None
    assert "2.00" in page_of(story_of(report))


def test_nothing_but_names_and_failures_is_still_a_page(report):
    empty = ComparisonResults(report.title, report.data)
    assert "Nothing was compared" in page_of(story_of(empty))
    (answer,) = to_json(empty)["answers"]
    assert (answer["question"], answer["sentences"]) == ("What was found?", ["Nothing was compared."])


def test_the_share_of_limited_windows_is_shown_with_the_score():
    report = make_report({"exploding": fitted(Exploding())}, robot=False)
    assert re.search("limited (9|100 %)", in_terminal(report))
    assert np.isfinite(report.prediction.model("exploding").scores[0].n)


def test_a_page_is_drawn_again_only_where_it_may_show_something_else(tmp_path, monkeypatch):
    shown = [chosen.report()]

    def drawn(of, *, afresh=False):
        before = page.stat().st_ino if page.exists() else None
        save_report(shown[0], tmp_path, of=of, afresh=afresh)
        return page.stat().st_ino != before

    page = tmp_path / "report.html"
    assert drawn("these")
    assert not drawn("these")
    assert drawn("other_models")
    assert drawn("other_models", afresh=True)
    assert drawn(None)
    assert drawn("other_models")
    shown[0] = replace(shown[0], title="another text")
    assert drawn("other_models")
    page.write_text(page.read_text()[:-200])
    assert drawn("other_models")
    monkeypatch.setattr(save, "versions", lambda: {"sysid-evo": "another"})
    assert drawn("other_models")
    monkeypatch.setattr(save, "EVALUATION", tmp_path)
    assert drawn("other_models")
    assert not drawn("other_models")


@pytest.fixture(scope="module")
def whole():
    return make_report({"known": fitted(Known()), "sliding": fitted(Sliding()), "broken": fitted(Broken())})


@pytest.fixture(scope="module")
def validator():
    schema = report_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def faults(validator, document):
    return [f"{error.json_path}: {error.message}" for error in validator.iter_errors(document)]


def test_every_kind_of_report_keeps_the_schema(whole, validator):
    found = prediction({"persistence": 0.9, "linear": 0.3}, {"linear": 0.4}, failed=["sindy"])
    for made in (whole, chosen.report(), chosen.report(found, failures=2), chosen.report(found, matrix(ALONE))):
        assert faults(validator, to_json(made)) == []


def test_the_schema_has_the_number_of_the_document():
    schema = report_schema()
    assert schema["properties"]["schema"]["const"] == SCHEMA
    assert schema["$id"] == "urn:sysid-evo:report:8"


def test_a_document_that_lacks_a_key_or_has_another_kind_of_value_is_refused(validator):
    document = to_json(chosen.report(failures=1))
    for key in document:
        less = copy.copy(document)
        del less[key]
        assert any(f"'{key}' is a required property" in fault for fault in faults(validator, less))
    failed = {**document["run"], "failures": [{"step": "fit"}]}
    for change in ({"title": 3}, {"schema": "sysid-evo/report/1"}, {"run": failed}, {"transfer": []}):
        assert faults(validator, {**document, **change})


def test_a_stored_report_is_read_as_it_was_written(tmp_path, whole):
    document = to_json(whole)
    (tmp_path / "report.json").write_text(json.dumps({**document, "of_a_later_version": 1}, allow_nan=False))
    found = load_report(tmp_path)
    assert found.model_dump(mode="json", by_alias=True) == document
    assert found.prediction.models[1].name == "known"


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"schema": "sysid-evo/report/7"}, "expected a report of schema sysid-evo/report/8, got 'sysid-evo/report/7'"),
        ({"title": 3}, "title: Input should be a valid string, got 3"),
        ({"transfer": {"cells": [], "unit": None}}, "transfer.unit: Input should be a valid string, got None"),
        (None, "expected a report of schema sysid-evo/report/8, got None"),
    ],
)
def test_a_report_of_another_version_or_with_another_kind_of_value_is_refused_with_the_remedy(tmp_path, changed, said):
    document = tmp_path / "report.json"
    document.write_text(json.dumps([] if changed is None else {**to_json(chosen.report()), **changed}))
    with pytest.raises(ArtefactError, match=re.escape(f"{document}: {said}")) as caught:
        load_report(tmp_path)
    assert str(caught.value).endswith(f"; rebuild it with sysid-evo report {tmp_path}")


def test_a_report_that_is_missing_or_cut_off_is_refused_with_the_remedy(tmp_path):
    for text in (None, '{"schema": "sysid-evo/rep'):
        if text is not None:
            (tmp_path / "report.json").write_text(text)
        with pytest.raises(ArtefactError, match=r"not a readable report \(.*\); rebuild it with sysid-evo report"):
            load_report(tmp_path)


def test_what_is_not_a_number_is_null_wherever_it_stands():
    guess = UnderratedController("c", float("nan"), float("inf"))
    made = replace(chosen.report(), exploitability=(exploited(model="a", underrated=(guess,)),))
    (found,) = to_json(made)["exploitability"]
    assert found["underrated"] == [{"controller": "c", "here": None, "elsewhere": None}]
    assert json.dumps(found, allow_nan=False)


def test_the_guide_lists_the_keys_of_the_document():
    table = (Path(__file__).parents[4] / "docs" / "report.md").read_text().partition("| key | content |")[2]
    assert re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE) == list(report_schema()["properties"])


TRUST = "Can the models be trusted?"


def absent(report):
    return {section.title: " ".join(section.absent) for section in sections(report)}


def test_a_report_with_everything_leaves_nothing_to_explain_but_what_no_model_gives():
    whole = chosen.report(prediction({"persistence": 0.9, "a": 0.3}, {"a": 0.4}), matrix(FITNESS, robot="car"))
    found = absent(replace(whole, exploitability=(exploited(model="a"),)))
    assert found["Controllers"] == found[TRUST] == ""
    assert found["Prediction"].startswith("No model gives prediction intervals")


def test_what_runs_on_a_robot_would_show_is_explained_without_them():
    alone = chosen.report(None, matrix(ALONE))
    found = absent(replace(alone, exploitability=(exploited(model="a", achieved=None),)))
    assert found["Controllers"].startswith("Nothing was run on a robot")
    assert "compared with the other models" in found[TRUST]
    dead = {row: {**cells, "car": float("nan")} for row, cells in FITNESS.items()}
    assert absent(chosen.report(None, matrix(dead, robot="car")))["Controllers"].startswith(
        "No controller could be run on car"
    )


def test_without_controllers_the_reason_is_told_on_the_page_and_in_the_terminal():
    alone = replace(chosen.report(prediction({"persistence": 0.9, "a": 0.3})), settings={"stop_after": "prediction"})
    sentence = "No controller was evolved, because this run stops after prediction."
    assert sentence in absent(alone)["Controllers"]
    assert [section.title for section in sections(alone)][:2] == ["Prediction", "Controllers"]
    assert sentence in html.unescape(text_page(alone))
    assert sentence in " ".join(in_terminal(alone).split())


def test_without_a_motion_probes_of_driving_are_explained():
    made = replace(chosen.report(None, matrix(FITNESS, robot="car")), exploitability=(exploited(model="a"),))
    still = System(made.data.system.states, made.data.system.controls, 0.05)
    assert "need a body on a plane" in absent(replace(made, data=replace(made.data, system=still)))[TRUST]
    assert "need a body on a plane" not in absent(made)[TRUST]


def test_a_test_set_that_is_too_short_is_explained():
    assert "No horizon fits" in absent(chosen.report(prediction(free={"a": 0.4}, steps=20)))["Prediction"]
    assert "No test episode is long enough" in absent(chosen.report(prediction(steps=5)))["Prediction"]
