"""What a command and a notebook show: the verdict and one short table, and nothing that does not fit."""

from dataclasses import replace

from evaluation.report import Failure, brief, drive_command, tables, verdict
from evaluation.report.report import PrintedReport
from evaluation.report.sections.controllers import command_sheet, overview_sheet
from evaluation.report.sections.summary import headlines
from tests.fixtures.reports import matrix, prediction, printed, report

LONG = "backprop27+nearest_neighbour+parametrised"


def compared(*, seeds=()):
    """Two models, a controller each and one of both, on a robot."""
    fitness = {
        "linear": {"linear": 12.0, "sindy": 11.0, "car": 4.0},
        "sindy": {"linear": 9.0, "sindy": 10.0, "car": 9.8},
        LONG: {"linear": 9.0, "sindy": 9.5, "car": 9.1},
    }
    return report(
        prediction({"persistence": 0.9, "linear": 0.3, "sindy": 0.06}),
        matrix(fitness, against={LONG: ("linear", "sindy")}, robot="car", seeds=seeds),
    )


def row(made, name):
    sheet = overview_sheet(made)
    return next(cells for cells in sheet.rows if cells[0] == name)


def test_each_row_says_how_a_model_predicts_and_whether_its_controller_is_exploited():
    assert row(compared(), "persistence") == ("persistence", "0.900", "–", "–", "–")
    assert row(compared(), "linear") == ("linear", "0.300", "12.00 ±0.03", "4.00 ±0.03", "yes")
    assert row(compared(), "sindy") == ("sindy", "0.060", "10.00 ±0.03", "9.80 ±0.03", "no")
    assert row(compared(), LONG) == (LONG, "–", "9.00 ±0.03", "9.10 ±0.03", "no")


def test_claims_stand_with_those_of_all_evolution_runs():
    made = compared(seeds=(10.8, 12.06, 11.0))
    assert row(made, "linear")[2] == "12.00 ±0.03\n10.80, 12.06, 11.00"
    assert "the champion of each of 3 evolution runs" in " ".join(" ".join(printed(brief(made))).split())
    assert "evolution runs" not in " ".join(printed(brief(compared())))


def test_the_brief_is_a_screenful_that_begins_with_the_verdict_and_nothing_in_its_table_wraps():
    made = compared()
    lines = printed(brief(made))
    assert len(lines) < 45
    assert max(map(len, lines)) <= 80
    (linear,) = [line for line in lines if line.startswith(" linear ")]
    assert linear.split() == ["linear", "0.300", "12.00", "±0.03", "4.00", "±0.03", "yes"]
    assert any(line.startswith(" N: the mean error in standard deviations") for line in lines)
    assert lines.index("In short") > lines.index("What to use?")
    wide = printed(brief(made), width=200)
    for finding in verdict(made):
        assert {finding.question, *(f"  {answer}" for answer in finding.answers)} <= set(wide)
    assert not any("Transfer matrix" in line for line in wide)
    assert any("Transfer matrix" in line for line in printed(tables(made)))


def test_a_printed_report_reads_as_the_terminal_does():
    made = PrintedReport(**vars(compared()))
    lines = str(made).splitlines()
    assert lines[0] == "Made up"
    assert "In short" in lines
    assert max(map(len, lines)) <= 80
    assert len(repr(made)) < 500


def test_a_report_shows_its_answers_as_cards_in_which_names_are_text():
    fitness = {"linear": {"linear": 12.0, "<b>": 11.0}, "<b>": {"linear": 9.0, "<b>": 10.0}}
    plain = report(prediction({"persistence": 0.9, "linear": 0.3, "<b>": 0.06}), matrix(fitness))
    html = PrintedReport(**vars(plain))._repr_html_()
    assert html.count("border-top") == 3
    assert "&lt;b&gt;" in html
    assert "<b>" not in html


def test_a_controller_evolved_against_another_model_has_a_row_of_its_own():
    made = report(
        prediction({"persistence": 0.9, "linear": 0.3}),
        matrix({"linear": {"linear": 3.0, "other": 8.0}}, against={"linear": ("other",)}),
    )
    assert row(made, "linear") == ("linear", "0.300", "–", "–", "–")
    assert row(made, "linear (controller)")[2] == "8.00 ±0.03"


def test_without_controllers_the_table_holds_predictions_alone():
    sheet = overview_sheet(report(prediction({"persistence": 0.9, "linear": 0.3}, failed=["sindy"])))
    assert sheet.columns == ("model", "N, 20 steps\n(1 s)")
    assert sheet.rows == (("persistence", "0.900"), ("linear", "0.300"), ("sindy", "failed"))
    assert overview_sheet(report()) is None


def test_without_a_robot_achieved_means_on_other_models():
    made = report(transfer=matrix({"a": {"a": 10.0, "b": 2.0}}))
    sheet = overview_sheet(made)
    assert sheet.columns == ("model or\ncontroller", "claimed", "on other\nmodels", "exploited")
    assert sheet.rows == (("a", "10.00 ±0.03", "2.00 ±0.03", "yes"),)


def test_the_first_failures_stand_in_the_brief_with_the_first_line_of_their_reasons():
    failures = tuple(Failure(f"fit model{i}", f"reason {i}\na traceback") for i in range(7))
    text = "\n".join(printed(brief(replace(compared(), failures=failures))))
    assert "  fit model4: reason 4\n" in text
    assert "  and 2 more, in the report\n" in text
    assert "fit model5" not in text
    assert "traceback" not in text
    assert "more, in the report" not in "\n".join(printed(brief(replace(compared(), failures=failures[:5]))))


def test_the_chosen_controller_comes_with_the_command_that_drives_it():
    made = replace(compared(), controllers={"sindy": "controllers/my sindy.json"}, settings={"robot": "car:3"})
    assert drive_command(made, "sindy", folder="runs/x") == (
        "sysid-evo drive --controller 'runs/x/controllers/my sindy.json' --robot car:3"
    )
    assert drive_command(made, "linear") is None
    own = replace(made, settings={"robot": "tank", "plugins": ["/home/me/tank.py"]})
    assert (drive_command(own, "sindy") or "").endswith("--robot tank --plugin /home/me/tank.py")
    assert made.transfer.pick == "linear"
    assert "sysid-evo drive" not in " ".join(printed(brief(made)))
    chosen = replace(made, controllers={"linear": "controllers/linear.json"}, settings={})
    driven = replace(chosen, settings={"robot": "car"})
    command = "sysid-evo drive --controller 'runs/a very long name/controllers/linear.json' --robot car"
    assert printed(brief(driven, folder="runs/a very long name"))[-1].endswith(command)


def test_without_a_robot_the_first_command_exports_the_chosen_controller():
    files = {"linear": "controllers/linear.json", "sindy": "controllers/sindy.json"}
    made = replace(compared(), controllers=files, settings={"plugins": ["/home/me/tank.py"]})
    export = "sysid-evo export controllers/linear.json --to c --plugin /home/me/tank.py"
    assert printed(brief(made))[-1].endswith(export)
    assert [one.command for one in headlines(made) if one.command] == [export]
    sheet = command_sheet(made)
    assert [(name, command.split()[1]) for name, command in sheet.rows] == [
        ("linear", "export"), ("sindy", "export"), ("linear", "drive"), ("sindy", "drive")
    ]  # fmt: skip
    with_robot = command_sheet(replace(made, settings={"robot": "car"}))
    assert {command.split()[1] for _, command in with_robot.rows} == {"drive"}
