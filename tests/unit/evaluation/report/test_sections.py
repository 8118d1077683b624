"""Tables, cards and pictures of the sections: what is painted, framed, marked, said and left out."""

import json
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from evaluation.exploitability.results import ProbeResult
from evaluation.linearisation import LinearResponse, OperatingPoint
from evaluation.plot_style import new_figure
from evaluation.prediction.scores import PERSISTENCE
from evaluation.prediction.scoring import assess_prediction
from evaluation.report.elements import DrawingPair
from evaluation.report.render.html import Words, explained_words
from evaluation.report.render.svg import drawn
from evaluation.report.render.terminal import table_lines
from evaluation.report.report import to_json
from evaluation.report.sections import controllers as controllers_section
from evaluation.report.sections import models as models_section
from evaluation.report.sections.controllers import (
    ONE_SEED,
    fitness_table,
    further_figures_table,
    model_weight_table,
    overview_picture,
)
from evaluation.report.sections.error_analysis import (
    episode_error_sheet,
    region_sheet,
    residual_picture,
    residual_sheet,
)
from evaluation.report.sections.evolution import fitness_picture
from evaluation.report.sections.exploitability import exploitability_cards, outside_range_table
from evaluation.report.sections.prediction import SHOWN_MODELS, difference_table, error_table, free_run_picture
from evaluation.report.sections.replay import traces_picture
from evaluation.report.sections.transfer import CONTROLLERS, FAMILIES, paper_sheet, transfer_sheet
from evaluation.results import DataSummary, ModelSummary
from evaluation.transfer.matrix import TransferMatrix, human_driver
from evaluation.transfer.matrix import TransferResult as Cell
from evaluation.transfer.summary import summarise
from sysid_evo.data import Dataset
from sysid_evo.system import Channel, System
from sysid_evo.validation.estimates import Estimate
from tests.fixtures import reports as chosen
from tests.fixtures.known_models import Known, LosesGrip, Undefined, fitted, noisy, recording
from tests.fixtures.reports import exploited, matrix, on_a_plane, paper_matrix, prediction, printed

FITNESS = {"a": {"a": 10.0, "b": 5.0, "car": 0.0}, "ab": {"a": 8.0, "b": 8.0, "car": float("nan")}}
AGAINST = {"ab": ("a", "b")}
PAPER = Path(__file__).parents[4] / "shared" / "paper" / "tables.json"
SMALL_ERRORS = "No single step is implausible: small errors add up over a trial."
HOLDS = Estimate(0.5, 0.1)


def with_cells(**changes):
    """Return a matrix whose cells have these attributes."""
    made = matrix(FITNESS, against=AGAINST, robot="car")
    return replace(made, cells={key: replace(cell, **changes) for key, cell in made.cells.items()})


@pytest.mark.parametrize(
    "model, said",
    [
        (exploited(), "linear: exploited: its controllers claim 10.00 waypoints and achieve 4.00 on the robot."),
        (exploited(), "They turn on the spot in 50 % of steps (held-out data 1.0 %, on the robot 0 %)."),
        (exploited(), "10 % of their steps are outside the training data (held-out data 1.0 %, on the robot"),
        (exploited(visited=0.0), SMALL_ERRORS),
        (exploited(gap=HOLDS), "the claim holds: its controllers claim 10.00 waypoints and achieve 4.00"),
        (
            exploited(achieved=None, gap=Estimate(2.0, 0.1, 1.8, 2.2)),
            "claim 10.00 waypoints and achieve 8.00 on the other models.",
        ),
        (exploited(achieved=None, other_models=None, gap=None), "waypoints; there is no other system to test it on."),
        (exploited(gap=Estimate(6.0, float("nan"))), "One trial cannot show whether the claim holds."),
        (exploited(claimed=None, gap=None), "not assessed, because no controller was evolved on it."),
        (
            exploited(seed_fitness=(9.0, 10.04, 8.0)),
            "claim 10.00 waypoints (3 evolution runs: 9.00, 10.04, 8.00) and achieve 4.00",
        ),
    ],
)
def test_the_sentence_on_a_model_says_what_was_found(model, said):
    assert said in model.sentence


