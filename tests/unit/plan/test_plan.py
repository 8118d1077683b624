"""Cells and plans: what a digest depends on, and in which order cells stand."""

import sys
from dataclasses import dataclass, field, replace

import pytest

from sysid_evo.errors import InvalidArgument
from sysid_evo.plan import Again, Cell, Plan, cell_seed
from sysid_evo.plan import cell as module
from sysid_evo.plan.plan import YEAR
from tests.fixtures.cells import Number, Tolerant


def test_every_input_the_kind_and_each_need_decide_the_digest_and_a_label_does_not():
    need = Number(3)
    one = Number(1, (need,))
    assert one.digest == Number(1, (Number(3, label="three"),), label="other").digest
    others = [Number(2, (need,)), Number(1), Number(1, (Number(4),)), Number(1, (need, need)), Tolerant(1, (need,))]
    assert len({one.digest, *(other.digest for other in others)}) == 6


@dataclass(frozen=True, eq=False)
class Lasting(Number):
    """Takes as many years as its number says."""

    def seconds(self):
        return self.number * YEAR


def test_a_plan_of_ten_years_is_the_longest_and_a_longer_one_names_its_longest_cell():
    few = [Lasting(3, label="three"), Lasting(6.9, label="most"), Lasting(0.05, label="least")]
    assert len(Plan.of(few)) == 3
    with pytest.raises(InvalidArgument) as refused:
        Plan.of([*few, Lasting(0.1, label="last")])
    assert str(refused.value) == (
        "plan: count most would take about 6.9 years on one processor, and no plan of more than 10 years is begun: ask "
        "for less of it, such as generations, trials, runs, minutes"
    )
    with pytest.raises(InvalidArgument, match=r"count one would take about 3.2e\+12 years on one processor"):
        Plan.of([Number(1), Lasting(1e20 / YEAR)])


def test_the_order_of_needs_decides_the_digest():
    one, two = Number(1), Number(2)
    assert Number(0, (one, two)).digest != Number(0, (two, one)).digest


def test_another_contract_is_another_digest(monkeypatch):
    before = Number(1).digest
    monkeypatch.setattr(module, "CONTRACT", module.CONTRACT + 1)
    assert Number(1).digest != before


def test_cells_are_equal_when_their_digests_are():
    assert Number(1, label="a") == Number(1, label="b")
    assert len({Number(1, label="a"), Number(1, label="b"), Number(2)}) == 2
    assert Number(1) != "one"


def test_an_input_that_is_no_json_number_is_refused():
    with pytest.raises(ValueError, match="not JSON compliant"):
        _ = Number(float("nan")).digest


def test_each_cell_comes_once_and_after_what_it_needs():
    base = Number(1, label="base")
    left, right = Number(2, (base,), "left"), Number(3, (Number(1, label="the same base"),), "right")
    top = Number(4, (right, left), "top")
    plan = Plan.of([top, left, base])
    names = [cell.name for cell in plan]
    assert len(plan) == 4
    assert all(names.index(needed) < names.index(cell) for cell in ("left", "right") for needed in names[:1])
    assert names[-1] == "top"
    assert [cell.name for cell in plan.of_kind("number")] == names
    assert plan.of_kind("other") == ()


def test_the_order_does_not_hang_on_the_order_of_what_is_wanted():
    chain = [Number(0)]
    for i in range(1, 6):
        chain.append(Number(i, (chain[-1],), str(i)))
    assert Plan.of(reversed(chain)).cells == tuple(chain)


def test_a_wide_plan_does_not_follow_every_path():
    asked = []

    class Asked(Number):
        @property
        def needs(self):
            asked.append(self.number)
            return self.required

    layer = (Asked(0),)
    for depth in range(7):  # every path counted alone, there would be 3**7
        layer = tuple(Asked(10 * depth + i, layer) for i in range(3))
    assert len(Plan.of(layer)) == 22
    assert max(asked.count(number) for number in set(asked)) <= 4, "not once for every path"


@dataclass(frozen=True, eq=False)
class Circular(Number):
    """Needs what is put into it later."""

    later: list[Cell] = field(default_factory=list)

    @property
    def needs(self):
        return tuple(self.later)


def test_a_circle_is_refused_in_a_sentence():
    first = Circular(label="first")
    second = Circular(label="second", later=[first])
    first.later.append(second)
    with pytest.raises(InvalidArgument, match="plan: count first needs itself"):
        Plan.of([first])
    alone = Circular(label="alone")
    alone.later.append(alone)
    with pytest.raises(InvalidArgument, match="plan: count alone needs itself"):
        Plan.of([Number(1), alone])


def test_the_seed_of_a_cell_depends_on_the_seed_and_the_work_alone():
    found = [cell_seed(seed, work) for seed in (0, 1) for work in ("fit a", "fit b")]
    assert len(set(found)) == 4
    assert found[0] == cell_seed(0, "fit a")
    assert replace(Number(1), label="x").digest == Number(1).digest


def test_what_a_plan_is_made_with_is_imported_before_the_work_begins(tmp_path, monkeypatch):
    (tmp_path / "made_for_one_plan.py").write_text("def cells(settings, folder):\n    return [*settings, folder]\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "made_for_one_plan", raising=False)
    again = Again("made_for_one_plan:cells", {"n": 1})
    again.prepare()
    assert "made_for_one_plan" in sys.modules
    assert again.plan(tmp_path) == ["n", tmp_path]
    monkeypatch.delitem(sys.modules, "made_for_one_plan")
    with pytest.raises(ModuleNotFoundError, match="no_such_module"):
        Again("no_such_module:cells", {}).prepare()
