"""What a command and a notebook show: the verdict and one short table, and nothing that does not fit."""

from dataclasses import replace

from evaluation.report.report import PrintedReport, brief, tables
from evaluation.report.sections.controllers import drive_command, fitness_table
from evaluation.report.sections.summary import headlines, verdict
from evaluation.results import Failure
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


def test_the_brief_is_a_screenful_that_begins_with_the_verdict_and_nothing_in_its_table_wraps():
    made = compared()
    lines = printed(brief(made))
    assert len(lines) < 45
    assert max(map(len, lines)) <= 80
    (linear,) = [line for line in lines if line.startswith(" linear (chosen) ")]
    assert [*linear.split()[2:4], *linear.split()[5:]] == ["4.00", "±0.03", "12.00", "±0.03", "yes"]
    table = "Controllers: forecast, claimed and achieved (waypoints)"
    assert lines.index(table) > lines.index("Which controller to use?")
    wide = printed(brief(made), width=300)
    for finding in verdict(made):
        said = (finding.answer, finding.sentence) if finding.answer else finding.sentences
        assert {finding.question, *(f"  {line}" for line in said)} <= set(wide)
    assert not any("Transfer matrix" in line for line in wide)
    assert any("Transfer matrix" in line for line in printed(tables(made)))


def test_a_printed_report_reads_as_the_terminal_does():
    made = PrintedReport(**vars(compared()))
    lines = str(made).splitlines()
    assert lines[0] == "Made up"
    assert "Controllers: forecast, claimed and achieved (waypoints)" in lines
    assert max(map(len, lines)) <= 80
    assert len(repr(made)) < 500


def test_a_report_shows_its_answers_as_cards_in_which_names_are_text():
    fitness = {"linear": {"linear": 12.0, "<b>": 11.0}, "<b>": {"linear": 9.0, "<b>": 10.0}}
    plain = report(prediction({"persistence": 0.9, "linear": 0.3, "<b>": 0.06}), matrix(fitness))
    html = PrintedReport(**vars(plain))._repr_html_()
    assert html.count("border-top") == 3
    assert "&lt;b&gt;" in html
    assert "<b>" not in html


def test_without_controllers_the_brief_has_the_errors_of_the_models():
    lines = printed(brief(report(prediction({"persistence": 0.9, "linear": 0.3}, failed=["sindy"]))))
    assert "Simulation error N (95 % intervals)" in lines
    assert any(line.split() == ["sindy", "failed", "failed"] for line in lines)


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
    assert fitness_table(made).commands[0] == export
    driven = fitness_table(replace(made, settings={"robot": "car"})).commands
    assert [command.split()[1] if command else "" for command in driven] == ["drive", "drive", ""]
