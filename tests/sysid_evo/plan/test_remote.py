"""The processes of a worker: which are kept for a while, what is kept in their folders, how a cell ends there."""

from __future__ import annotations

from queue import SimpleQueue
from types import SimpleNamespace
from typing import Any

import pytest

from sysid_evo.plan import Plan, Store, dask_worker, execute
from sysid_evo.plan.dask_worker import BLOCKED, DONE, ENDED, FAILED, LACKS, Child, Children, Unwanted
from tests.fixtures.cells import Number

ASKED: dict[str, Any] = {
    "run": "r",
    "function": "tests:none",
    "settings": {},
    "files": {"own.py": "0/own.py"},
    "engine": "reference",
}
ONE = Number(1, label="one")


class MadeUpWorker:
    """A process that is none: it hears what it is told, and says what it is given."""

    def __init__(self, inbox):
        self.inbox, self.told, self.dismissed = inbox, list[dict[str, Any]](), False

    def say(self, **message):
        self.told.append(message)

    def wait(self):
        return -9

    def dismiss(self):
        self.dismissed = True

    def says(self, *messages):
        for message in messages:
            self.inbox.put((0, message))


@pytest.fixture(autouse=True)
def _made_up(monkeypatch):
    monkeypatch.setattr(dask_worker, "Worker", MadeUpWorker)
    monkeypatch.setattr(dask_worker, "WATCH", 0.01)


def child_in(folder, before=(), files=()):
    child = Child(folder, ASKED, before, files)
    assert isinstance(child.inbox, SimpleQueue)
    return child, child.worker


def parcels_of(folder, count):
    cells = [Number(i, label=str(i)) for i in range(count)]
    store = Store(folder)
    execute(Plan.of(cells), store)
    return [store.parcel(cell.digest) for cell in cells]


def computed(child, digest="d", needed=(), wanted=True):
    asked = {**ASKED, "digest": digest, "failed": []}
    said = list[dict[str, Any]]()
    return *child.compute(asked, needed, lambda: wanted, said.append), said


def test_what_the_plan_is_made_of_is_put_down_before_the_process_begins(tmp_path):
    (before,) = parcels_of(tmp_path / "there", 1)
    child, worker = child_in(tmp_path, (before,), (("0/own.py", 0, b"x"),))
    assert (child.folder / "files/0/own.py").read_bytes() == b"x"
    assert all((child.store.path / name).is_file() for name, _, _ in before)
    assert [sorted(message) for message in worker.told] == [["engine", "function", "settings", "threads"], ["folder"]]
    child.dismiss()
    assert worker.dismissed
    assert not child.folder.exists()


def test_of_many_results_those_not_used_for_longest_go_first_but_not_what_the_plan_is_made_of(tmp_path, monkeypatch):
    monkeypatch.setattr(dask_worker, "KEPT", 2)
    before, *others = parcels_of(tmp_path / "there", 4)
    child, _ = child_in(tmp_path, (before,))

    def there():
        return [all((child.store.path / name).is_file() for name, _, _ in parcel) for parcel in (before, *others)]

    for parcel in (others[0], others[1], others[0], before, ()):
        child._keep(parcel)
    assert there() == [True, True, True, False]
    child._keep(others[2])
    assert there() == [True, True, False, True]
    child._keep(others[1])
    assert there() == [True, False, True, True]


def test_a_record_is_put_down_after_the_files_that_it_names(tmp_path, monkeypatch):
    (parcel,) = parcels_of(tmp_path / "there", 1)
    child, _ = child_in(tmp_path)
    put = list[str]()
    monkeypatch.setattr(dask_worker, "unpack", lambda parcel, folder: put.extend(name for name, _, _ in parcel))
    child._keep(parcel)
    assert len(put) > 1
    assert put[-1].startswith("cells/")