@pytest.mark.parametrize(
    "model, unsaid",
    [
        (exploited(), (SMALL_ERRORS, "the claim holds", "seeds", "One trial")),
        (exploited(visited=0.0), ("They",)),
        (exploited(outside=None), ("outside the data",)),
        (exploited(gap=HOLDS), ("exploited",)),
        (exploited(gap=HOLDS, visited=0.0), (SMALL_ERRORS,)),
    ],
)
def test_the_sentence_on_a_model_says_nothing_else(model, unsaid):
    assert not [words for words in unsaid if words in model.sentence]


def test_the_matrix_is_painted_from_nothing_to_the_best_and_framed_where_evolved():
    heat = transfer_sheet(matrix(FITNESS, against=AGAINST, robot="car")).heat
    assert heat.shades == ((0.0, 1.0, 0.5), (None, 0.8, 0.8))
    assert heat.framed == {(0, 1), (1, 1), (1, 2)}
    assert heat.divided == 1


@pytest.mark.parametrize(
    ("fitness", "shades"),
    [
        pytest.param((0.0, 0.0), (None, None), id="one of zeros has no paint"),
        pytest.param((1.0, -1.0, 0.0), (0.25, 1.0, 0.0, 0.5), id="a negative one is the bottom; other families first"),
    ],
)
def test_a_matrix_without_a_robot_has_no_line(fitness, shades):
    heat = transfer_sheet(matrix({"a": dict(zip("abc", fitness, strict=False))}, trials=1)).heat
    assert heat.divided is None
    assert heat.shades == (shades,)


SAID = {
    "= evolved": (matrix(FITNESS, against=AGAINST), matrix({"a": FITNESS["a"]}, against={"a": ()})),
    "Other families:": (matrix(FITNESS, against=AGAINST), matrix(FITNESS, against=AGAINST, robot="car")),
    "Limited:": (with_cells(clipped_share=0.1), with_cells(clipped_share=0.0)),
    "Div:": (with_cells(diverged_share=0.1), with_cells(clipped_share=0.1)),
    "Missing:": (with_cells(missing=("the battery is empty",)), with_cells()),
}


@pytest.mark.parametrize("word", SAID)
def test_a_note_of_the_matrix_explains_only_what_stands_in_it(word):
    """A terminal prints the note below the table, where a word on an absent column sends readers on a search."""
    there, absent = SAID[word]
    assert word in transfer_sheet(there).note
    assert word not in transfer_sheet(absent).note


def test_a_note_of_the_errors_explains_only_what_stands_in_them():
    limited = error_table(prediction({"linear": 0.3, "sindy": 0.2}, clipped={"linear": 0.2}))
    assert "* lowest" in limited.note
    assert "Limited:" in limited.note
    plain = error_table(prediction({"linear": 0.3}, failed=["sindy"]))
    assert "Limited" not in plain.note
    few = error_table(prediction({"linear": 0.3, "sindy": 0.2}, episodes=2))
    assert not any("*" in cell for row in few.rows for cell in row)
    assert "*" not in few.note


def test_a_note_of_shares_has_no_second_line_without_one():
    assert "second line" in outside_range_table((exploited(),)).note
    alone = replace(exploited(), outside_robot=None)
    assert "second line" not in outside_range_table((alone,)).note


def test_shares_beyond_the_data_are_painted_on_a_logarithmic_scale():
    sheet = outside_range_table((exploited(visited=1.0, outside=0.0005), exploited(visited=0.01, outside=None)))
    assert sheet.heat.alarm
    (none, all_of_it), (unknown, hundredth), held_out = sheet.heat.shades
    assert (none, unknown) == (None, None)
    assert all_of_it == 1.0
    assert hundredth == pytest.approx(1.0 / 3.0)
    assert held_out == pytest.approx((1.0 / 3.0, 1.0 / 3.0))
    assert sheet.rows[-1] == ("held-out data", "1.0 %", "1.0 %")


