"""Cells on a Dask cluster of real processes: the results are those of this process, and what dies loses nothing."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from functools import partial
from typing import Any

import dask
import psutil
import pytest
from distributed import Client

from sysid_evo.errors import InvalidArgument, SchedulerLost
from sysid_evo.plan import Plan, Store, execute
from tests.fixtures.cells import AtHome, Number, Watching
from tests.fixtures.dask_cluster import LIMIT, ROOT, Processes
from tests.fixtures.deeds import planned
from tests.system.test_processes import eventually as soon
from tests.system.test_processes import gone

eventually = partial(soon, seconds=LIMIT)
ROW = [(f"row {i}", "wait 0.05", ["base"]) for i in range(4)]
LADDER = [("base", "", []), *ROW, ("top", "", [label for label, _, _ in ROW])]


@pytest.fixture(autouse=True)
def _soon(monkeypatch):
    with dask.config.set({"distributed.comm.timeouts.connect": "3s"}):
        yield


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    made = Processes(tmp_path_factory.mktemp("dask"))
    made.start(2)
    yield made
    made.stop()


@pytest.fixture
def own(tmp_path):
    """A cluster of this test alone, that is not started yet."""
    (tmp_path / "dask").mkdir()
    made = Processes(tmp_path / "dask")
    yield made
    made.stop()


def run(folder, plan, scheduler):
    folder.mkdir(exist_ok=True)
    watching, store = Watching(), Store(folder)
    execute(plan, store, observer=watching, scheduler=scheduler)
    return watching, Store(folder)


def lines(folder):
    """Return which process computed which cell, in this order."""
    file = folder / "diary"
    pairs = [line.split(" ", 1) for line in file.read_text().splitlines()] if file.exists() else []
    return [(int(process), label) for process, label in pairs]


def diary(folder):
    return Counter(label for _, label in lines(folder))


def finished(folder):
    """Return how often each cell was done, as the log of the run tells."""
    log = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    return Counter(line["title"] for line in log if line["status"] == "done")


def worker_of(folder, label):
    """Return the worker whose process computes the cell called ``label``, as soon as one does."""
    assert eventually(lambda: label in diary(folder))
    return psutil.Process(dict(reversed(pair) for pair in lines(folder))[label]).parent()


def meanwhile(deed):
    thread = threading.Thread(target=deed)
    thread.start()
    return thread


def test_the_results_are_those_of_one_process_and_nothing_is_computed_twice(tmp_path, cluster):
    found = []
    for name, scheduler in (("here", None), ("there", cluster.file)):
        folder = tmp_path / name
        plan = planned(folder / "diary", *LADDER, ("broken", "fail", []), ("after", "", ["broken"]),
                       ("tolerant", "", ["broken", "base"]))  # fmt: skip
        watching, store = run(folder, plan, scheduler)
        assert set(diary(folder).values()) == {1}
        assert (os.getpid() in dict(lines(folder))) == (scheduler is None)
        assert sorted(watching.computed) == sorted(cell.name for cell in plan)
        assert watching.remarks == []
        files = {file.relative_to(folder): file.read_bytes() for file in folder.rglob("*.txt")}
        found.append((files, [(cell.title, store.outcome(cell).value, store.outcome(cell).reason) for cell in plan]))
    assert found[0] == found[1]
    assert "in compute" in (store.find(plan.cells[-3].digest).traceback or "")  # type: ignore[union-attr]


def test_what_the_plan_is_made_of_is_computed_here_and_so_is_what_others_do_not_know_or_must_not_have(
    tmp_path, cluster
):
    plan = planned(tmp_path / "diary", *LADDER, after=("base",))
    unknown = Number(50, (plan.cells[-1],), "unknown", tmp_path / "diary")
    home = AtHome(60, (), "home", tmp_path / "diary")
    needing = Number(70, (home,), "needing", tmp_path / "diary")
    watching, store = run(tmp_path, Plan.of([*plan.cells, unknown, needing], again=plan.again), cluster.address)
    here = {label for process, label in lines(tmp_path) if process == os.getpid()}
    assert here == {"base", "unknown", "home", "needing"}
    assert lines(tmp_path)[0][1] == "base"
    assert set(diary(tmp_path).values()) == {1}
    assert store.load(needing) == 130
    (remark,) = watching.remarks
    assert "cannot plan 1 of 9 cells (a plugin there may be another one)" in remark


def test_a_process_that_ends_in_a_cell_costs_that_cell_alone_and_that_only_the_second_time(tmp_path, cluster):
    plan = planned(tmp_path / "diary", ("bad", "kill 1", []), ("worse", "exit", []), ("base", "", ["bad"]))
    watching, store = run(tmp_path, plan, cluster.address)
    assert sorted(watching.remarks) == [
        "the process of count bad ended (SIGKILL): it is computed again",
        "the process of count worse ended (exit code 5): it is computed again",
    ]
    assert watching.failed == {"worse": "its process ended 2 times (exit code 5)"}
    assert diary(tmp_path) == {"bad": 2, "worse": 2, "base": 1}
    assert store.load(plan.cells[-1]) == 1 + 3


def test_warnings_progress_and_starts_reach_the_caller(tmp_path, cluster):
    said: list[Any] = []

    class Told(Watching):
        def start(self, cell):
            said.append(cell.name)

        def progress(self, cell, done, total, note=""):
            said.append((cell.name, done, total, note))

    plan = planned(tmp_path / "diary", ("odd", "warn", []), ("long", "wait 0.5", ["odd"]))
    with pytest.warns(UserWarning, match="this looks odd"):
        execute(plan, Store(tmp_path), observer=Told(), scheduler=cluster.address)
    assert said[0] == "odd"
    assert said.count("long") == 1
    assert ("long", 0, 1, "") in said


def test_a_worker_killed_in_mid_run_loses_nothing(tmp_path, own):
    own.start(2)
    cells = [("base", "", []), ("one", "wait 2", ["base"]), ("two", "wait 2", ["base"]), ("top", "", ["one", "two"])]
    plan = planned(tmp_path / "diary", *cells)
    killer = meanwhile(lambda: worker_of(tmp_path, "one").kill())
    watching, store = run(tmp_path, plan, own.address)
    killer.join()
    assert watching.failed == {}
    assert store.load(plan.cells[-1]) == 4 + (2 + 1) + (3 + 1)
    assert finished(tmp_path) == {cell.title: 1 for cell in plan}
    assert diary(tmp_path)["one"] == 2
    assert diary(tmp_path)["base"] == 1


@pytest.mark.nightly
def test_when_the_only_worker_dies_its_data_are_sent_again_to_the_next(tmp_path, own):
    own.start(1)

    def replace():
        worker_of(tmp_path, "top").kill()
        time.sleep(0.5)
        own.hire()

    plan = planned(tmp_path / "diary", ("base", "", []), ("top", "wait 1", ["base"]))
    other = meanwhile(replace)
    watching, store = run(tmp_path, plan, own.address)
    other.join()
    assert watching.failed == {}
    assert store.load(plan.cells[-1]) == 3
    assert finished(tmp_path) == {cell.title: 1 for cell in plan}


@pytest.mark.nightly
def test_a_cell_whose_workers_die_too_often_fails_and_the_rest_goes_on(tmp_path, own):
    own.environment["DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES"] = "0"
    own.start(2)
    plan = planned(tmp_path / "diary", ("bad", "wait 60", []), ("after", "", ["bad"]), ("tolerant", "", ["bad"]))
    killer = meanwhile(lambda: worker_of(tmp_path, "bad").kill())
    watching, store = run(tmp_path, plan, own.address)
    killer.join()
    assert watching.failed == {
        "bad": "1 worker died while it was there",
        "after": "needs count bad, which failed",
    }
    assert store.done(plan.cells[-1])


def test_a_killed_scheduler_is_a_clear_error_and_the_rest_is_computed_without_it(tmp_path, own):
    own.start(1)
    address = own.address
    plan = planned(tmp_path / "diary", ("base", "", []), ("long", "wait 60", ["base"]), ("last", "", ["base"]))

    def kill():
        worker_of(tmp_path, "long")
        assert own.scheduler is not None
        own.scheduler.kill()

    killer = meanwhile(kill)
    with pytest.raises(SchedulerLost, match="does not answer any more: what was finished until then is kept") as raised:
        run(tmp_path, plan, address)
    killer.join()
    assert isinstance(raised.value, ConnectionError)
    assert [record.title for record in Store(tmp_path).records()] == ["count base"]
    assert all(eventually(lambda one=one: gone(one)) for one, _ in lines(tmp_path))
    assert not list((tmp_path / "cells").glob("*.tmp"))
    short = planned(tmp_path / "diary", ("base", "", []), ("long", "", ["base"]), ("last", "", ["base"]))
    watching, _ = run(tmp_path, short, None)
    assert watching.kept == ["base"]
    assert finished(tmp_path) == {cell.title: 1 for cell in plan}


@pytest.mark.nightly
def test_work_goes_on_by_itself_when_the_scheduler_comes_back_at_once(tmp_path, own):
    own.start(1)
    address = own.address
    plan = planned(tmp_path / "diary", ("base", "", []), ("top", "wait 1", ["base"]))

    def restart():
        worker_of(tmp_path, "top")
        own.stop()
        own.start(1, port=int(address.rpartition(":")[2]))

    other = meanwhile(restart)
    with dask.config.set({"distributed.comm.timeouts.connect": "60s"}):
        watching, store = run(tmp_path, plan, address)
    other.join()
    assert watching.failed == {}
    assert store.load(plan.cells[-1]) == 3
    assert finished(tmp_path) == {cell.title: 1 for cell in plan}


def test_a_worker_that_plans_otherwise_is_named_and_others_compute_what_it_cannot(tmp_path, own):
    metadata = tmp_path / "older" / "sysid_evo-0.0.1.dist-info" / "METADATA"
    metadata.parent.mkdir(parents=True)
    metadata.write_text("Metadata-Version: 2.1\nName: sysid-evo\nVersion: 0.0.1\n")
    older = {"PYTHONPATH": f"{metadata.parents[1]}{os.pathsep}{ROOT}", "NUMBERS_DIFFER": "1"}
    own.start(0)
    own.hire(environment=older)
    plan = planned(tmp_path / "diary", *LADDER)
    watching, store = run(tmp_path, plan, own.address)
    assert {process for process, _ in lines(tmp_path)} == {os.getpid()}
    (remark,) = watching.remarks
    assert remark.startswith("the worker tcp://127.0.0.1:")
    assert "cannot plan 6 of 6 cells (sysid-evo 0.0.1 instead of" in remark
    own.hire()
    with Client(own.address, set_as_default=False) as client:
        client.wait_for_workers(2)
    (tmp_path / "diary").unlink()
    watching, store = run(tmp_path / "second", planned(tmp_path / "diary", *LADDER), own.address)
    assert diary(tmp_path)["top"] == 1
    assert os.getpid() not in dict(lines(tmp_path))
    assert store.load(plan.cells[-1]) == 6 + sum(1 + n for n in (2, 3, 4, 5))


def test_a_client_that_is_there_already_is_used_and_left_open(tmp_path, cluster):
    with Client(cluster.address, set_as_default=False) as client:
        _, store = run(tmp_path, planned(tmp_path / "diary", *LADDER), client)
        assert os.getpid() not in dict(lines(tmp_path))
        assert store.load(planned(tmp_path / "diary", *LADDER).cells[0]) == 1
        assert client.status == "running"


def without_parcels(dask_scheduler):
    """Let the scheduler forget what was sent to the workers, without a word to those who sent it."""
    for client, known in list(dask_scheduler.clients.items()):
        keys = [task.key for task in known.wants_what if "parcel" in str(task.key)]
        dask_scheduler.client_releases_keys(keys, client)


def test_what_the_cluster_does_not_have_although_it_was_sent_is_sent_again(tmp_path, cluster):
    plan = planned(tmp_path / "diary", ("base", "", []), ("one", "", ["base"]), ("two", "", ["base", "one"]))
    store = Store(tmp_path)

    class Forgetting(Watching):
        def finish(self, cell, *, cached, reason):
            super().finish(cell, cached=cached, reason=reason)
            if cell.name == "one":
                with Client(cluster.address) as client:
                    client.run_on_scheduler(without_parcels)

    watching = Forgetting()
    execute(plan, store, observer=watching, scheduler=cluster.address)
    assert (watching.failed, watching.computed) == ({}, ["base", "one", "two"])
    assert set(diary(tmp_path).values()) == {1}


def test_nothing_is_asked_of_a_scheduler_when_all_is_done(tmp_path):
    plan = planned(tmp_path / "diary", *LADDER)
    run(tmp_path, plan, None)
    watching, _ = run(tmp_path, plan, "tcp://127.0.0.1:9")
    assert watching.computed == []


@pytest.mark.parametrize(
    ("scheduler", "error", "says"),
    [
        ("tcp://127.0.0.1:9", SchedulerLost, "no scheduler answers at tcp://127.0.0.1:9"),
        ("localhost", InvalidArgument, "expected tcp://HOST:PORT, tls://HOST:PORT or the .json file of a scheduler"),
        ("there/is/none.json", InvalidArgument, "expected the file that 'dask scheduler --scheduler-file"),
        ("tls://127.0.0.1:9", InvalidArgument, "expected certificates in Dask's configuration, found none"),
        ("odd://127.0.0.1:9", InvalidArgument, "expected tcp://HOST:PORT"),
    ],
)
def test_a_scheduler_that_is_none_is_refused_before_any_work(tmp_path, scheduler, error, says):
    with dask.config.set({"distributed.comm.timeouts.connect": "0.5s"}), pytest.raises(error) as raised:
        run(tmp_path, planned(tmp_path / "diary", *LADDER), scheduler)
    assert says in str(raised.value)
    assert lines(tmp_path) == []


def test_processes_here_and_a_scheduler_exclude_each_other(tmp_path):
    with pytest.raises(InvalidArgument, match="2 jobs in processes here and a scheduler: expected one of both"):
        execute(planned(tmp_path / "diary", *LADDER), Store(tmp_path), jobs=2, scheduler="tcp://127.0.0.1:9")


PROGRAM = """
import signal
import sys
from pathlib import Path
from sysid_evo.plan import Store, execute
from tests.fixtures.deeds import planned
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
folder = Path(sys.argv[1])
cells = [("quick", "", []), ("long", "wait 60", ["quick"]), ("queued", "wait 60", ["quick"])]
try:
    execute(planned(folder / "diary", *cells), Store(folder), scheduler=sys.argv[2])
