"""Cells measured once, on robots that are driven and by people, in the matrix of a run."""

from dataclasses import replace

import numpy as np
import pytest

from evaluation.transfer.matrix import (
    NOT_RUN,
    MeasuredResult,
    TransferMatrix,
    human_driver,
    load_measured,
    save_measured,
    with_measured,
)
from evaluation.transfer.matrix import TransferResult as Cell
from evaluation.transfer.summary import summarise, summary_of
from sysid_evo.evolution import Champion
from tests.fixtures.known_models import SYSTEM

ROWS = tuple(
    Champion(name, np.array([0.1, 1 / 3]), (name,), "min", 3, np.ones((2, 3)), estimator_delay=0.02) for name in "ab"
)


def cell(row, column, *fitness):
    return Cell(row, column, np.array(fitness), unit="waypoints", engine="robot")


def computed(robot=None):
    columns = ("a", "b", "c", *((robot,) if robot else ()))
    cells = [cell(row.name, column, 5.0, 7.0, 9.0) for row in ROWS for column in columns]
    return TransferMatrix.of(ROWS, columns, cells, families={"a": "f", "b": "g", "c": "h"}, robot=robot)


def driven(row, column, *fitness, physical=True):
    return MeasuredResult(row, cell(row.name, column, *fitness), on_robot=True, physical=physical)


def test_driven_robot_becomes_the_achieved_column_and_gaps_are_no_failures():
    matrix = with_measured(computed(), [driven(ROWS[0], "car", 4.0, 6.0)])
    assert (matrix.robot, matrix.columns, matrix.models) == ("car", ("a", "b", "c", "car"), ("a", "b", "c"))
    assert matrix.cell("b", "car").reason == NOT_RUN
    assert matrix.failures() == ()
    summary = summarise(matrix)
    assert summary.controller("a").achieved.value == 5.0
    assert summary.controller("a").reality_gap.value == pytest.approx(2.0)
    assert summary.controller("b").achieved is None


def test_physical_robot_counts_before_the_emulated_one_which_is_no_model_either():
    emulated = driven(ROWS[0], "emulated driven", 8.0, physical=False)
    matrix = with_measured(computed("emulated"), [driven(ROWS[0], "car", 4.0), emulated])
    assert (matrix.robot, matrix.other_robots) == ("car", ("emulated", "emulated driven"))
    assert matrix.models == ("a", "b", "c")
    assert matrix.columns[-1] == "car"
    # one that is driven does not take the place of the one of the run
    matrix = with_measured(computed("emulated"), [emulated])
    assert (matrix.robot, matrix.other_robots) == ("emulated", ("emulated driven",))


def test_person_is_a_row_that_claims_nothing_and_is_never_chosen():
    human = human_driver("anna")
    cells = [MeasuredResult(human, cell("anna", column, 50.0, 60.0), on_robot=False) for column in ("a", "b", "c")]
    matrix = with_measured(computed(), [*cells, driven(human, "car", 70.0), driven(ROWS[1], "car", 2.0)])
    assert matrix.rows == ("a", "b", "anna")
    summary = summarise(matrix)
    assert summary.controller("anna").claimed is None
    assert summary.controller("anna").achieved.value == 70.0
    named = replace(matrix, champions=tuple(replace(one, system=SYSTEM) for one in matrix.champions if one.against))
    assert summary_of(named).pick in ("a", "b")
    assert matrix.families["a"] == "f"


def test_measured_cells_alone_make_a_matrix_and_none_leave_it_as_it_is():
    alone = with_measured(None, [driven(ROWS[0], "car", 4.0)])
    assert (alone.rows, alone.columns, alone.robot) == (("a",), ("car",), "car")
    assert with_measured(None, []) is None
    assert with_measured(matrix := computed(), []) is matrix


def test_measured_cells_come_back_and_the_newest_of_a_place_counts(tmp_path):
    save_measured(tmp_path, driven(ROWS[0], "robots/car:3", 4.0, 6.0))
    missing = replace(cell("anna", "a", 3.0), missing=("interrupted",))
    save_measured(tmp_path, MeasuredResult(human_driver("anna"), missing, on_robot=False))
    save_measured(tmp_path, driven(ROWS[0], "robots/car:3", 1.0))
    found = {item.champion.name: item for item in load_measured(tmp_path)[0]}
    assert set(found) == {"a", "anna"}
    np.testing.assert_array_equal(found["a"].cell.fitness, [1.0])
    np.testing.assert_array_equal(found["a"].champion.parameters, ROWS[0].parameters)
    assert found["a"].champion.against == ("a",)
    assert found["a"].champion.estimator_delay == 0.02
    assert (found["a"].on_robot, found["a"].physical) == (True, True)
    assert (found["anna"].cell.missing, found["anna"].on_robot) == (("interrupted",), False)


def test_cells_of_one_controller_on_two_robots_are_in_two_columns(tmp_path):
    save_measured(tmp_path, driven(ROWS[0], "car", 4.0))
    save_measured(tmp_path, driven(ROWS[0], "truck", 9.0))
    matrix = with_measured(computed(), load_measured(tmp_path)[0])
    assert matrix.columns == ("a", "b", "c", "car", "truck")
    assert [matrix.cell("a", column).mean for column in ("car", "truck")] == [4.0, 9.0]


def test_damaged_cell_is_a_remark_that_names_the_file_and_the_others_are_read(tmp_path):
    path = save_measured(tmp_path, driven(ROWS[0], "car", 4.0))
    save_measured(tmp_path, driven(ROWS[1], "car", 5.0))
    path.write_text(path.read_text().replace('"cell"', '"sell"'))
    (left,), (remark,) = load_measured(tmp_path)
    assert left.champion.name == "b"
    assert remark.startswith(f"{path} is damaged and left out: KeyError")


def test_who_drove_on_what_decides_the_digest_of_a_measured_cell():
    one = driven(ROWS[0], "car", 4.0)
    assert one.digest == driven(ROWS[0], "car", 4.0).digest
    others = [driven(ROWS[1], "car", 4.0), driven(ROWS[0], "cat", 4.0), driven(ROWS[0], "car", 4.5)]
    assert len({one.digest, *(other.digest for other in others)}) == 4
