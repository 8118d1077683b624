"""Cells and plans: the inputs of a digest, and the order of cells."""

import pickle
from dataclasses import dataclass, replace

import pytest

from sysid_evo.errors import InvalidArgument
from sysid_evo.plan import CELL_KINDS, Plan, cell_seed
from sysid_evo.plan import cell as module
from sysid_evo.plan.plan import YEAR, local_cells
from tests.fixtures.cells import Number, number, tolerant


def test_every_input_the_kind_and_each_need_decide_the_digest_and_a_label_does_not():
    need = number(3)
    one = number(1, (need,))
    assert one.digest == number(1, (number(3, label="three"),), label="other").digest
    others = [number(2, (need,)), number(1), number(1, (number(4),)), number(1, (need, need)), tolerant(1, (need,))]
    assert len({one.digest, *(other.digest for other in others)}) == 6


def lasting(years, label):
    return replace(number(years, label=label), expected_seconds=years * YEAR)


def test_a_plan_of_ten_years_is_the_longest_and_a_longer_one_names_its_longest_cell():
    few = [lasting(3, "three"), lasting(6.9, "most"), lasting(0.05, "least")]
    assert len(Plan.of(few)) == 3
    with pytest.raises(InvalidArgument) as refused:
        Plan.of([*few, lasting(0.1, "last")])
    assert str(refused.value) == (
        "plan: count most would take about 6.9 years on one processor; the limit of a plan is 10 years. Reduce "
        "generations, trials, their steps, repeats or minutes"
    )
    with pytest.raises(InvalidArgument, match=r"count one would take about 3.2e\+12 years on one processor"):
        Plan.of([number(1), lasting(1e20 / YEAR, "one")])


def test_the_order_of_needs_decides_the_digest():
    one, two = number(1), number(2)
    assert number(0, (one, two)).digest != number(0, (two, one)).digest


def test_another_contract_is_another_digest(monkeypatch):
    before = number(1).digest
    monkeypatch.setattr(module, "CONTRACT", module.CONTRACT + 1)
    assert number(1).digest != before


def test_cells_are_equal_when_their_digests_are():
    assert number(1, label="a") == number(1, label="b")
    assert len({number(1, label="a"), number(1, label="b"), number(2)}) == 2
    assert number(1) != "one"


def test_an_input_that_is_no_json_number_is_refused():
    with pytest.raises(ValueError, match="not JSON compliant"):
        _ = number(float("nan")).digest


def test_each_cell_comes_once_and_after_what_it_needs():
    base = number(1, label="base")
    left, right = number(2, (base,), "left"), number(3, (number(1, label="the same base"),), "right")
    top = number(4, (right, left), "top")
    plan = Plan.of([top, left, base])
    names = [cell.name for cell in plan]
    assert len(plan) == 4
    assert all(names.index(needed) < names.index(cell) for cell in ("left", "right") for needed in names[:1])
    assert names[-1] == "top"
    assert [cell.name for cell in plan.of_kind("number")] == names
    assert plan.of_kind("other") == ()


def test_the_order_does_not_hang_on_the_order_of_what_is_wanted():
    chain = [number(0)]
    for i in range(1, 6):
        chain.append(number(i, (chain[-1],), str(i)))
    assert Plan.of(reversed(chain)).cells == tuple(chain)


def test_a_wide_plan_does_not_follow_every_path():
    asked = []

    class Asked(Number):
        def inputs(self):
            asked.append(self.number)
            return super().inputs()

    layer = (Asked(0).cell(),)
    for depth in range(7):  # every path counted alone, there would be 3**7
        layer = tuple(Asked(10 * depth + i + 1, layer).cell() for i in range(3))
    assert len(Plan.of(layer)) == 22
    assert len(asked) == len(set(asked)) == 22


def test_a_raised_version_changes_the_digests_of_its_kind_and_of_what_needs_them(monkeypatch):
    def digests():
        return [cell.digest for cell in (number(1), tolerant(1), tolerant(1, (number(1),)))]

    before = digests()
    monkeypatch.setitem(CELL_KINDS, "number", replace(CELL_KINDS["number"], version=2))
    assert [a == b for a, b in zip(before, digests(), strict=True)] == [False, True, False]


def test_labels_are_put_back_where_the_result_has_as_many():
    @dataclass(frozen=True)
    class Result:
        name: str
        against: tuple[str, ...]

    cell = replace(number(1), labels={"name": "new", "against": ("a", "b")})
    assert cell.labelled(Result("old", ("x", "y"))) == Result("new", ("a", "b"))
    assert cell.labelled(Result("old", ("x",))) == Result("new", ("x",))  # the other was left out
    assert number(1).labelled(3) == 3


def test_a_cell_travels_in_memory_as_it_is():
    cell = pickle.loads(pickle.dumps(tolerant(2, (number(1),), "two")))
    assert cell == tolerant(2, (number(1),), "two")
    assert (cell.title, cell.tolerant, cell.settings) == ("count two", True, Number(2, (number(1),), "two"))


def test_the_seed_of_a_cell_depends_on_the_seed_and_the_work_alone():
    found = [cell_seed(seed, work) for seed in (0, 1) for work in ("fit a", "fit b")]
    assert len(set(found)) == 4
    assert found[0] == cell_seed(0, "fit a")


def test_what_needs_a_cell_that_stays_with_the_run_folder_stays_there_too():
    home = Number(1, label="home").cell(local_only=True)
    after = number(2, (home,), label="after")
    plan = Plan.of([home, after, number(3, (after,), label="last"), number(4, label="free")])
    assert {cell.name for cell in plan if cell.digest in local_cells(plan)} == {"home", "after", "last"}