def test_a_cell_that_is_done_goes_back_with_what_was_said_meanwhile(tmp_path):
    (parcel,) = parcels_of(tmp_path / "there", 1)
    child, worker = child_in(tmp_path)
    execute(Plan.of([ONE]), child.store)
    worker.says({"knows": [ONE.digest]}, {"start": ONE.digest}, {"remark": "so"}, {"warning": "odd"})
    worker.says({"end": ONE.digest, "reason": None}, {"idle": True})
    answer, found, said = computed(child, ONE.digest, (parcel,))
    assert answer == {"status": DONE, "remarks": ["so"], "warnings": ["odd"]}
    assert found == child.store.parcel(ONE.digest)
    assert said == [{"start": ONE.digest}]
    assert worker.told[-1] == {"compute": ONE.digest, "failed": [], "alone": True}
    worker.says({"end": ONE.digest, "reason": None}, {"idle": True})
    assert computed(child, ONE.digest)[0]["status"] == DONE  # it is asked once what it knows


def test_how_else_a_cell_may_end(tmp_path):
    child, worker = child_in(tmp_path)
    worker.says({"knows": [ONE.digest], "cannot": "too old"})
    answer, found, _ = computed(child, "another")
    assert (answer["status"], answer["reason"], answer["knows"], found) == (LACKS, "too old", [ONE.digest], ())
    worker.says({"end": ONE.digest, "reason": "needs what failed"}, {"idle": True})
    answer, found, _ = computed(child, ONE.digest)
    assert (answer["status"], answer["reason"], found) == (BLOCKED, "needs what failed", ())
    child.store.fail(ONE, reason="it broke", traceback="there", seconds=2.5)
    worker.says({"end": ONE.digest, "reason": "it broke"}, {"idle": True})
    answer, found, _ = computed(child, ONE.digest)
    told = {name: answer[name] for name in ("status", "reason", "traceback", "seconds")}
    assert told == {"status": FAILED, "reason": "it broke", "traceback": "there", "seconds": 2.5}
    assert found == ()
    worker.says({"stop": ("OSError", "the disk is full")})
    assert computed(child, ONE.digest)[:2] == ({"status": ENDED, "reason": "the disk is full"}, ())
    worker.says(None)
    answer, found, _ = computed(child, ONE.digest)
    assert (answer["status"], found) == (ENDED, ())
    assert answer["reason"] == "SIGKILL"


def test_a_result_that_nobody_waits_for_any_more_is_not_waited_for(tmp_path):
    child, _ = child_in(tmp_path)
    with pytest.raises(Unwanted):
        computed(child, wanted=False)


class MadeUpTimer:
    """A timer that goes off when it is told."""

    made: list[MadeUpTimer]

    def __init__(self, seconds, deed, arguments):
        self.seconds, self.daemon, self.started, self.cancelled = seconds, False, False, False
        self._deed, self._arguments = deed, arguments
        type(self).made.append(self)

    def start(self):
        self.started = True

    def cancel(self):
        self.cancelled = True

    def goes_off(self):
        self._deed(*self._arguments)


def test_an_idle_process_serves_its_run_again_or_ends_after_a_while(monkeypatch):
    ended = list[str]()

    def made(name):
        return SimpleNamespace(dismiss=lambda: ended.append(name))

    children, used, forgotten = Children(), made("used"), made("forgotten")
    timers = MadeUpTimer.made = list[MadeUpTimer]()
    monkeypatch.setattr(dask_worker, "Timer", MadeUpTimer)
    assert children.take("r") is None
    children.give("r", used)
    assert children.take("other") is None
    assert children.take("r") is used
    assert children.take("r") is None
    assert timers[0].cancelled
    timers[0].goes_off()  # it may be too late to stop it
    children.give("r", forgotten)
    assert ended == []
    assert (timers[1].seconds, timers[1].daemon, timers[1].started) == (dask_worker.IDLE, True, True)
    timers[1].goes_off()
    timers[1].goes_off()
    assert ended == ["forgotten"]
    assert children.take("r") is None
