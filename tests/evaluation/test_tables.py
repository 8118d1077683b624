"""The tables and pictures of a report: what is painted, framed, marked and left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from evaluation.exploitability import ModelExploitability, ProbeResult
from evaluation.formatting import number, three_digits
from evaluation.report import Report
from evaluation.report.elements import Picture
from evaluation.report.render.svg import drawn
from evaluation.report.sections.controllers import ONE_SEED, claims_picture, controller_sheet
from evaluation.report.sections.evolution import fitness_picture
from evaluation.report.sections.exploitability import probe_sheet
from evaluation.report.sections.prediction import SHOWN_MODELS, free_run_picture, prediction_sheet
from evaluation.report.sections.replay import traces_picture
from evaluation.report.sections.transfer import transfer_sheet
from evaluation.transfer import Estimate, TransferMatrix, summarise
from tests.fixtures.known_models import Known, Sliding, fitted
from tests.fixtures.reports import exploited, make_report, matrix, prediction

FITNESS = {"a": {"a": 10.0, "b": 5.0, "car": 0.0}, "ab": {"a": 8.0, "b": 8.0, "car": float("nan")}}
AGAINST = {"ab": ("a", "b")}


@pytest.fixture(scope="module")
def report() -> Report:
    return make_report({"known": fitted(Known()), "sliding": fitted(Sliding())})


@pytest.mark.parametrize(
    "model, said",
    [
        (exploited(), "linear: exploited: its controllers claim 10.00 waypoints and achieve 4.00 on the robot."),
        (exploited(), "They turn on the spot in 50 % of steps (held-out driving 1.0 %, the same on the robot 0 %)."),
        (exploited(), "10 % of what they visit lies outside the data (held-out driving 1.0 %, the same on the robot"),
        (exploited(visited=0.0), "No single step of it is wrong: small errors add up over a trial."),
        (exploited(gap=Estimate(0.5, 0.1)), "the claim holds: its controllers claim 10.00 waypoints and achieve 4.00"),
        (
            exploited(achieved=None, gap=Estimate(2.0, 0.1)),
            "claim 10.00 waypoints and achieve 8.00 on the other models.",
        ),
        (exploited(achieved=None, others=None, gap=None), "waypoints; there is nowhere else to test it."),
        (exploited(gap=Estimate(6.0, float("nan"))), "One trial cannot show whether the claim holds."),
        (exploited(claimed=None, gap=None), "no controller was evolved on it, so nothing can be said."),
        (
            exploited(seed_fitness=(9.0, 10.04, 8.0)),
            "claim 10.00 waypoints (3 evolution runs: 9.00, 10.04, 8.00) and achieve 4.00",
        ),
    ],
)
def test_the_sentence_on_a_model_says_what_was_found(model: ModelExploitability, said: str) -> None:
    assert said in model.sentence


@pytest.mark.parametrize(
    "model, unsaid",
    [
        (exploited(), "No single step of it is wrong: small errors add up over a trial."),
        (exploited(), "the claim holds"),
        (exploited(), "seeds"),
        (exploited(), "One trial"),
        (exploited(visited=0.0), "They"),
        (exploited(outside=None), "outside the data"),
        (exploited(gap=Estimate(0.5, 0.1)), "exploited"),
        (
            exploited(gap=Estimate(0.5, 0.1), visited=0.0),
            "No single step of it is wrong: small errors add up over a trial.",
        ),
    ],
)
def test_the_sentence_on_a_model_says_nothing_else(model: ModelExploitability, unsaid: str) -> None:
    assert unsaid not in model.sentence


def test_the_matrix_is_painted_from_nothing_to_the_best_and_framed_where_evolved() -> None:
    heat = transfer_sheet(matrix(FITNESS, against=AGAINST, robot="car")).heat
    assert heat is not None
    assert heat.shades == ((1.0, 0.5, 0.0), (0.8, 0.8, None))
    assert heat.framed == {(0, 0), (1, 0), (1, 1)}
    assert heat.divided == 2


def test_a_matrix_without_a_robot_has_no_line_and_one_of_zeros_no_paint() -> None:
    heat = transfer_sheet(matrix({"a": {"a": 0.0, "b": 0.0}}, trials=1)).heat
    assert heat is not None
    assert heat.divided is None
    assert heat.shades == ((None, None),)


def test_a_negative_fitness_is_the_bottom_of_the_scale() -> None:
    heat = transfer_sheet(matrix({"a": {"a": 1.0, "b": -1.0, "c": 0.0}}, trials=1)).heat
    assert heat is not None
    assert heat.shades == ((1.0, 0.0, 0.5, 0.25),)  # the last are the other families


def test_shares_beyond_the_data_are_painted_on_a_logarithmic_scale() -> None:
    sheet = probe_sheet((exploited(visited=1.0, outside=0.0005), exploited(visited=0.01, outside=None)))
    assert sheet.heat is not None
    assert sheet.heat.alarm
    (none, all_of_it), (unknown, hundredth), held_out = sheet.heat.shades
    assert (none, unknown) == (None, None)
    assert all_of_it == 1.0
    assert hundredth == pytest.approx(1.0 / 3.0)
    assert held_out == pytest.approx((1.0 / 3.0, 1.0 / 3.0))
    assert sheet.rows[-1] == ("held-out data", "1.0 %", "1.0 %")


def test_a_probe_that_saw_next_to_nothing_anywhere_is_named_below_the_table() -> None:
    def saw(name: str, visited: float, held_out: float, robot: float) -> ProbeResult:
        return ProbeResult(name, "m/s", "slide", 1.0, visited, held_out, robot)

    def looked_at(*probes: ProbeResult) -> ModelExploitability:
        return replace(exploited(), probes=probes)

    one = looked_at(saw("sideways", 0.0, 0.001, 0.0), saw("spinning", 0.0, 0.0, 0.02), saw("range", 0.0, 0.0, 0.0))
    two = looked_at(saw("sideways", 0.001, 0.001, 0.0), saw("spinning", 0.0, 0.0, 0.0), saw("range", 0.5, 0.0, 0.0))
    sheet = probe_sheet((one, two))
    assert [column.splitlines()[0] for column in sheet.columns] == ["model", "outside", "spinning", "range"]
    assert sheet.rows[1][2:] == ("0 %", "50 %")
    assert "anywhere: sideways." in sheet.note
    assert "anywhere" not in probe_sheet((exploited(visited=1.0, outside=0.1),)).note


def claims_note(transfer: TransferMatrix) -> str:
    return controller_sheet(transfer, summarise(transfer)).note


def test_claims_stand_with_those_of_all_evolution_runs_or_with_a_word_that_their_spread_is_unknown() -> None:
    one, three = (matrix(FITNESS, against=AGAINST, robot="car", seeds=seeds) for seeds in ((9.0,), (9.0, 8.0, 9.96)))
    assert ONE_SEED in claims_note(one)
    assert "evolution runs" not in claims_note(one)
    assert ONE_SEED not in claims_note(three)
    assert "the champion of each of 3 evolution runs" in claims_note(three)
    assert controller_sheet(three, summarise(three)).rows[0][1].split("\n")[1] == "9.00, 8.00, 9.96"
    people = matrix({"anna": {"car": 9.0}}, against={"anna": ()}, robot="car")
    assert ONE_SEED not in claims_note(people)


def test_a_star_marks_the_best_model_and_those_that_do_not_differ_from_it() -> None:
    sheet = prediction_sheet(prediction({"persistence": 0.9, "linear": 0.300, "sindy": 0.301, "narx": 0.5}))
    starred = {row[0] for row in sheet.rows if row[1].startswith("* ")}
    assert starred == {"linear", "sindy"}
    assert sheet.title.startswith("Prediction error N, the mean error in standard deviations")


@pytest.mark.parametrize(
    "value, text",
    [(0.0461, "0.046"), (0.9994, "0.999"), (0.9996, "1.00"), (1.234, "1.23"), (12.34, "12.3"), (123.4, "123")],
)
def test_numbers_have_three_digits_and_keep_their_leading_zero(value: float, text: str) -> None:
    assert three_digits(value) == text
    assert three_digits(-value) == f"-{text}"
    assert three_digits(float("nan")) == number(None) == "–"


def ticks(picture: Picture) -> int:
    """Return how many seeds are marked in the first drawing, behind its axes and legend."""
    return drawn(picture.panels[0]).wide.count("<use")


def test_the_picture_of_claims_marks_the_champion_of_every_evolution_seed() -> None:
    one, three = (matrix(FITNESS, against=AGAINST, robot="car", seeds=seeds) for seeds in ((9.0,), (9.0, 8.0, 7.0)))
    without, marked = claims_picture(one, summarise(one)), claims_picture(three, summarise(three))
    assert ticks(marked) - ticks(without) == 2 * 3
    assert "Ticks" in marked.caption
    assert "Ticks" not in without.caption


def test_each_controller_is_traced_in_its_model_and_on_the_robot(report: Report) -> None:
    assert report.matrix is not None
    picture = traces_picture(report.matrix)
    assert picture is not None
    titles = [panel.title for panel in picture.panels]
    assert titles[:2] == ["known_c on known", "known_c on car"]
    assert len(titles) == 2 * len(report.matrix.rows)
    assert all(panel.note.endswith("waypoints") for panel in picture.panels)


def test_pictures_of_nothing_are_left_out() -> None:
    made = matrix(FITNESS, against=AGAINST)
    assert traces_picture(made) is None
    without = tuple(replace(champion, history=np.empty((0, 3))) for champion in made.champions)
    assert fitness_picture(replace(made, champions=without)) is None


def test_the_free_run_shows_the_best_models_and_says_how_many_can_be_switched_on() -> None:
    whole = make_report({f"model{i}": fitted(Known()) for i in range(SHOWN_MODELS + 1)}, robot=False).prediction
    assert whole is not None
    picture = free_run_picture(whole)
    pair, shown = picture.panels[0], drawn(picture.panels[0])
    assert [key.label for key in shown.legend] == ["measured", *(f"model{i}" for i in range(SHOWN_MODELS + 1))]
    assert pair.wide.off == {f"model{SHOWN_MODELS}"}
    assert f"the {SHOWN_MODELS} best of {SHOWN_MODELS + 1} models are switched on" in picture.caption
    for channel in ("forward_speed (m/s)", "lateral_speed (m/s)", "yaw_rate (rad/s)", "time (s)"):
        assert channel in shown.wide
        assert channel in shown.narrow
