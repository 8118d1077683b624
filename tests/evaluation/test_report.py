"""The report: strict, the same every time, complete, and whole when parts are missing."""

from __future__ import annotations

import html
import io
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console, RenderableType

from evaluation.prediction import assess_prediction
from evaluation.report import DataSummary, Failure, Report, save, save_report, tables, to_json, verdict
from evaluation.report.render.terminal import to_rich
from evaluation.report.report import to_html
from evaluation.report.sections.transfer import transfer_sheet
from evaluation.transfer import Cell, TransferMatrix
from tests.fixtures.known_models import Broken, Exploding, Known, Sliding, Weak, fitted, recording
from tests.fixtures.reports import EVIL, champion, make_report


@pytest.fixture(scope="module")
def report() -> Report:
    return make_report({"known": fitted(Known()), "weak": fitted(Weak()), "sliding": fitted(Sliding())})


def _no_constants(name: str) -> None:
    raise AssertionError(f"not strict JSON: {name}")


def _text(report: Report) -> str:
    return _printed(tables(report))


def _printed(parts: list[RenderableType]) -> str:
    console = Console(width=80, file=io.StringIO())
    console.print(*parts, sep="\n")
    return console.file.getvalue()  # type: ignore[attr-defined]


def test_report_json_is_strict_and_names_every_part(report: Report) -> None:
    content = json.loads(json.dumps(to_json(report)), parse_constant=_no_constants)
    assert [model["name"] for model in content["prediction"]["models"]] == ["persistence", "known", "weak", "sliding"]
    assert len(content["transfer"]["cells"]) == 4 * 4
    assert content["timings"] == {"all": 1.5}
    assert content["notes"] == ["recorded on a linear floor"]
    assert content["settings"]["evolution"]["generations"] == 2
    weak = content["prediction"]["models"][2]
    assert weak["horizons"][2]["steps"] == 20
    assert weak["horizons"][2]["channels"]["yaw_rate"]["unit"] == "rad/s"


