"""Table 2 of the paper, from the cells of a comparison."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from evaluation.report.sections import transfer as section
from evaluation.report.sections.transfer import CONTROLLERS, FAMILIES, paper_sheet
from evaluation.transfer import Cell, TransferMatrix, person
from tests.fixtures import reports as made_up
from tests.fixtures.reports import paper_matrix

TABLES = Path(__file__).parents[2] / "shared" / "paper" / "tables.json"


def test_the_papers_own_cells_give_the_papers_table() -> None:
    sheet = paper_sheet(paper_matrix())
    assert sheet is not None
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


@pytest.mark.skipif(not TABLES.is_file(), reason="the paper lies beside a checkout, not in it")
def test_the_numbers_of_the_paper_are_those_of_its_table() -> None:
    table = json.loads(TABLES.read_text())["table_2"]
    assert table["columns"][:-1] == list(FAMILIES)
    assert {name: list(row) for name, row in CONTROLLERS.values()} == {
        name: row for name, row in table["mean"].items() if not name.startswith("hum")
    }


def test_who_drove_by_hand_has_a_row_and_what_is_missing_is_a_dash() -> None:
    matrix = paper_matrix()
    cells = {**matrix.cells, ("human", "real"): Cell("human", "real", np.array([6.0, 8.0]))}
    for column in matrix.models:
        cells["human", column] = Cell("human", column, reason="not run")
    driven = TransferMatrix.of((*matrix.champions, person()), matrix.columns, cells.values(), robot="real")
    sheet = paper_sheet(driven)
    assert sheet is not None
    assert sheet.rows[-1] == ("human", "–", "–", "–", "–", "7.0")


def test_without_the_four_models_or_the_papers_preset_there_is_no_such_table() -> None:
    assert paper_sheet(made_up.matrix({"parametrised": {"parametrised": 1.0, "evolved3": 2.0}})) is None
    shown = {}
    for preset in ("quick", "paper"):
        report = made_up.report(transfer=paper_matrix())
        object.__setattr__(report, "settings", {"preset": preset})
        shown[preset] = [sheet.title for sheet in section.section(report).sheets]
    assert not any("Table 2" in title for title in shown["quick"])
    assert any("Table 2" in title for title in shown["paper"])
