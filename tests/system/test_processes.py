"""Cells side by side, in real processes: the same results for any number of jobs, whatever becomes of a process."""

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from sysid_evo.errors import InvalidArgument
from sysid_evo.plan import Again, Plan, Store, execute, executors
from sysid_evo.plan.executors import number_of_jobs
from sysid_evo.plan.plan import work_ahead
from sysid_evo.processors import usable_processors
from tests.fixtures.cells import Number, Watching
from tests.fixtures.deeds import planned

ROOT = Path(__file__).parents[2]
ROW = [(f"row {i}", "wait 0.05", ["base"]) for i in range(4)]
LADDER = [("base", "", []), *ROW, ("top", "", [label for label, _, _ in ROW])]


@pytest.fixture(autouse=True)
def _others_find_the_tests(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)


def run(folder, plan, count=2):
    folder.mkdir(exist_ok=True)
    watching, store = Watching(), Store(folder)
    execute(plan, store, observer=watching, jobs=count)
    return watching, Store(folder)


def diary(folder):
    return Counter(line.split(" ", 1)[1] for line in (folder / "diary").read_text().splitlines())


def processes(folder):
    return {int(line.split(" ", 1)[0]) for line in (folder / "diary").read_text().splitlines()}


def gone(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    return False


def eventually(true, seconds=30.0):
    deadline = time.monotonic() + seconds
    while not true():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def test_the_results_are_the_same_for_any_number_of_jobs_and_nothing_is_computed_twice(tmp_path):
    found = []
    for count in (1, 2, 3):
        folder = tmp_path / str(count)
        plan = planned(folder / "diary", *LADDER, ("broken", "fail", []), ("after", "", ["broken"]),
                       ("tolerant", "", ["broken", "base"]))  # fmt: skip
        watching, store = run(folder, plan, count)
        assert set(diary(folder).values()) == {1}
        assert 1 <= len(processes(folder)) <= count  # one that starts late may find nothing left to do
        assert (os.getpid() in processes(folder)) == (count == 1)
        assert sorted(watching.computed) == sorted(cell.name for cell in plan)
        found.append([(cell.title, store.outcome(cell).value, store.outcome(cell).reason) for cell in plan])
        assert watching.remarks == []
    assert found[0] == found[1] == found[2]
    assert {title: reason for title, _, reason in found[0]}["count after"] == "needs count broken, which failed"
    assert all(eventually(lambda one=one: gone(one)) for one in processes(tmp_path / "3") - {os.getpid()})


def test_what_the_plan_is_made_of_is_computed_first_and_here(tmp_path):
    plan = planned(tmp_path / "diary", *LADDER, after=("base",))
    watching, store = run(tmp_path, plan)
    (first, *_) = (tmp_path / "diary").read_text().splitlines()
    assert first == f"{os.getpid()} base"
    assert len(processes(tmp_path)) > 1
    assert watching.remarks == []
    assert store.load(plan.cells[-1]) == 6 + sum(1 + n for n in (2, 3, 4, 5))


def test_nobody_is_asked_when_what_the_plan_is_made_of_failed(tmp_path):
    plan = planned(tmp_path / "diary", ("base", "fail", []), ("top", "", ["base"]), ("aside", "", []), after=("base",))
    watching, _ = run(tmp_path, plan)
    assert watching.failed == {"base": "there is too little of it", "top": "needs count base, which failed"}
    assert diary(tmp_path) == {"base": 1, "aside": 1}
    assert watching.remarks == []


@pytest.mark.parametrize("deed", ["kill 1", "kill 2", "exit"])
def test_a_process_that_ends_in_a_cell_costs_that_cell_alone_and_that_only_the_second_time(tmp_path, deed):
    plan = planned(tmp_path / "diary", ("bad", deed, []), ("worse", "", ["bad"]), *LADDER)
    watching, store = run(tmp_path, plan)
    why = "exit code 5" if deed == "exit" else "SIGKILL"
    assert watching.remarks == [f"the process of count bad ended ({why}): it is computed again"]
    assert diary(tmp_path)["bad"] == 2
    assert {name: times for name, times in diary(tmp_path).items() if times > 1} == {"bad": 2}
    assert store.load(plan.cells[-1]) == 8 + sum(3 + n for n in (4, 5, 6, 7))
    if deed == "kill 1":
        assert watching.failed == {}
        assert store.load(plan.cells[1]) == 3
    else:
        reason = f"its process ended 2 times ({why})"
        assert watching.failed == {"bad": reason, "worse": "needs count bad, which failed"}
        record = store.find(plan.cells[0].digest)
        assert record is not None
        assert (record.status, record.reason) == ("failed", reason)


def test_a_full_disk_stops_all_processes(tmp_path):
    plan = planned(tmp_path / "diary", ("full", "full", []), ("long", "wait 60", []))
    with pytest.raises(OSError, match="No space left") as raised:
        run(tmp_path, plan)
    assert raised.value.errno == 28
    assert "full" in str(raised.value.filename)
    assert all(eventually(lambda one=one: gone(one)) for one in processes(tmp_path))
    assert Store(tmp_path).records() == []


@pytest.mark.parametrize("function", ["tests.fixtures.deeds:nothing", "no.such.module:made"])
def test_a_plan_that_others_cannot_make_is_computed_here_with_a_remark(tmp_path, function):
    plan = planned(tmp_path / "diary", *LADDER)
    assert plan.again is not None
    watching, store = run(tmp_path, Plan(plan.cells, again=Again(function, plan.again.settings)))
    assert processes(tmp_path) == {os.getpid()}
    assert len(watching.remarks) == 1
    assert "all is computed in this process: others cannot plan this work" in watching.remarks[0]
    assert len(store.records()) == len(plan)


def test_a_cell_that_others_do_not_know_is_computed_here(tmp_path):
    plan = planned(tmp_path / "diary", *LADDER)
    top = plan.cells[-1]
    own = Number(50, (top,), "own", tmp_path / "diary")
    last = Number(60, (own,), "last", tmp_path / "diary")
    _, store = run(tmp_path, Plan.of([*plan.cells, last], again=plan.again))
    lines = (tmp_path / "diary").read_text().splitlines()
    assert lines[-2:] == [f"{os.getpid()} own", f"{os.getpid()} last"]
    assert store.load(last) == 60 + 50 + store.load(top)


def test_warnings_reach_the_caller_and_what_libraries_print_disturbs_nobody(tmp_path):
    plan = planned(tmp_path / "diary", ("odd", "warn", []), ("loud", "print", []))
    with pytest.warns(UserWarning, match="this looks odd"):
        watching, _ = run(tmp_path, plan)
    assert watching.failed == {}


def test_processors_are_shared_by_those_that_work(tmp_path):
    count = usable_processors()
    two = planned(tmp_path / "two", ("one", "meet a b", []), ("other", "meet b a", []))
    _, store = run(tmp_path, two)
    shares = [store.load(cell) for cell in two]
    assert sum(shares) == max(2, count)
    alone = planned(tmp_path / "alone", ("first", "", []), ("second", "processors", ["first"]))
    _, store = run(tmp_path, alone)
    assert store.load(alone.cells[1]) == count


PROGRAM = """
import signal
import sys
from pathlib import Path
from sysid_evo.plan import Store, execute
from tests.fixtures.deeds import planned
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
folder = Path(sys.argv[1])
cells = [("quick", "", []), ("long", "wait 60", ["quick"]), ("longer", "wait 60", ["quick"])]
try:
    execute(planned(folder / "diary", *cells), Store(folder), jobs=2)
except KeyboardInterrupt:
    sys.exit(130)
"""


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGKILL])
def test_nothing_is_left_behind_by_ctrl_c_nor_when_the_first_process_is_killed(tmp_path, by):
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(tmp_path)], cwd=ROOT, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    book = tmp_path / "diary"
    assert eventually(lambda: book.exists() and "long\n" in book.read_text() and "longer\n" in book.read_text())
    if by == signal.SIGINT:
        os.killpg(process.pid, by)  # as a terminal does: all of them hear it
    else:
        process.send_signal(by)
    _, said = process.communicate(timeout=60.0)
    assert said == ""
    assert process.returncode == (130 if by == signal.SIGINT else -9)
    assert all(eventually(lambda one=one: gone(one)) for one in processes(tmp_path))
    assert [record.title for record in Store(tmp_path).records()] == ["count quick"]
    assert not [file for file in tmp_path.rglob("*") if file.suffix == ".tmp"]