def test_two_equal_runs_give_the_same_files(tmp_path: Path) -> None:
    for name in ("one", "two"):
        save_report(make_report({"known": fitted(Known())}), tmp_path / name)
    for file in ("report.json", "report.html"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


def test_the_page_leaves_out_times_too_short_to_matter(report: Report) -> None:
    page = to_html(replace(report, timings={"fit linear": 0.051, "run linear on car": 0.049}))
    assert "fit linear" in page
    assert "run linear on car" not in page


def test_timings_stand_under_one_key_alone(report: Report) -> None:
    one, two = to_json(report), to_json(replace(report, timings={"all": 99.0}))
    assert one.pop("timings") != two.pop("timings")
    assert one == two


def test_the_page_is_self_contained_and_names_every_model_and_controller(report: Report) -> None:
    page = to_html(report)
    assert not re.search(r"""(?:src|href)\s*=\s*["'](?!data:|\#)""", page)
    assert set(re.findall(r"https?://[^\"]*", page)) == {"http://www.w3.org/2000/svg"}  # a name, never fetched
    assert "@import" not in page
    # data, and the script of the page: nothing that is fetched
    scripts = re.findall(r"<script([^>]*)>", page)
    assert {script for script in scripts if script} == {
        ' type="application/json" id="replay-data"',
        ' type="application/json" class="chart"',
    }
    assert scripts.count("") == 1
    for name in (*report.prediction.names, *report.matrix.rows, *report.matrix.columns):  # type: ignore[union-attr]
        assert html.escape(name) in page
    assert page.index("Which models predict?") < page.index("Error over the horizon")


def test_names_are_escaped_and_never_taken_for_mathematics() -> None:
    page = to_html(make_report({EVIL: fitted(Known())}, robot=False))
    assert "<b>" not in page
    assert "a&lt;b&gt;&#34;&amp;$\\frac$" in page


def test_the_tables_fit_a_terminal_of_80_columns(report: Report) -> None:
    text = _text(report)
    assert max(len(line.rstrip()) for line in text.splitlines()) <= 80
    for name in (*report.prediction.names, *report.matrix.rows):  # type: ignore[union-attr]
        assert name in text
    assert "…" not in text


def test_wide_tables_are_split_by_columns_and_nothing_is_cut_off() -> None:
    models = {f"family_number_{i}": fitted(Weak()) for i in range(7)}
    matrix = make_report(models).matrix
    assert matrix is not None
    sheet = transfer_sheet(matrix)
    text = _printed(to_rich(sheet))
    assert max(len(line.rstrip()) for line in text.splitlines()) <= 80
    parts = 1 + text.count("(continued)")
    assert parts > 1
    assert all(text.count(row[0]) == parts for row in sheet.rows)
    for cell in (*sheet.columns, *(cell for row in sheet.rows for cell in row)):
        for line in cell.split("\n"):
            assert line in text


def test_horizon_and_initialisation_stand_with_the_numbers(report: Report) -> None:
    text = " ".join(_text(report).split())
    assert "as much history as a model wants" in text
    assert "20 steps" in text
    assert "(1 s)" in text


def test_the_verdict_names_the_best_model_and_what_to_use(report: Report) -> None:
    answers = {finding.question: " ".join(finding.answers) for finding in verdict(report)}
    assert "known is best" in answers["Which models predict?"]
    assert report.transfer is not None
    assert report.transfer.pick is not None
    assert report.transfer.pick in answers["What to use?"]


@pytest.mark.parametrize(
    "made",
    [
        lambda: make_report({"known": fitted(Known())}, robot=False),
        lambda: make_report({"known": fitted(Known())}),
        lambda: make_report({"known": fitted(Known()), "broken": fitted(Broken())}),
        lambda: make_report({"known": fitted(Known()), "weak": fitted(Weak())}, unplugged=True),
        lambda: make_report({"broken": fitted(Broken())}, unplugged=True),
        lambda: make_report({"exploding": fitted(Exploding())}, robot=False),
    ],
    ids=["one model, no robot", "one model", "a broken model", "an unplugged robot", "nothing works", "it diverges"],
)
def test_a_report_is_whole_when_parts_are_missing(made: Callable[[], Report], tmp_path: Path) -> None:
    report = made()
    document, page = save_report(report, tmp_path)
    json.loads(document.read_text(), parse_constant=_no_constants)
    assert "Prediction" in page.read_text()
    text = _text(report)
    for failure in report.all_failures:
        assert failure.reason.split(":")[0] in text


def test_a_report_of_prediction_alone_has_no_transfer(report: Report) -> None:
    alone = replace(report, matrix=None, exploitability=(), failures=(Failure("fit sindy", "no such package"),))
    page = to_html(alone)
    assert "Transfer matrix" not in page
    assert "no such package" in page
    assert to_json(alone)["transfer"] is None
    assert "no such package" in _text(alone)


def test_a_test_set_of_a_few_samples_still_gives_a_report(report: Report) -> None:
    short = assess_prediction({"known": fitted(Known())}, recording(), recording(1, steps=5))
    brief = replace(report, prediction=short, matrix=None, exploitability=())
    assert "no free run" in to_html(brief)
    assert "no free run" in _text(brief)


def test_a_single_trial_on_the_robot_has_no_error_bar() -> None:
    training, test = recording(), recording(1, seed=8)
    cells = [Cell("c", "a", np.array([3.0, 5.0])), Cell("c", "car", np.array([2.0]))]
    matrix = TransferMatrix.of([champion("c", ("a",))], ("a", "car"), cells, robot="car")
    report = Report("Brief", DataSummary.of(training, test), matrix=matrix)
    assert report.transfer is not None
    achieved = report.transfer.controller("c").achieved
    assert achieved is not None
    assert achieved.value == 2.0
    assert np.isnan(achieved.standard_error)
    assert to_json(report)["controllers"]["controllers"][0]["achieved"]["standard_error"] is None
    assert "Most on the robot: c, 2.00." in to_html(report)


def test_nothing_but_names_and_failures_is_still_a_page(report: Report) -> None:
    empty = replace(
        report, prediction=None, matrix=None, exploitability=(), models=(), settings={}, versions={}, timings={}
    )
    assert "Nothing was compared" in to_html(empty)
    assert to_json(empty)["verdict"] == [{"question": "What was found?", "answers": ["Nothing was compared."]}]


def test_clipping_is_shown_beside_the_score() -> None:
    report = make_report({"exploding": fitted(Exploding())}, robot=False)
    assert "clip 9" in _text(report) or "clip 100 %" in _text(report)
    assert np.isfinite(report.prediction.model("exploding").at[0].n)  # type: ignore[union-attr]


def test_a_page_is_drawn_again_only_where_it_may_show_something_else(
    report: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = [report]

    def drawn(of: str | None, *, afresh: bool = False) -> bool:
        before = page.stat().st_ino if page.exists() else None
        save_report(shown[0], tmp_path, of=of, afresh=afresh)
        return page.stat().st_ino != before

    page = tmp_path / "report.html"
    assert drawn("these")
    assert not drawn("these")
    assert drawn("others")
    assert drawn("others", afresh=True)
    assert drawn(None)
    assert drawn("others")
    shown[0] = replace(report, title="another text")
    assert drawn("others")
    page.write_text(page.read_text()[:-200])
    assert drawn("others")
    monkeypatch.setattr(save, "versions", lambda: {"sysid-evo": "another"})
    assert drawn("others")
    monkeypatch.setattr(save, "EVALUATION", tmp_path)
    assert drawn("others")
    assert not drawn("others")