def test_a_probe_that_saw_next_to_nothing_anywhere_is_named_below_the_table():
    def looked_at(**seen):
        probes = [ProbeResult(name, "m/s", "slide", 1.0, *shares) for name, shares in seen.items()]
        return replace(exploited(), probes=tuple(probes))

    one = looked_at(sideways=(0.0, 0.001, 0.0), spinning=(0.0, 0.0, 0.02), range=(0.0, 0.0, 0.0))
    two = looked_at(sideways=(0.001, 0.001, 0.0), spinning=(0.0, 0.0, 0.0), range=(0.5, 0.0, 0.0))
    sheet = outside_range_table((one, two))
    assert [column.splitlines()[0] for column in sheet.columns] == ["model", "outside", "spinning", "range"]
    assert sheet.rows[1][2:] == ("0 %", "50 %")
    assert "everywhere: sideways." in sheet.note
    assert "everywhere" not in outside_range_table((exploited(visited=1.0, outside=0.1),)).note


def with_seeds(*seeds):
    return matrix(FITNESS, against=AGAINST, robot="car", seeds=seeds)


def test_claims_stand_with_those_of_all_evolution_runs_or_with_a_word_that_their_spread_is_unknown():
    people = matrix({"anna": {"car": 9.0}}, against={"anna": ()}, robot="car")
    matrices = with_seeds(9.0), with_seeds(9.0, 8.0, 9.96), people
    notes = [fitness_table(chosen.report(transfer=one)).note for one in matrices]
    assert [ONE_SEED in note for note in notes] == [True, False, False]
    one, three, _ = (further_figures_table(one, summarise(one)) for one in matrices)
    assert "evolution runs:" not in one.note
    assert "the champion of each of 3 evolution runs" in three.note
    assert three.rows[0][1].split("\n")[-1] == "9.00, 8.00, 9.96"


def test_a_star_marks_the_best_model_and_those_that_do_not_differ_from_it():
    sheet = error_table(prediction({"persistence": 0.9, "linear": 0.300, "sindy": 0.301, "narx": 0.5}))
    starred = {row[0] for row in sheet.rows if row[1].startswith("* ")}
    assert starred == {"linear", "sindy"}
    assert sheet.title == "Simulation error N (95 % intervals)"


def test_each_controller_is_traced_in_its_model_and_on_the_robot(report):
    panels = traces_picture(report.matrix).panels
    assert [panel.title for panel in panels[:2]] == ["known_c on known", "known_c on car"]
    assert len(panels) == 2 * len(report.matrix.rows)
    assert all(panel.note.endswith("waypoints") for panel in panels)


def test_pictures_of_nothing_are_left_out():
    made = matrix(FITNESS, against=AGAINST)
    assert traces_picture(made) is None
    without = tuple(replace(champion, history=np.empty((0, 3))) for champion in made.champions)
    assert fitness_picture(replace(made, champions=without)) is None


def test_the_free_run_shows_the_best_models_and_says_how_many_can_be_switched_on():
    names = [f"model{i}" for i in range(SHOWN_MODELS + 1)]
    picture = free_run_picture(prediction(free={name: 0.3 + 0.01 * i for i, name in enumerate(names)}))
    pair, shown = picture.panels[0], drawn(picture.panels[0])
    assert [key.label for key in shown.legend] == ["measured", *names]
    assert pair.wide.off == {names[-1]}
    assert f"the best {SHOWN_MODELS} of {SHOWN_MODELS + 1} models are shown at first" in picture.caption
    for channel in ("forward_speed (m/s)", "lateral_speed (m/s)", "yaw_rate (rad/s)", "time (s)"):
        assert channel in shown.wide
        assert channel in shown.narrow


@pytest.fixture(scope="module")
def assessed():
    models = {"known": fitted(Known()), "grip": fitted(LosesGrip())}
    return assess_prediction(models, recording(), noisy(2, 4))