def test_the_longest_way_comes_first():
    short, start = Number(1, label="short"), Number(2, label="start")
    middle = Number(3, (start,), "middle")
    plan = Plan.of([short, Number(4, (middle,), "end"), middle])
    ahead = work_ahead(plan)
    assert [ahead[cell.digest] for cell in (short, start, middle)] == [1.0, 3.0, 2.0]


def test_there_are_as_many_jobs_as_processors_work_and_memory_are_there_for(monkeypatch):
    monkeypatch.delenv("SYSID_EVO_JOBS")
    monkeypatch.setattr(executors, "usable_processors", lambda: 8)
    monkeypatch.setattr(executors, "available_memory", lambda: 100 * 2**30)
    cells = [Number(i) for i in range(20)]  # of one second each
    assert number_of_jobs(None, cells) == (int(20 / executors.WORTH), "")
    assert number_of_jobs(None, cells[:3]) == (1, "")
    assert number_of_jobs(None, [Number(i) for i in range(500)]) == (8, "")
    assert number_of_jobs(30, cells) == (20, "")
    assert number_of_jobs(3, []) == (1, "")
    monkeypatch.setenv("SYSID_EVO_JOBS", "5")
    assert number_of_jobs(None, cells) == (5, "")
    assert number_of_jobs(2, cells) == (2, "")
    monkeypatch.setattr(executors, "available_memory", lambda: 3 * 2**30 + 5)
    assert number_of_jobs(2, cells) == (2, "")
    assert number_of_jobs(5, cells) == (
        3, "3 instead of 5 cells are computed at once: 3.0 GiB of memory are free, and each may need 1"
    )  # fmt: skip
    monkeypatch.setattr(executors, "available_memory", lambda: 0)
    assert number_of_jobs(5, cells)[0] == 1


@pytest.mark.parametrize("wrong", ["0", "many", "-1"])
def test_a_number_of_jobs_that_is_none_is_refused(monkeypatch, wrong):
    monkeypatch.setenv("SYSID_EVO_JOBS", wrong)
    with pytest.raises(InvalidArgument, match="SYSID_EVO_JOBS: expected a number of jobs"):
        number_of_jobs(None, [])
    with pytest.raises(InvalidArgument, match="jobs: expected at least 1, got 0"):
        number_of_jobs(0, [])


def test_free_memory_is_what_the_container_leaves(tmp_path, monkeypatch):
    limit, used = tmp_path / "memory.max", tmp_path / "memory.current"
    monkeypatch.setattr(executors, "LIMITS", (limit, used))
    all_of_it = executors.available_memory()
    assert all_of_it > 0
    limit.write_text("1000000\n")
    used.write_text("400000\n")
    assert executors.available_memory() == 600000
    used.write_text("2000000\n")
    assert executors.available_memory() == 0
    limit.write_text("max\n")
    assert executors.available_memory() > 600000
