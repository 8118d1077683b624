"""Cells in several processes: the same results for any number of them, whatever becomes of a process."""

import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from joblib.externals.loky import process_executor

from evaluation.experiment import Experiment, meaningful
from evaluation.planning import comparison_in, comparison_of, plan_comparison
from evaluation.running import compare
from sysid_evo.plan import CellRecord, Plan, Store, execute, stored
from sysid_evo.processors import usable_processors
from sysid_evo.registry import make_robot
from sysid_evo.testing import example_dataset
from tests.fixtures.cells import Number, Watching, number
from tests.fixtures.deeds import LADDER, diary, eventually, gone, lines, planned, processes, shared

pytestmark = pytest.mark.usefixtures("blank_figures")

ROOT = Path(__file__).parents[2]
INTERRUPTIBLE = """
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
SHARING = """
import sys
from pathlib import Path
from sysid_evo.plan import Store, execute
from tests.fixtures.deeds import shared
folder = Path(sys.argv[1])
print("ready", flush=True)
sys.stdin.readline()
outcomes = execute(shared(folder), Store(folder / "run"))
assert not any(outcome.failed for outcome in outcomes.values()), outcomes
"""


@pytest.fixture(autouse=True)
def _others_find_the_tests(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)


def run(folder, plan, count=2):
    folder.mkdir(exist_ok=True)
    watching = Watching()
    execute(plan, Store(folder), observer=watching, jobs=count)
    return watching, Store(folder)


def test_no_worker_is_restarted_as_a_memory_leak_because_a_cell_loads_libraries(tmp_path):
    assert process_executor._USE_PSUTIL, "in this process loky would restart it"

    def watched():
        assert not process_executor._USE_PSUTIL

    watching, _ = run(tmp_path, Plan.of([number(1, label="a", then=watched), number(2, label="b", then=watched)]))
    assert not watching.failed
    assert sorted(watching.computed) == ["a", "b"]


def test_the_results_are_the_same_for_any_number_of_jobs_and_nothing_is_computed_twice(tmp_path):
    """Also warnings reach the caller, what libraries print disturbs nobody, and what is local is computed here."""
    found = []
    for count in (1, 3):
        folder = tmp_path / str(count)
        cells = [("broken", "fail", []), ("after", "", ["broken"]), ("tolerant", "", ["broken", "base"]),
                 ("odd", "warn", []), ("loud", "print", [])]  # fmt: skip
        plan = planned(folder / "diary", *LADDER, *cells)
        own = Number(50, (plan.cells[5],), "own", folder / "diary").cell(local=True)
        last = number(60, (own,), "last", folder / "diary", then=lambda: None)
        plan = Plan.of([*plan.cells, last])
        with pytest.warns(UserWarning, match="this looks odd"):
            watching, store = run(folder, plan, count)
        assert set(diary(folder).values()) == {1}
        others = {process for process, label in lines(folder) if label != "own"}
        assert 1 <= len(others) <= count  # one that starts late may find nothing left to do
        assert (os.getpid() in others) == (count == 1)
        assert (os.getpid(), "own") in lines(folder)
        assert sorted(watching.computed) == sorted(cell.name for cell in plan)
        found.append({cell.title: (store.outcome(cell).value, store.outcome(cell).reason) for cell in plan})
    assert found[0] == found[1]
    assert found[0]["count after"][1] == "needs count broken, which failed"
    assert found[0]["count last"][0] == 60 + 50 + found[0]["count top"][0]
    assert all(eventually(lambda one=one: gone(one)) for one in processes(tmp_path / "3") - {os.getpid()})


def test_a_worker_that_dies_in_a_cell_costs_that_cell_alone_and_that_only_the_second_time(tmp_path):
    cells = [("bad", "kill 1", []), ("later", "", ["bad"]), ("worse", "crash", []), ("never", "", ["worse"]),
             ("ends", "exit", [])]  # fmt: skip
    plan = planned(tmp_path / "diary", *LADDER, *cells)
    watching, store = run(tmp_path, plan)
    assert len(processes(tmp_path)) > 1
    assert sorted(watching.remarks) == [
        "count bad is computed again: its worker died (SIGKILL(-9))",
        "count worse is computed again: its worker died (EXIT(5))",
    ]
    reason = "its worker died (EXIT(5)), 2 times"
    ends = "RuntimeError: it called exit with code 5"
    assert watching.failed == {"worse": reason, "never": "needs count worse, which failed", "ends": ends}
    assert {name: times for name, times in diary(tmp_path).items() if times > 1} == {"bad": 2, "worse": 2}
    found = {cell.name: cell for cell in plan}
    assert store.load(found["top"]) == 6 + sum(1 + n for n in (2, 3, 4, 5))
    assert store.load(found["later"]) == 8 + 7
    record = store.find(found["worse"].digest)
    assert (record.status, record.reason) == ("failed", reason)


@pytest.mark.nightly
def test_a_worker_that_is_killed_twice_in_a_cell_costs_that_cell_alone(tmp_path):
    plan = planned(tmp_path / "diary", ("bad", "kill 2", []), ("worse", "", ["bad"]), *LADDER)
    watching, store = run(tmp_path, plan)
    assert watching.remarks == ["count bad is computed again: its worker died (SIGKILL(-9))"]
    reason = "its worker died (SIGKILL(-9)), 2 times"
    assert watching.failed == {"bad": reason, "worse": "needs count bad, which failed"}
    assert store.find(plan.cells[0].digest).reason == reason
    assert store.load(plan.cells[-1]) == 8 + sum(3 + n for n in (4, 5, 6, 7))


def test_a_full_disk_stops_all_processes(tmp_path):
    plan = planned(tmp_path / "diary", ("full", "full", []), ("long", "wait 60", []))
    with pytest.raises(OSError, match="No space left") as raised:
        run(tmp_path, plan)
    assert raised.value.errno == 28
    assert "full" in str(raised.value.filename)
    assert all(eventually(lambda one=one: gone(one)) for one in processes(tmp_path))
    assert Store(tmp_path).records() == []


def test_what_workers_cannot_have_or_do_not_know_is_computed_here_with_a_remark(tmp_path, monkeypatch):
    lock = threading.Lock()
    unsendable = number(77, (), "unsendable", tmp_path / "diary", then=lambda: lock.locked())
    plan = Plan.of([*planned(tmp_path / "diary", *LADDER), unsendable])
    monkeypatch.setenv("NUMBERS_DIFFER", "1")  # workers have another number
    watching, store = run(tmp_path, plan)
    assert processes(tmp_path) == {os.getpid()}
    assert set(diary(tmp_path).values()) == {1}
    assert sorted(watching.remarks) == [
        "cells that workers cannot run are computed in this process (another version, or another plugin of that name)",
        "cells that workers cannot run are computed in this process (count unsendable cannot be sent: TypeError: "
        "cannot pickle '_thread.lock' object)",
    ]
    assert len(store.records()) == len(plan)


def test_processors_are_shared_by_those_that_work(tmp_path):
    count = usable_processors()
    cells = [("one", "meet a b", []), ("other", "meet b a", []), ("alone", "processors", ["one", "other"])]
    plan = planned(tmp_path / "diary", *cells)
    _, store = run(tmp_path, plan)
    one, other, alone = (store.load(cell) for cell in plan)
    assert one + other == max(2, count)
    assert alone == count


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGKILL])
def test_nothing_is_left_behind_by_ctrl_c_nor_when_the_first_process_is_killed(tmp_path, by):
    process = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTIBLE, str(tmp_path)], cwd=ROOT, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    assert eventually(lambda: {"long", "longer"} <= set(diary(tmp_path)))
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


def started(folder):
    """Start a process that waits for a line before it computes what is shared in ``folder``."""
    process = subprocess.Popen(
        [sys.executable, "-c", SHARING, str(folder)], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout.readline() == "ready\n", process.communicate()
    return process


def go(process):
    process.stdin.write("\n")
    process.stdin.flush()


def test_two_processes_share_the_work_and_no_cell_is_computed_twice_or_lost(tmp_path):
    both = [started(tmp_path) for _ in range(2)]
    for process in both:
        go(process)
    for process in both:
        _, said = process.communicate(timeout=60.0)
        assert process.returncode == 0, said
    plan, store = shared(tmp_path), Store(tmp_path / "run")
    assert diary(tmp_path) == {cell.name: 1 for cell in plan}
    assert len(processes(tmp_path)) == 2  # both had a part in it
    assert len(store.records()) == len(plan) == len((tmp_path / "run" / "log.jsonl").read_text().splitlines())
    assert not store.remarks
    assert store.load(plan.cells[-1]) == 100 + sum(10 + i + 1 for i in range(5))


def test_the_claim_of_a_killed_process_is_free_again_and_its_work_is_kept(tmp_path):
    process, plan, store = started(tmp_path), shared(tmp_path), Store(tmp_path / "run")
    (row,) = (cell for cell in plan if cell.name == "row 0")
    go(process)
    assert eventually(lambda: "row 0" in diary(tmp_path))
    with store.claim(row) as ours:
        assert not ours  # it is at it
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=60.0)
    with store.claim(row) as ours:
        assert ours
    outcomes = execute(plan, Store(tmp_path / "run"))
    assert not any(outcome.failed for outcome in outcomes.values())
    assert diary(tmp_path)["base"] == 1
    assert diary(tmp_path)["row 0"] == 2  # killed in the middle of it
    assert Store(tmp_path / "run").load(plan.cells[-1]) == 100 + sum(10 + i + 1 for i in range(5))


def written(run):
    """Return the report of a run; of its timings, only what was timed."""
    document = json.loads((run / "report.json").read_text())
    return {**document, "timings": sorted(document["timings"]["cells"])}


def test_the_same_settings_give_the_same_report_twice_and_for_any_number_of_jobs(tmp_path, finished_run):
    watching, settings = Watching(), Experiment.read(finished_run)
    compare(settings.pop("data"), out=tmp_path, jobs=2, observer=watching, **settings)
    assert written(tmp_path) == written(finished_run)
    assert watching.remarks == []
    assert {line["status"] for line in map(json.loads, (tmp_path / "log.jsonl").read_text().splitlines())} == {"done"}


def test_a_run_folder_is_planned_as_its_comparison_was(finished_run):
    settings = {**Experiment.read(finished_run), "data_digest": None}
    first = plan_comparison(Experiment.of(meaningful(settings, {})), dataset=example_dataset()).plan
    assert [cell.digest for cell in comparison_of(finished_run)[0].plan] == [cell.digest for cell in first]


def test_the_yardstick_of_a_recorded_run_is_planned_again():
    asked = {"models": ("linear",), "robot": "emulated_car", "minutes": 0.5, "generations": 5}  # short in NumPy too
    first = plan_comparison(Experiment.of(asked))
    data = first.data
    record = CellRecord(
        digest=data.digest, kind=data.kind, title=data.title, name=data.name, status="done", needs=[],
        inputs=data.settings.inputs(), artefact="data/there", versions={}, timings={},
    )  # fmt: skip
    system = make_robot("emulated_car").system
    again = plan_comparison(first.experiment, held=(stored(record), system))
    assert "evolve emulated_car" in [cell.title for cell in again.plan]
    assert [cell.digest for cell in again.plan] == [cell.digest for cell in first.plan]


@pytest.mark.nightly
def test_a_recorded_comparison_with_a_yardstick_is_the_same_for_any_number_of_jobs(tmp_path):
    settings = {
        "models": ("linear", "parametrised", "nearest_neighbour", "mlp_ensemble"), "minutes": 1.0, "generations": 6,
        "robot": "emulated_car",
    }  # fmt: skip
    watching = Watching()
    for jobs in (1, 2):
        compare(out=tmp_path / str(jobs), jobs=jobs, observer=watching, **settings)
    assert written(tmp_path / "1") == written(tmp_path / "2")
    assert watching.remarks == []
    again, _ = comparison_in(Experiment.of(Experiment.read(tmp_path / "2")), tmp_path / "2")
    assert "emulated_car" in [champion.name for champion in again.matrix.champions]