def test_each_model_stands_beside_the_best_with_the_words_where_there_is_no_difference():
    found = difference_table(prediction({PERSISTENCE: 0.9, "linear": 0.3, "level": 0.302, "sindy": 0.5}))
    rows = {row[0]: row[1] for row in found.rows}
    assert list(rows) == ["linear", "level", "sindy", PERSISTENCE]
    assert rows["linear"] == "best"
    assert rows["level"].startswith("+0.002\n-0.0")
    assert rows["level"].endswith("no significant\ndifference")
    assert rows["sindy"].startswith("+0.200\n+0.1")
    assert "significant" not in rows["sindy"]
    assert difference_table(prediction({"linear": 0.3})) is None


def test_the_table_of_residuals_tells_white_from_correlated_and_names_a_control(assessed):
    white = assessed.model("grip")
    p = white.residuals.white_p.copy()
    p[:] = [0.5, 0.001, np.nan]
    cross_p = np.ones_like(white.residuals.cross_p)
    cross_p[1, 0] = 0.001
    cross, band = np.zeros_like(white.residuals.cross), np.ones_like(white.residuals.cross_band)
    cross[8, 1, 0] = 0.25
    known = replace(white.residuals, white_p=p, cross=cross, cross_band=band, cross_p=cross_p)
    (row,) = residual_sheet(replace(assessed, models=(replace(white, residuals=known),))).rows
    assert row[1] == "white\nsteer, 0.15 s: +0.25"
    assert row[2].startswith("correlated (not white)\n")
    assert row[3] == "–"


def test_the_table_of_regions_names_the_worst_or_none(assessed):
    sheet = region_sheet(assessed)
    rows = {row[0]: row[1:] for row in sheet.rows}
    assert rows["known"][0] == "no region clearly"
    assert rows["grip"][0].startswith("forward_speed above ")
    assert float(rows["grip"][1].split("\n")[0]) > 1.2
    assert rows["grip"][2] == "20 %"
    assert "N after 5 steps (0.25 s)" in sheet.note


def test_each_test_episode_has_a_row(assessed):
    sheet = episode_error_sheet(assessed)
    assert [row[0] for row in sheet.rows] == [f"episode-{i}" for i in range(4)]
    assert sheet.columns == ("episode", *assessed.names)


@pytest.mark.parametrize("sheet", [difference_table, residual_sheet, region_sheet, episode_error_sheet])
def test_every_further_table_of_errors_is_80_columns_wide_at_most_and_folded(assessed, sheet):
    made = sheet(assessed)
    assert made.details
    lines = printed(table_lines(made))
    assert max(map(len, lines)) <= 80
    assert made.title in lines


@pytest.fixture(scope="module")
def kept():
    """A matrix whose own cell kept three trials."""
    made = matrix({"linear": {"linear": 10.0, "car": 4.0}}, robot="car")
    cell = replace(made.cell("linear", "linear"), traces=(on_a_plane(np.linspace(0.0, 1.0, 5)),) * 3)
    return replace(made, cells={**made.cells, ("linear", "linear"): cell})


def cards_of(models, transfer):
    return exploitability_cards(replace(chosen.report(transfer=transfer), exploitability=tuple(models))).cards


def test_a_card_begins_with_its_verdict_and_keeps_the_other_sentences(kept):
    models = exploited(), exploited(gap=Estimate(0.1, 0.1)), exploited(gap=None)
    cards = cards_of(models, kept)
    assert cards[0].title == "linear"
    assert cards[0].verdict.startswith("Exploited: its controllers claim 10.00 waypoints")
    assert any("turn on the spot" in sentence for sentence in cards[0].sentences)
    assert [(card.tone, card.folded) for card in cards] == [("bad", False), ("open", False), ("good", True)]
    assert cards[-1].verdict == "trusted: claims 10.00, achieves 4.00"


def test_a_card_shows_a_trial_that_was_kept(kept):
    none = matrix({"linear": {"linear": 10.0, "car": 4.0}}, robot="car")
    assert [cards_of([exploited()], made)[0].watch for made in (kept, none)] == ["linear", ""]


