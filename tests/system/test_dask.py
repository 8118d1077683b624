"""Cells and comparisons on Dask clusters of real processes: the results are those here, and what dies loses nothing."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time

import dask
import numpy as np
import psutil
import pytest
from distributed import Client

from evaluation.running import compare
from evaluation.study.study import Study
from evaluation.transfer.matrix import MeasuredResult, human_driver, save_measured
from evaluation.transfer.matrix import TransferResult as Cell
from sysid_evo.errors import InvalidArgument, SchedulerLost
from sysid_evo.models import save_model
from sysid_evo.models.base import make_model
from sysid_evo.plan import Plan, Store, execute
from sysid_evo.testing import example_dataset
from tests.fixtures import session
from tests.fixtures.cells import Number, Watching, number
from tests.fixtures.commands import SMALL, forgetting, run_here
from tests.fixtures.dask_cluster import LIMIT, ROOT, Processes
from tests.fixtures.deeds import LADDER, diary, eventually, lines, planned, processes
from tests.fixtures.studies import finished, found_in

pytestmark = pytest.mark.usefixtures("blank_figures")


@pytest.fixture(autouse=True)
def _patient(monkeypatch):
    """What is lost is noticed soon; that no worker is there on a busy machine is no remark."""
    monkeypatch.setattr("sysid_evo.plan.dask_executor.ALONE", LIMIT)
    with dask.config.set({"distributed.comm.timeouts.connect": "3s"}):
        yield


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """The cluster of most tests: two workers, who write down whose plugins they load."""
    folder = tmp_path_factory.mktemp("dask")
    made = Processes(folder, environment={"PLUGIN_DIARY": str(folder / "plugins")})
    made.restore(2)
    yield made
    made.stop()


@pytest.fixture(scope="module")
def mortal(tmp_path_factory):
    """A cluster whose processes are killed: it is to be restored first."""
    made = Processes(tmp_path_factory.mktemp("mortal"))
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
    watching = Watching()
    execute(plan, Store(folder), observer=watching, scheduler=scheduler)
    return watching, Store(folder)


def done_once(folder, plan):
    """Whether each cell was done once, as the log of the run has it."""
    return dict(finished(folder)) == {cell.digest: 1 for cell in plan}


def worker_of(folder, label):
    """Return the worker that computes the cell called ``label``, as soon as one does."""
    assert eventually(lambda: label in diary(folder))
    return psutil.Process(dict(reversed(pair) for pair in lines(folder))[label])


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
        assert (os.getpid() in processes(folder)) == (scheduler is None)
        assert sorted(watching.computed) == sorted(cell.name for cell in plan)
        assert watching.remarks == []
        files = {file.relative_to(folder): file.read_bytes() for file in folder.rglob("*.txt")}
        found.append((files, [(cell.title, store.outcome(cell).value, store.outcome(cell).reason) for cell in plan]))
    assert found[0] == found[1]
    assert "in compute" in (store.find(plan.cells[-3].digest).traceback or "")


def test_what_is_local_or_names_files_of_the_run_or_cannot_be_sent_is_computed_here(tmp_path, cluster):
    lock = threading.Lock()
    local = Number(50, (), "local", tmp_path / "diary").cell(local=True)
    there = number(51, (local,), "there", tmp_path / "diary")
    home = Number(60, (), "home", tmp_path / "diary").cell(local_only=True)
    needing = number(70, (home,), "needing", tmp_path / "diary")
    unsendable = number(80, (), "unsendable", tmp_path / "diary", then=lambda: lock.locked())
    watching, store = run(tmp_path, Plan.of([there, needing, unsendable]), cluster.address)
    here = {label for process, label in lines(tmp_path) if process == os.getpid()}
    assert here == {"local", "home", "needing", "unsendable"}
    assert set(diary(tmp_path).values()) == {1}
    assert (store.load(there), store.load(needing)) == (101, 130)
    (remark,) = watching.remarks
    assert "are computed in this process (count unsendable cannot be sent: TypeError" in remark


def test_warnings_progress_and_starts_reach_the_caller(tmp_path, cluster):
    said = []

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


def test_a_worker_killed_in_mid_run_loses_nothing(tmp_path, mortal):
    mortal.restore(2)
    cells = [("base", "", []), ("one", "wait 2", ["base"]), ("two", "wait 2", ["base"]), ("top", "", ["one", "two"])]
    plan = planned(tmp_path / "diary", *cells)
    killer = meanwhile(lambda: worker_of(tmp_path, "one").kill())
    watching, store = run(tmp_path, plan, mortal.address)
    killer.join()
    assert watching.failed == {}
    assert store.load(plan.cells[-1]) == 4 + (2 + 1) + (3 + 1)
    assert done_once(tmp_path, plan)
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
    assert done_once(tmp_path, plan)


@pytest.mark.nightly
def test_a_cell_whose_workers_die_too_often_fails_and_the_rest_goes_on(tmp_path, own):
    own.environment["DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES"] = "0"
    own.start(2)
    plan = planned(tmp_path / "diary", ("bad", "wait 60", []), ("after", "", ["bad"]), ("tolerant", "", ["bad"]))
    killer = meanwhile(lambda: worker_of(tmp_path, "bad").kill())
    watching, store = run(tmp_path, plan, own.address)
    killer.join()
    assert watching.failed == {
        "bad": "1 worker died while computing it",
        "after": "needs count bad, which failed",
    }
    assert store.done(plan.cells[-1])


def test_a_killed_scheduler_is_a_clear_error_and_the_rest_is_computed_without_it(tmp_path, mortal):
    mortal.restore(1)
    address = mortal.address
    plan = planned(tmp_path / "diary", ("base", "", []), ("long", "wait 60", ["base"]), ("last", "", ["base"]))

    def kill():
        worker_of(tmp_path, "long")
        mortal.scheduler.kill()

    killer = meanwhile(kill)
    with pytest.raises(SchedulerLost, match="no longer answers: finished results are kept") as raised:
        run(tmp_path, plan, address)
    killer.join()
    assert isinstance(raised.value, ConnectionError)
    assert [record.title for record in Store(tmp_path).records()] == ["count base"]
    assert all(eventually(lambda one=one: one.poll() is not None) for one in mortal.workers)
    assert not list((tmp_path / "cells").glob("*.tmp"))
    short = planned(tmp_path / "diary", ("base", "", []), ("long", "", ["base"]), ("last", "", ["base"]))
    watching, _ = run(tmp_path, short, None)
    assert watching.kept == ["base"]
    assert done_once(tmp_path, short)


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
    assert done_once(tmp_path, plan)


def test_a_worker_that_plans_otherwise_is_named_and_others_compute_what_it_cannot(tmp_path, own):
    metadata = tmp_path / "older" / "sysid_evo-0.0.1.dist-info" / "METADATA"
    metadata.parent.mkdir(parents=True)
    metadata.write_text("Metadata-Version: 2.1\nName: sysid-evo\nVersion: 0.0.1\n")
    older = {"PYTHONPATH": f"{metadata.parents[1]}{os.pathsep}{ROOT}", "NUMBERS_DIFFER": "1"}
    own.start(0)
    own.hire(environment=older)
    own.wait()
    plan = planned(tmp_path / "diary", *LADDER)
    watching, store = run(tmp_path, plan, own.address)
    assert processes(tmp_path) == {os.getpid()}
    remark, here = watching.remarks
    assert remark.startswith("the worker tcp://127.0.0.1:")
    assert "cannot run some cells (another version, or another plugin of that name, sysid-evo 0.0.1" in remark
    assert "cells that workers cannot run are computed in this process" in here
    own.hire()
    own.wait()
    (tmp_path / "diary").unlink()
    watching, store = run(tmp_path / "second", planned(tmp_path / "diary", *LADDER), own.address)
    assert diary(tmp_path)["top"] == 1
    assert os.getpid() not in processes(tmp_path)
    assert store.load(plan.cells[-1]) == 6 + sum(1 + n for n in (2, 3, 4, 5))


def test_a_client_that_is_there_already_is_used_and_left_open(tmp_path, cluster):
    with Client(cluster.address, set_as_default=False) as client:
        _, store = run(tmp_path, planned(tmp_path / "diary", *LADDER), client)
        assert os.getpid() not in processes(tmp_path)
        assert store.load(planned(tmp_path / "diary", *LADDER).cells[0]) == 1
        assert client.status == "running"


def without_results(dask_scheduler):
    """Let the scheduler forget what was sent to the workers, without a word to those who sent it."""
    for client, known in list(dask_scheduler.clients.items()):
        keys = [task.key for task in known.wants_what if "compute" not in str(task.key)]
        dask_scheduler.client_releases_keys(keys, client)


def test_what_the_cluster_does_not_have_although_it_was_sent_is_sent_again(tmp_path, cluster):
    plan = planned(tmp_path / "diary", ("base", "", []), ("one", "", ["base"]), ("two", "", ["base", "one"]))
    store = Store(tmp_path)

    class Forgetting(Watching):
        def finish(self, cell, *, cached, reason):
            super().finish(cell, cached=cached, reason=reason)
            if cell.name == "one":
                with Client(cluster.address) as client:
                    client.run_on_scheduler(without_results)

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


PROGRAM = """
import signal
import sys
from pathlib import Path
from sysid_evo.plan import Store, execute
from tests.fixtures.deeds import planned
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
folder = Path(sys.argv[1])
cells = [("quick", "", []), ("long", "wait 60", ["quick"]), ("longer", "wait 60", ["quick"]),
         ("queued", "wait 60", ["quick"])]
