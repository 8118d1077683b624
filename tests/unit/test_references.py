"""The comparison of stored numbers: what it calls equal, moved, gone and new."""

import numpy as np
import pytest

from tests.references import difference, flat, guarded, listed, read, write

BEFORE = {
    "family/linear/car/learned/weights_": np.array([[1.0, 2.0], [3.0, np.nan]]),
    "family/linear/car/learned/name_": '"ridge"',
    "champion/niches/described/strategy": '"niches(strategy=cma_es)"',
}


def counted(before, after):
    """Return the line of the table for everything together, and the lines of what is not equal."""
    table, lines = listed(before, after)
    return [list(column.cells)[-1] for column in table.columns[1:]], lines


def test_what_was_stored_is_equal_to_itself(tmp_path):
    write(BEFORE, tmp_path)
    assert counted(read(tmp_path), BEFORE) == (["3", "0", "0", "0"], [])


def test_what_moved_is_listed_with_how_far_and_what_is_gone_or_new_by_name():
    moved = BEFORE["family/linear/car/learned/weights_"] + np.array([[0.0, 0.5], [0.0, 0.0]])
    after = {"family/linear/car/learned/weights_": moved, "family/linear/car/learned/name_": '"lasso"', "report/x": "1"}
    counts, lines = counted(BEFORE, after)
    assert counts == ["0", "2", "1", "1"]
    assert lines == [
        "champion/niches/described/strategy: gone",
        'family/linear/car/learned/name_: "ridge" -> "lasso"',
        "family/linear/car/learned/weights_: 1 of 4 values, by 0.5 at most (largest value 3)",
        "report/x: new",
    ]


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (np.array([1.0, 2.0]), "float64(1,) -> float64(2,)"),
        (np.array([1.0], dtype=np.float32), "float64(1,) -> float32(1,)"),
        (np.array([np.nextafter(1.0, 2.0)]), "1 of 1 values, by 2.22e-16 at most (largest value 1)"),
        ("one", "float64(1,) -> one"),
    ],
)
def test_the_last_bit_the_shape_and_the_type_count(other, said):
    assert difference(np.array([1.0]), other) == said


def test_an_array_that_differs_from_its_digest_ends_the_comparison(tmp_path):
    write(BEFORE, tmp_path / "first")
    write({**BEFORE, "family/linear/car/learned/weights_": np.zeros((2, 2))}, tmp_path / "second")
    (tmp_path / "second" / "references.safetensors").replace(tmp_path / "first" / "references.safetensors")
    with pytest.raises(SystemExit, match="differ from their digests"):
        read(tmp_path / "first")


def test_leaves_are_found_by_their_paths():
    found = flat("report", {"a": [1, 2.5], "b": [{"c": None}, "x"], "d": True})
    np.testing.assert_array_equal(found.pop("report/a"), [1.0, 2.5])
    assert found == {"report/b/0/c": "null", "report/b/1": '"x"', "report/d": "true"}


def test_work_that_fails_is_an_entry_that_says_so():
    def broken(name):
        raise ValueError(name)

    found, complaint = guarded(broken, ("linear",))
    assert found == {"failed/broken/linear": "ValueError"}
    assert complaint == "ValueError: linear"