FORECAST = {
    "a": {"a": 10.0, "b": 9.0, "c": 8.0, "car": 8.5},
    "b": {"a": 3.0, "b": 12.0, "c": 5.0, "car": 8.0},
    "c": {"a": 1.0, "b": 2.0, "c": 14.0, "car": 2.0},
}


def driven():
    return chosen.report(transfer=matrix(FORECAST, robot="car"))


def test_one_table_has_measured_forecast_and_claimed_fitness_the_highest_forecast_first():
    sheet = fitness_table(driven())
    assert [row[0] for row in sheet.rows] == ["a (chosen)", "b", "c"]
    assert sheet.columns[:4] == ("controller", "on car", "forecast\n(90 %)", "claimed")
    assert sheet.rows[0][1:] == (
        "8.50 ±0.03", "8.8 (7.0 to 9.5)", "10.00 ±0.03", "85 %", "8.50 ±0.03", "8.00, c", "yes"
    )  # fmt: skip
    assert [row[-1] for row in sheet.rows] == ["yes", "yes", "yes"]
    assert sheet.marked == {(0, 6), (1, 6), (2, 6)}
    assert "2 of 3 measured values are inside their forecast interval." in sheet.note


def test_reference_and_baselines_come_last_and_are_named():
    fitness = {
        **FORECAST,
        "car": {"a": 1.0, "b": 1.0, "c": 1.0, "car": 20.0},
        "rest": dict.fromkeys([*"abc", "car"], 0.0),
    }
    sheet = fitness_table(chosen.report(transfer=matrix(fitness, robot="car")))
    assert [row[0] for row in sheet.rows][3:] == ["car (reference)", "rest (baseline)"]
    assert "Reference: evolved on the robot itself" in sheet.note


def test_a_controller_has_the_errors_of_the_models_that_it_was_evolved_in():
    errors = prediction({"persistence": 0.9, "a": 0.1, "b": 0.25, "c": 1.0})
    made = matrix({**FORECAST, "ab": FORECAST["a"]}, against={"ab": ("a", "b")}, robot="car")
    sheet = fitness_table(chosen.report(errors, made))
    found = {row[0].split()[0]: row[sheet.columns.index("N of its\nmodels")] for row in sheet.rows}
    assert found == {"a": "0.100", "b": "0.250", "c": "1.00", "ab": "0.100 to 0.250"}


def test_without_a_robot_the_other_models_take_its_place():
    alone = {row: {name: columns[name] for name in "abc"} for row, columns in FORECAST.items()}
    sheet = fitness_table(chosen.report(transfer=matrix(alone)))
    assert sheet.columns[:5] == ("controller", "other\nmodels", "forecast\n(90 %)", "claimed", "others\n/ claimed")
    assert "inside" not in sheet.note
    assert overview_picture(chosen.report(transfer=matrix(alone))).title == "Claimed against the other models"


def test_the_first_figure_has_a_dot_and_a_link_for_each_controller_that_claims_something():
    fitness = {**FORECAST, "car": {"a": 1.0, "b": 1.0, "c": 1.0, "car": 20.0}, "rest": {"car": 0.0}}
    drawing = overview_picture(chosen.report(transfer=matrix(fitness, robot="car"))).panels[0].wide
    assert [row for row, _ in drawing.links] == ["a", "b", "c"]
    assert (
        drawing.links[0][1]
        == "a: claims 10.00 (9.93 to 10.07) waypoints, measured on car 8.50 (8.43 to 8.57) waypoints"
    )
    shown = drawn(DrawingPair(drawing)).wide
    assert [shown.count(f'data-link="{i}"') for i in range(4)] == [4, 4, 4, 0]
    assert (
        overview_picture(chosen.report(transfer=matrix({"anna": {"car": 9.0}}, against={"anna": ()}, robot="car")))
        is None
    )


def test_a_model_is_shown_with_the_share_of_a_claim_that_is_expected_to_be_kept():
    sheet = model_weight_table(driven())
    assert [row[0] for row in sheet.rows] == ["a", "b", "c"]
    assert sheet.rows[0][1:5] == ("10.0", "8.8 (7.0 to 9.5)", "88 % (70 % to 95 %)", "20 %")