except KeyboardInterrupt:
    sys.exit(130)
"""


def test_ctrl_c_stops_the_work_on_the_workers_and_takes_back_what_waits(tmp_path, own):
    own.start(1)
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(tmp_path), own.address], cwd=ROOT, stderr=subprocess.PIPE, text=True
    )
    assert eventually(lambda: sum(diary(tmp_path).values()) == 2)
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=LIMIT)
    assert said == ""
    assert process.returncode == 130
    assert all(eventually(lambda one=one: gone(one)) for one, label in lines(tmp_path) if label != "quick")
    assert sum(diary(tmp_path).values()) == 2
    assert [record.title for record in Store(tmp_path).records()] == ["count quick"]
    assert own.workers[0].poll() is None


@pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl here")
def test_a_scheduler_with_tls_is_reached_with_the_certificates_and_settings_of_the_page_alone(tmp_path, own):
    text = (ROOT / "docs" / "cluster.md").read_text()
    make, export = (m[1] for m in re.finditer(r"^```\n((?:openssl|export) .*?)^```$", text, re.DOTALL | re.MULTILINE))
    subprocess.run(["bash", "-ec", make], cwd=own.folder, check=True, capture_output=True)
    told = subprocess.run(
        ["bash", "-ec", f"{export}\nenv"], cwd=own.folder, env={}, check=True, capture_output=True, text=True
    )
    settings = dict(line.split("=", 1) for line in told.stdout.splitlines() if line.startswith("DASK_"))
    own.environment.update(settings)
    own.protocol = "tls"
    own.start(1)
    assert own.address.startswith("tls://")
    plan = planned(tmp_path / "diary", *LADDER)
    names = {name.removeprefix("DASK_").lower().replace("__", ".").replace("_", "-"): name for name in settings}
    with dask.config.set({name: settings[variable] for name, variable in names.items()}):
        watching, _ = run(tmp_path, plan, own.file)
    assert (watching.failed, watching.remarks) == ({}, [])
    assert os.getpid() not in dict(lines(tmp_path))
    with dask.config.set({"distributed.comm.timeouts.connect": "1s"}), pytest.raises(SchedulerLost):
        run(tmp_path / "stranger", plan, own.address.replace("tls", "tcp"))
