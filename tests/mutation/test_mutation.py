"""The command that changes one line of the product at a time, on a product of one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.mutation.__main__ import ROOT, main
from tests.mutation.change import Change
from tests.mutation.changes import ALL

PRODUCT = "def double(number):\n    return 2 * number\n"
TESTS = """from product import double


def test_doubles():
    assert double(3) == 6


def test_sees_nothing():
    assert double(0) == 0
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A product of one function with two tests, of which one sees less."""
    root = tmp_path / "tree"
    root.mkdir()
    (root / "product.py").write_text(PRODUCT)
    (root / "test_product.py").write_text(TESTS)
    return root


def change(breaks: str, old: str, new: str, test: str = "") -> Change:
    return Change(breaks, "product.py", old, new, (f"test_product.py{test and f'::{test}'}",))


def test_a_change_is_caught_by_the_test_that_sees_it_and_the_tree_stays_as_it_is(
    tree: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([], root=tree, changes=[change("it triples", "2 *", "3 *")]) == 0
    shown = "".join(capsys.readouterr().out.split())
    assert "test_product.py::test_doubles" in shown
    assert "1of1caught,100%" in shown
    assert (tree / "product.py").read_text() == PRODUCT


def test_a_change_that_no_test_sees_survives_and_one_that_does_not_fit_is_stale(
    tree: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changes = [
        change("it triples", "2 *", "3 *", "test_sees_nothing"),
        change("it adds", "number +", "number -"),
        change("it has no name", "number", "n"),
    ]
    assert main([], root=tree, changes=changes) == 1
    shown = " ".join(capsys.readouterr().err.split())
    assert "it triples: SURVIVED" in shown
    assert "it adds: NOT TRIED: expected its text once in product.py, found it 0 times" in shown
    assert "it has no name: NOT TRIED: expected its text once in product.py, found it 2 times" in shown


def test_a_test_that_fails_anyway_catches_nothing(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tree / "test_product.py").write_text(TESTS.replace("== 6", "== 7"))
    (tree / "test_broken.py").write_text("import nothing_of_this_name\n")
    broken = Change("it triples", "product.py", "2 *", "3 *", ("test_broken.py",))
    assert main([], root=tree, changes=[broken, change("it triples", "2 *", "3 *")]) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "test_broken.py fails without it" in said
    assert "test_doubles fails without it" in said


def test_changes_are_chosen_by_a_word_and_listed(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    changes = [change("it triples", "2 *", "3 *"), change("it adds", "2 *", "2 +")]
    assert main(["--list", "--only", "adds"], root=tree, changes=changes) == 0
    assert capsys.readouterr().out.splitlines() == ["product.py: it adds"]
    assert main(["--only", "divides"], root=tree, changes=changes) == 1


def test_every_change_fits_the_tree() -> None:
    assert len(ALL) >= 40
    assert [f"{one.breaks}: {stale}" for one in ALL if (stale := one.stale(ROOT))] == []