def test_a_model_that_predicts_badly_weighs_less_in_the_report():
    errors = prediction({"persistence": 0.9, "a": 0.1, "b": 0.1, "c": 1.0})
    weights = chosen.report(errors, matrix(FORECAST, robot="car")).forecasts["a"].weights
    assert weights["b"] == pytest.approx(2.0 * weights["a"])
    assert weights["b"] == pytest.approx(100.0 * weights["c"])


def test_a_report_without_a_forecast_has_no_column_of_it():
    alone = chosen.report(transfer=matrix({"a": {"a": 9.0, "car": 8.0}}, robot="car"))
    assert "forecast\n(90 %)" not in fitness_table(alone).columns


def test_the_document_holds_what_was_predicted_and_what_came_of_it():
    found = json.loads(json.dumps(to_json(driven())["controllers"], allow_nan=False))
    first = found["controllers"][0]
    forecast = first["forecast"]
    assert (first["name"], first["achieved"]["value"], forecast["covers_achieved"]) == ("a", 8.5, True)
    assert forecast["low"] < forecast["value"] < forecast["high"]
    assert found["model_forecasts"][0]["model"] == "a"
    assert found["forecast_rule"]["share"] == 0.9


def test_the_papers_own_cells_give_the_papers_table():
    sheet = paper_sheet(paper_matrix())
    assert sheet.columns == ("controller", "bp27", "param", "evo3", "nn", "real")
    assert [row[0] for row in sheet.rows] == ["bp27c", "paramc", "evo3c", "nnc", "mm1c"]
    assert sheet.rows[0][1:] == (
        "18.6 (0.0)\npaper 18.6", "9.0 (0.0)\npaper 9", "1.3 (0.0)\npaper 1.3", "14.0 (0.0)\npaper 14",
        "9.3 (0.0)\npaper 9.33",
    )  # fmt: skip
    for row in sheet.rows:
        for cell in row[1:]:
            here, there = cell.split("\n")
            assert float(here.split()[0]) == pytest.approx(float(there.split()[1]), abs=0.05)


@pytest.mark.skipif(not PAPER.is_file(), reason="the paper lies beside a checkout, not in it")
def test_the_numbers_of_the_paper_are_those_of_its_table():
    table = json.loads(PAPER.read_text())["table_2"]
    assert table["columns"][:-1] == list(FAMILIES)
    assert {name: list(row) for name, row in CONTROLLERS.values()} == {
        name: row for name, row in table["mean"].items() if not name.startswith("hum")
    }


def test_who_drove_by_hand_has_a_row_and_what_is_missing_is_a_dash():
    paper = paper_matrix()
    cells = {**paper.cells, ("human", "real"): Cell("human", "real", np.array([6.0, 8.0]))}
    cells |= {("human", column): Cell("human", column, reason="not run") for column in paper.models}
    with_person = TransferMatrix.of((*paper.champions, human_driver()), paper.columns, cells.values(), robot="real")
    assert paper_sheet(with_person).rows[-1] == ("human", "–", "–", "–", "–", "7.0")


def test_without_the_four_models_or_the_papers_preset_there_is_no_such_table():
    assert paper_sheet(matrix({"parametrised": {"parametrised": 1.0, "evolved3": 2.0}})) is None
    for preset, shown in (("quick", False), ("paper", True)):
        made = replace(chosen.report(transfer=paper_matrix()), settings={"preset": preset})
        assert any("Table 2" in sheet.title for sheet in controllers_section.section(made).sheets) == shown


def test_the_correlations_of_residuals_are_drawn_with_their_bands_for_each_state_and_control(assessed):
    picture = residual_picture(assessed)
    assert len(picture.panels) == assessed.cases.system.nx * (1 + assessed.cases.system.nu)
    assert picture.panels[0].title == "forward_speed and earlier residuals"
    shown = drawn(picture.panels[0])
    assert [key.label for key in shown.legend] == ["known", "grip"]
    values = json.loads(shown.chart)["axes"][0]["series"][0]["value"]
    assert values == pytest.approx(assessed.model("known").residuals.autocorrelation[:, 0], rel=1e-3)
    assert residual_picture(prediction({"linear": 0.3})) is None


