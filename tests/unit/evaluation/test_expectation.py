"""What to expect of a controller: claimed, achieved, worst case, with intervals over trials."""

import json
from dataclasses import replace

import numpy as np
import pytest

from evaluation.report.render.terminal import WIDTH, table_lines
from evaluation.report.report import to_json
from evaluation.report.sections.controllers import fitness_table, further_figures_table
from evaluation.report.sections.transfer import transfer_sheet
from evaluation.transfer.matrix import TransferMatrix
from evaluation.transfer.matrix import TransferResult as Cell
from evaluation.transfer.summary import MatrixEstimates, summarise
from sysid_evo.validation.estimates import CONFIDENCE
from tests.fixtures import reports as made_up
from tests.fixtures.reports import champion

FITNESS = {
    "a": {"a": 12.0, "b": 11.0, "c": 2.0, "car": 9.0},
    "b": {"a": 10.0, "b": 12.5, "c": 4.0, "car": 10.0},
    "hand": {"a": 6.0, "b": 6.5, "c": 5.0, "car": 7.0},
}


def summaries(matrix):
    return {one.name: one for one in summarise(matrix).controllers}


def test_the_worst_case_leaves_out_what_a_controller_was_evolved_against():
    found = summaries(made_up.matrix(FITNESS, robot="car", against={"hand": ()}))
    assert {name: (one.worst.value, one.worst_on) for name, one in found.items() if one.worst} == {
        "a": (2.0, "c"),
        "b": (4.0, "c"),
        "hand": (5.0, "c"),
    }
    assert [round(one.kept.value, 3) for one in found.values() if one.kept] == [0.75, 0.8]
    assert found["hand"].claimed is found["hand"].kept is None


def test_shares_are_measured_from_controls_at_rest():
    fitness = {"rest" if row == "hand" else row: values for row, values in FITNESS.items()}
    found = summaries(made_up.matrix(fitness, robot="car"))
    assert found["a"].kept.value == pytest.approx((9.0 - 7.0) / (12.0 - 7.0))


def test_a_claim_that_is_that_of_controls_at_rest_has_no_share():
    for name, kept in (("hand", pytest.approx(9.0 / 7.0)), ("rest", None)):
        fitness = {"a": {"a": 7.0, "car": 9.0}, name: {"a": 6.0, "car": 7.0}}
        found = summaries(made_up.matrix(fitness, robot="car", against={name: ()}))["a"].kept
        assert (found and found.value) == kept


def test_intervals_are_over_trials_and_say_so():
    matrix = made_up.matrix(FITNESS, robot="car", against={"hand": ()})
    summary = summarise(matrix)
    achieved = summary.controller("a").achieved
    assert achieved.value == 9.0
    assert achieved.high - achieved.low < 0.2
    sheet = further_figures_table(matrix, summary)
    assert [row[0].split("\n")[0] for row in sheet.rows] == ["a", "b", "hand (baseline)"]
    assert "over fresh trials of this one controller, not over evolution runs" in sheet.note


def test_the_consensus_leaves_out_the_family_that_a_controller_was_evolved_in():
    cells = [
        Cell("c", column, np.full(4, value)) for column, value in (("a-1", 9.0), ("a-2", 8.0), ("b", 3.0), ("d", 5.0))
    ]
    families = {"a-1": "a", "a-2": "a", "b": "b", "d": "d"}
    matrix = TransferMatrix.of([champion("c", ("a-1",))], tuple(families), cells, families=families)
    consensus = MatrixEstimates(matrix).other_families(matrix.champions[0])
    assert consensus.value == 4.0
    sheet = transfer_sheet(matrix)
    assert sheet.columns[1] == "other\nfamilies"
    assert sheet.rows[0][1] == "4.00 ±0"


def test_the_robot_comes_first_then_the_consensus_then_the_models():
    sheet = transfer_sheet(made_up.matrix(FITNESS, robot="car", against={"hand": ()}))
    assert [column.split("\n")[0] for column in sheet.columns] == ["controller", "car", "other", "a", "b", "c"]
    assert sheet.heat.divided == 1
    assert sheet.heat.shades[0][1] == pytest.approx(6.5 / 12.5)


def test_the_short_table_of_controllers_fits_eighty_columns():
    def shown(sheet):
        return sum("Controllers: forecast" in str(part) for part in table_lines(sheet))

    fitness = {"nearest_neighbour": 12.0, "parametrised": 11.0, "emulated_car": 10.0}
    long = {"nearest_neighbour": fitness, "parametrised": {name: 24.0 - value for name, value in fitness.items()}}
    matrix = made_up.matrix(long, robot="emulated_car")
    wide = {key: replace(cell, fitness=cell.fitness + np.tile([-3.0, 3.0], 5)) for key, cell in matrix.cells.items()}
    matrix = replace(matrix, cells=wide)
    assert shown(fitness_table(made_up.report(transfer=matrix), short=True)) == 1
    assert WIDTH == 80


def test_report_json_holds_every_interval():
    matrix = made_up.matrix(FITNESS, robot="car", against={"hand": ()})
    document = json.loads(json.dumps(to_json(made_up.report(transfer=matrix)), allow_nan=False))
    assert document["schema"] == "sysid-evo/report/8"
    assert document["transfer"]["interval"] == CONFIDENCE
    cell = document["transfer"]["cells"][0]
    assert cell["interval"][0] < cell["mean"] < cell["interval"][1]
    first = document["controllers"]["controllers"][0]
    assert (first["other_family_models"], first["other_families"]["value"]) == (["b", "c"], 6.5)
