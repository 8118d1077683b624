"""How many cells are computed at once, in what order, and who may compute them."""

import pytest

from sysid_evo.errors import InvalidArgument
from sysid_evo.plan import Plan, Store, execute, executors
from sysid_evo.plan.executors import number_of_jobs
from sysid_evo.plan.plan import critical_path
from tests.fixtures.cells import number


def test_the_longest_way_comes_first():
    short, start = number(1, label="short"), number(2, label="start")
    middle = number(3, (start,), "middle")
    plan = Plan.of([short, number(4, (middle,), "end"), middle])
    ahead = critical_path(plan)
    assert [ahead[cell.digest] for cell in (short, start, middle)] == [1.0, 3.0, 2.0]


def test_there_are_as_many_jobs_as_processors_work_and_memory_are_there_for(monkeypatch):
    monkeypatch.delenv("SYSID_EVO_JOBS")
    monkeypatch.setattr(executors, "usable_processors", lambda: 8)
    monkeypatch.setattr(executors, "available_memory", lambda: 100 * 2**30)
    cells = [number(i) for i in range(20)]  # of one second each
    assert number_of_jobs(None, cells) == (int(20 / executors.SECONDS_PER_PROCESS), "")
    assert number_of_jobs(None, cells[:3]) == (1, "")
    assert number_of_jobs(None, [number(i) for i in range(500)]) == (8, "")
    assert number_of_jobs(30, cells) == (20, "")
    assert number_of_jobs(3, []) == (1, "")
    monkeypatch.setenv("SYSID_EVO_JOBS", "5")
    assert number_of_jobs(None, cells) == (5, "")
    assert number_of_jobs(2, cells) == (2, "")
    monkeypatch.setattr(executors, "available_memory", lambda: 3 * 2**30 + 5)
    assert number_of_jobs(2, cells) == (2, "")
    few = "3 instead of 5 cells are computed at the same time: 3.0 GiB of memory are free, and each may need 1 GiB"
    assert number_of_jobs(5, cells) == (3, few)
    monkeypatch.setattr(executors, "available_memory", lambda: 0)
    assert number_of_jobs(5, cells)[0] == 1


@pytest.mark.parametrize("wrong", ["0", "many", "-1"])
def test_a_number_of_jobs_that_is_none_is_refused(monkeypatch, wrong):
    monkeypatch.setenv("SYSID_EVO_JOBS", wrong)
    with pytest.raises(InvalidArgument, match="SYSID_EVO_JOBS: expected a number of jobs"):
        number_of_jobs(None, [])
    with pytest.raises(InvalidArgument, match="jobs: expected at least 1, got 0"):
        number_of_jobs(0, [])


def test_processes_here_and_a_scheduler_exclude_each_other(tmp_path):
    with pytest.raises(InvalidArgument, match="expected either jobs or a scheduler, got 2 jobs"):
        execute(Plan.of([number(1)]), Store(tmp_path), jobs=2, scheduler="tcp://127.0.0.1:9")


def test_free_memory_is_what_the_container_leaves(tmp_path, monkeypatch):
    limit, used = tmp_path / "memory.max", tmp_path / "memory.current"
    monkeypatch.setattr(executors, "LIMITS", (limit, used))
    assert executors.available_memory() > 0
    for allowed, taken, free in (("1000000\n", "400000\n", 600000), ("1000000\n", "2000000\n", 0)):
        limit.write_text(allowed)
        used.write_text(taken)
        assert executors.available_memory() == free
    limit.write_text("max\n")
    assert executors.available_memory() > 600000