def test_the_note_on_weights_tells_how_well_each_figure_ranks_the_controllers():
    note = model_weight_table(driven()).note
    assert "Rank correlation of claimed with achieved: -1.00 (3 controllers)." in note
    assert "Rank correlation of forecast with achieved: +1.00 (3 controllers)." in note


def test_a_reader_chooses_among_the_most_varied_test_episodes(assessed):
    picture = free_run_picture(assessed)
    assert picture.choose == "Test episode"
    titles = [panel.title for panel in picture.panels]
    spread = {
        run.episode: float((run.states.std(axis=0) / assessed.cases.std).mean()) for run in assessed.cases.free_runs
    }
    assert len(spread) > 3
    assert titles == sorted(spread, key=lambda name: -spread[name])[:3]


def test_a_card_of_a_model_has_its_equations_parameters_and_settings():
    rows = ({"parameter": "mass", "value": 1.5, "standard error": 0.02, "unit": "kg", "low": 0.0, "high": None,
             "determined": True},)  # fmt: skip
    known = ModelSummary("mine", "single_track", "grey", {"lags": 2}, ("v' = -v / tau",), rows, ({"model": "narx"},))
    report = replace(chosen.report(prediction({"persistence": 0.9, "mine": 0.3})), models=(known,))
    (card,) = models_section.section(report).items
    assert card.title == "mine: N 0.300, grey box"
    tables = {sheet.title: sheet.rows for sheet in card.items}
    assert tables["Parameters of mine"] == (("mass", "1.50 ± 0.02", "kg", "0 to –", "yes"),)
    assert tables["Equations of mine"] == (("v'", "-v / tau"),)
    assert tables["Candidates of mine"] == (("narx",),)
    assert ("lags", "2") in tables["Hyper-parameters of mine"]


def test_a_card_lists_poles_with_frequency_damping_and_time_constant():
    point = OperatingPoint.of(recording())
    poles = (0.5, 1.0, 1.05, -0.8, 0.01)
    mixed = np.diag(poles)
    mixed = np.block([[mixed, np.zeros((5, 2))], [np.zeros((2, 5)), np.array([[0.6, 0.6], [-0.6, 0.6]])]])
    table = models_section.pole_table("mine", LinearResponse(mixed, np.zeros((7, 2)), 3, 0.05), point)
    assert table.rows[0] == ("1.05", "0.976", "0.976", "-1.00", "grows")
    assert table.rows[1] == ("1.00", "0.000", "0.000", "–", "–")
    assert table.rows[2] == ("0.600 ± 0.600j", "-3.29 ± 15.7j", "16.0", "0.205", "0.304")
    assert table.rows[3][:2] == ("-0.800", "-4.46 + 62.8j")  # it has no partner
    assert table.rows[4] == ("0.500", "-13.9", "13.9", "1.00", "0.072")
    assert len(table.rows) == 5
    assert "forward_speed -0.057 m/s" in table.note
    assert "dt = 0.05 s" in table.note
    many = models_section.pole_table("mine", LinearResponse(np.diag(np.arange(1, 11) / 11), mixed, 3, 0.05), point)
    assert len(many.rows) == models_section.SHOWN_POLES
    assert "2 faster poles are left out." in many.note


def test_parameters_that_are_determined_together_are_named_once_the_strongest_first():
    rows = [
        {
            "parameter": name,
            "value": 1.0,
            "standard error": 0.1,
            "unit": "",
            "low": 0.0,
            "high": 2.0,
            "correlations": others,
        }
        for name, others in (("a", {"b": -0.95, "c": 0.99}), ("b", {"a": -0.95}), ("c", {"a": 0.99}), ("d", {}))
    ]
    card = ModelSummary("mine", "single_track", "grey", {}, parameters_table=tuple(rows))
    (fold, *_) = models_section.section(replace(chosen.report(), models=(card,))).items
    assert "Correlated: a and c (+0.990), a and b (-0.950). The data determine such a pair" in fold.items[0].note
    apart = replace(card, parameters_table=tuple({**row, "correlations": {}} for row in rows))
    assert models_section.section(replace(chosen.report(), models=(apart,))).items[0].items[0].note == ""