try:
    execute(planned(folder / "diary", *cells), Store(folder), scheduler=sys.argv[2])
except KeyboardInterrupt:
    sys.exit(130)
"""


@pytest.mark.parametrize("by", [signal.SIGINT, pytest.param(signal.SIGKILL, marks=pytest.mark.nightly)])
def test_ctrl_c_and_kill_stop_the_work_on_the_workers_and_take_back_what_waits(tmp_path, cluster, by):
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(tmp_path), cluster.address], cwd=ROOT, stderr=subprocess.PIPE, text=True
    )
    assert eventually(lambda: sum(diary(tmp_path).values()) == 3)
    process.send_signal(by)
    _, said = process.communicate(timeout=LIMIT)
    assert said == ""
    assert process.returncode == (130 if by == signal.SIGINT else -9)
    assert sum(diary(tmp_path).values()) == 3
    assert [record.title for record in Store(tmp_path).records()] == ["count quick"]
    assert [worker.poll() for worker in cluster.workers] == [None, None]
    _, store = run(tmp_path / "next", planned(tmp_path / "diary", ("free", "", [])), cluster.address)  # at once
    assert len(store.records()) == 1


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
    assert os.getpid() not in processes(tmp_path)
    with dask.config.set({"distributed.comm.timeouts.connect": "1s"}), pytest.raises(SchedulerLost):
        run(tmp_path / "stranger", plan, own.address.replace("tls", "tcp"))


PLUGIN = '''
import os
from pathlib import Path

from model_zoo.linear import Linear
from sysid_evo.registry.registry import register_model

with (Path(os.environ["PLUGIN_DIARY"])).open("a") as file:
    file.write(f"{os.getpid()} {__file__}\\n")


@register_model("mine")
class Mine(Linear):
    """A family of somebody else."""
'''


def results(folder):
    """Return the files of all results by their path; how long a fit took is left out."""
    places = ("data", "models", "controllers", "results")
    return {
        file.relative_to(folder).as_posix(): re.sub(rb'"fit_seconds": [0-9.e-]+', b"", file.read_bytes())
        for place in places
        for file in (folder / place).rglob("*")
        if file.is_file()
    }


def report(folder):
    found = json.loads((folder / "report.json").read_text())
    del found["timings"]
    return found


def test_a_comparison_is_the_same_in_every_byte(tmp_path, cluster, finished_run):
    done = run_here("compare", "--config", finished_run, "--scheduler", cluster.file, "--out", "there", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "do not know" not in done.stderr
    assert results(tmp_path / "there") == results(finished_run)
    assert report(tmp_path / "there") == report(finished_run)
    assert set(finished(tmp_path / "there").values()) == {1}


def test_plugins_and_what_persons_drove_go_along(tmp_path, cluster, monkeypatch):
    monkeypatch.setenv("PLUGIN_DIARY", str(tmp_path / "plugins"))
    (tmp_path / "own.py").write_text(PLUGIN)
    settings = {
        "models": ("mine",), "ensembles": (), "generations": 1, "trials": 2, "repeats": 1, "transfer_trials": 3,
        "procedure": "plain", "traces": 0, "task": "point_to_point(horizon=40)", "plugins": (str(tmp_path / "own.py"),),
        "strategy": "mu_plus_lambda(parents=2, children=2)", "held_out": 0.3,
    }  # fmt: skip
    human = MeasuredResult(
        human_driver("anna"), Cell("anna", "mine", np.array([5.0]), unit="waypoints"), on_robot=False
    )
    for name, scheduler in (("here", None), ("there", str(cluster.file))):
        (tmp_path / name / "cells").mkdir(parents=True)
        save_measured(tmp_path / name, human)
        watching = Watching()
        with forgetting():
            compare(example_dataset(), out=tmp_path / name, observer=watching, scheduler=scheduler, jobs=1, **settings)
        assert watching.remarks == []
    assert results(tmp_path / "here") == results(tmp_path / "there")
    assert report(tmp_path / "here") == report(tmp_path / "there")
    loaded = dict(line.split(" ", 1) for line in (cluster.folder / "plugins").read_text().splitlines())
    assert 1 <= len(loaded) <= 2
    assert str(os.getpid()) not in loaded
    assert not any(file.startswith(str(tmp_path)) for file in loaded.values())


def test_a_controller_evolved_against_models_of_the_run_and_of_another_folder_is_the_same(
    tmp_path, cluster, finished_run
):
    save_model(make_model("linear", ridge=0.5).fit(example_dataset(), rng=0), tmp_path / "two" / "far")
    for folder, where in (("one", ("--jobs", "1")), ("three", ("--scheduler", cluster.file))):
        own = next((session.copy_run(finished_run, tmp_path / folder) / "models").glob("linear-*.json"))
        ended = run_here(
            "evolve", "--run", folder, "--against", f"{own.relative_to(tmp_path)},two/far", *SMALL, "--controller",
            "recurrent(hidden=2)", *where, cwd=tmp_path,
        )  # fmt: skip
        assert ended.returncode == 0, ended.stderr
        assert "do not know" not in ended.stderr
    assert results(tmp_path / "one") == results(tmp_path / "three") != results(finished_run)
    assert set(finished(tmp_path / "three").values()) == {1}


@pytest.mark.nightly
def test_a_study_on_a_cluster_has_the_tables_of_one_process(tmp_path, cluster, study_folder):
    Study.of(session.STUDY).write(tmp_path / "tiny.toml")
    done = run_here("study", "tiny.toml", "--scheduler", cluster.file, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "do not know" not in done.stderr
    assert finished(tmp_path / "runs" / "tiny") == finished(study_folder)
    assert found_in(tmp_path / "runs" / "tiny") == found_in(study_folder)


def test_a_scheduler_that_is_lost_ends_the_command_with_a_sentence_and_a_code(tmp_path, stored_data):
    command = ("fit", stored_data, "--models", "linear", "--out", "run", "--scheduler", "tcp://127.0.0.1:9")
    with dask.config.set({"distributed.comm.timeouts.connect": "0.5s"}):
        ended = run_here(*command, cwd=tmp_path)
    assert ended.returncode == 4
    assert "no scheduler answers at tcp://127.0.0.1:9" in " ".join(ended.stderr.split())
    assert "Traceback" not in ended.stderr