def test_responses_of_all_linearised_models_stand_in_two_figures_and_the_others_have_a_reason():
    report = chosen.make_report({"known": fitted(Known()), "rough": fitted(Undefined())}, robot=False)
    found = models_section.section(report)
    assert found.absent == ["Not linearised, so without poles and responses: rough (its next state is not a number)."]
    known, rough = to_json(report)["models"]
    assert known["linear"]["poles"] == [[z.real, z.imag] for z in report.models[0].linear.poles] != []
    assert (rough["linear"], rough["not_linearised"]) == (None, "its next state is not a number")
    steps, gains = found.pictures
    values = json.loads(drawn(steps.panels[0]).chart)
    assert values["names"] == ["linear fit", "known"]
    assert len(values["axes"]) == 6  # three states, two controls
    speed_by_drive = {series["n"]: series["value"] for series in values["axes"][0]["series"]}
    assert speed_by_drive[1][:2] == pytest.approx([0.0, 0.12])
    assert speed_by_drive[1] == pytest.approx(speed_by_drive[0])  # the model is the truth, and linear
    assert speed_by_drive[1][-1] == pytest.approx(0.12 / (1.0 - 0.92), rel=0.1)
    gain = json.loads(drawn(gains.panels[0]).chart)["axes"][0]["series"][1]["value"]
    assert gain[0] > gain[-1]
    assert gain[-1] == pytest.approx(0.12 / 1.92, rel=0.01)  # half the sampling frequency: z = -1
    without = replace(report, models=tuple(replace(one, linear=None) for one in report.models))
    assert models_section.section(without).pictures == ()


def test_a_figure_of_responses_has_the_states_and_controls_with_the_largest_effect():
    count = 6
    system = System(
        [Channel(f"x{i}") for i in range(count)], [Channel(f"u{i}", low=-1.0, high=1.0) for i in range(5)], 0.1
    )
    rng = np.random.default_rng(0)
    effect, states, controls = np.zeros((count, 5)), [np.zeros(count)], rng.uniform(-1.0, 1.0, (400, 5))
    for state, control in ((1, 4), (2, 0), (3, 2), (5, 0)):
        effect[state, control] = 1.0
    for u in controls:
        states.append(0.8 * states[-1] + effect @ u + rng.normal(size=count))
    data = DataSummary.of(*[Dataset.from_arrays(system, [np.array(states)], [controls])] * 2)
    known = ModelSummary("mine", "mine", "black", {}, linear=LinearResponse(0.8 * np.eye(count), effect, count, 0.1))
    (steps, _) = models_section.response_pictures(replace(chosen.report(), data=data, models=(known,)))
    assert "The states and controls with the largest effect." in steps.caption
    figure = new_figure(8.0, 8.0)
    steps.panels[0].wide.draw(figure)
    assert [ax.get_title() for ax in figure.axes[:3]] == ["u0", "u2", "u4"]
    assert [ax.get_ylabel() for ax in figure.axes[::3]] == ["x1", "x2", "x3", "x5"]


def test_the_first_use_of_a_word_in_a_section_is_explained_and_names_stay_text():
    words = Words(numbers := count())
    first, second = words.explained("N is low for <b>; a forecast"), words.explained("N again, forecasts")
    assert [first.count("popovertarget"), second.count("popovertarget")] == [2, 0]
    assert "&lt;b&gt;" in first
    assert explained_words()["forecast"][1] in first
    assert Words(numbers).explained("N").count('id="word-2"') == 1


def test_every_explained_word_is_a_sentence_of_the_glossary():
    assert all(sentence.endswith(".") for _, sentence in explained_words().values())
