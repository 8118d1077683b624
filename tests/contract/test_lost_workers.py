"""How a scheduler is reached, what is sent to its workers, and what comes back; the cluster is made up."""

import logging
from concurrent.futures import CancelledError, Future
from types import SimpleNamespace

import distributed
import pytest
from distributed import KilledWorker

from sysid_evo.errors import InvalidArgument, SchedulerLost
from sysid_evo.plan import Plan, Store, dask_executor, execute
from sysid_evo.plan.dask_executor import AHEAD, FIRST, MAX_LOST_ATTEMPTS, DaskExecutor, address_of, connected
from sysid_evo.plan.run_cell import CellEnd, CellLost
from sysid_evo.processors import resolve
from tests.fixtures.cells import number

ONE = number(1, label="one")
TOP = number(2, (ONE,), label="top")
AFTER = number(3, (ONE,), label="after")


class MadeUpClient(distributed.Client):
    """A client of nothing."""

    made = ()

    def __init__(self, address="", **options):
        self.address, self.options, self.closed = address, options, False
        self.level = logging.getLogger("distributed.client").level
        type(self).made.append(self)

    def __del__(self):
        pass

    @property
    def asynchronous(self):
        return bool(self.options.get("asynchronous"))

    def close(self, *_, **__):
        self.closed = True


@pytest.fixture(autouse=True)
def made(monkeypatch):
    """The clients that were made."""
    MadeUpClient.made = []
    monkeypatch.setattr(distributed, "Client", MadeUpClient)
    return MadeUpClient.made


def test_a_client_is_made_of_an_address_without_becoming_that_of_others_and_closed_in_the_end(made):
    log = logging.getLogger("distributed.client")
    before = log.level
    with connected("tcp://127.0.0.1:9") as client:
        assert client is made[0]
        assert [one.closed for one in made] == [False]
        assert log.level == logging.CRITICAL
    assert (made[0].address, made[0].options["set_as_default"]) == ("tcp://127.0.0.1:9", False)
    assert made[0].level == logging.CRITICAL
    assert [one.closed for one in made] == [True]
    assert log.level == before


def test_a_client_must_be_one_that_waits():
    with (
        pytest.raises(InvalidArgument, match="expected a synchronous Client"),
        connected(MadeUpClient(asynchronous=True)),
    ):
        pass


@pytest.mark.parametrize("text", ["{", "[1]", "{}", "3"])
def test_a_file_that_is_not_a_schedulers_is_named(tmp_path, text):
    (tmp_path / "odd.json").write_text(text)
    with pytest.raises(InvalidArgument, match=r"expected the file of a scheduler, got .*odd\.json"):
        address_of(str(tmp_path / "odd.json"))


class MadeUpCluster(MadeUpClient):
    """Remembers what it is asked; everything fails while ``breaks``."""

    def __init__(self):
        super().__init__("tcp://made.up:1")
        self._state, self.breaks, self.threads = "running", False, {"a": 1}
        self.scheduler = SimpleNamespace(address="tcp://made.up:1")
        self.scattered, self.sent, self.topics, self.ended = [], [], [], []

    @property
    def status(self):
        return self._state

    @status.setter
    def status(self, value):
        self._state = value

    def get_executor(self, *, pure):
        assert pure is False
        return SimpleNamespace(submit=self._submit, shutdown=lambda wait: self.ended.append(wait))

    def subscribe_topic(self, topic, handler):
        self._ask()
        self.topics.append(topic)

    def unsubscribe_topic(self, topic):
        self.topics = [one for one in self.topics if one != topic]

    def nthreads(self):
        self._ask()
        return self.threads

    def scatter(self, bundles, *, timeout, hash):  # noqa: A002  # as Dask calls it
        self._ask()
        self.scattered += bundles
        return [SimpleNamespace(status="finished", bundle=bundle) for bundle in bundles]

    def _submit(self, function, task, needed, **where):
        self._ask()
        future = Future()
        self.sent.append(SimpleNamespace(future=future, task=task, needed=[one.bundle for one in needed], **where))
        return future

    def _ask(self):
        if self.breaks:
            raise RuntimeError("broken")


class Here:
    """A run on a made-up cluster, in which ONE is done, and the remarks for the user."""

    def __init__(self, folder):
        self.store, self.client, self.told = Store(folder), MadeUpCluster(), []
        execute(Plan.of([ONE]), self.store)
        self.plan = Plan.of([ONE, TOP, AFTER])
        self.cluster = DaskExecutor(self.store, self.plan.cells, self.client, self.told.append)

    def look(self):
        self.cluster._last_look = 0.0
        return self.cluster.n_idle()

    def answered(self, cell, answer):
        """Send ``cell``, have it answered, and return how it ended."""
        future = self.cluster.submit(cell, ())
        if isinstance(answer, BaseException):
            future.set_exception(answer)
        else:
            future.set_result(answer)
        return self.cluster.result(cell, future)


@pytest.fixture
def here(tmp_path):
    made = Here(tmp_path / "run")
    with made.cluster:
        yield made


def elsewhere(folder, cell):
    """Return the bundle of a cell that was computed in another folder."""
    store = Store(folder)
    execute(Plan.of([cell]), store)
    return store.bundle(cell.digest)


def test_a_result_is_sent_once_as_long_as_a_cell_needs_it_and_again_if_it_is_lost(here):
    here.look()
    for cell in (TOP, AFTER):
        here.cluster.submit(cell, ())
    assert [one.needed for one in here.client.sent] == [[here.store.bundle(ONE.digest)]] * 2
    assert len(here.client.scattered) == 1
    here.cluster._sent[ONE.digest].status = "lost"
    here.answered(number(9, (ONE,), label="nine"), CancelledError())
    here.answered(number(9, (ONE,), label="nine"), CancelledError())
    assert len(here.client.scattered) == 3
    for cell, sent in zip((TOP, AFTER), here.client.sent, strict=False):
        sent.future.set_result((CellEnd("blocked", reason="so"), (), "a"))
        assert here.cluster.result(cell, sent.future).reason == "so"
    assert here.cluster._sent == {}


def test_what_is_lost_is_sent_again_but_not_for_ever(here):
    here.look()
    for _ in range(MAX_LOST_ATTEMPTS):
        assert here.answered(TOP, CancelledError()).status == "busy"
    assert here.cluster._last_look == 0.0  # it is seen at once who is there
    assert here.answered(TOP, CancelledError()).status == "failed"
    assert (
        here.store.find(TOP.digest).reason
        == f"the cell or its inputs were lost in the cluster {MAX_LOST_ATTEMPTS} times"
    )


def test_a_result_is_stored_if_it_is_that_of_the_cell_and_whole(here, tmp_path):
    bundle = elsewhere(tmp_path / "there", TOP)
    assert here.answered(TOP, (CellEnd("done", 2.0), bundle, "a")).status == "done"
    assert here.store.load(TOP) == 3
    with pytest.raises(CellLost, match="the received files are not the complete result"):
        here.answered(AFTER, (CellEnd("done", 2.0), bundle, "a"))
    with here.store.claim(AFTER) as ours:
        assert ours
    assert not here.store.done(AFTER)


def test_a_failure_is_stored_and_what_is_blocked_is_not(here):
    here.answered(TOP, (CellEnd("failed", 2.5, "it broke", "there"), (), "a"))
    record = here.store.find(TOP.digest)
    assert (record.reason, record.traceback, record.seconds) == ("it broke", "there", 2.5)
    here.answered(AFTER, (CellEnd("blocked", reason="needs it"), (), "a"))
    assert here.store.find(AFTER.digest) is None


def test_workers_that_die_are_counted_and_a_cell_that_they_cannot_run_is_unknown(here):
    for allowed, reason in ((0, "1 worker died while computing it"), (3, "4 workers died while computing it")):
        end = here.answered(TOP, KilledWorker("key", SimpleNamespace(address="a"), allowed))
        assert (end.status, end.reason) == ("failed", reason)
        assert here.store.find(TOP.digest).reason == reason
    end = here.answered(TOP, ImportError("no such module"))
    assert (end.status, end.reason) == ("unknown", "ImportError: no such module")


def test_a_cell_that_a_worker_does_not_know_is_sent_to_the_others_and_then_unknown(here):
    here.client.threads = {"old": 1, "new": 1}
    here.look()
    unknown = CellEnd("unknown", reason="another version")
    assert here.answered(TOP, (unknown, (), "old")).status == "busy"
    assert here.told == ["the worker old cannot run some cells (another version)"]
    future = here.cluster.submit(TOP, ())
    assert here.client.sent[-1].workers == ["new"]
    here.client.threads = {"old": 1}
    here.look()
    assert future.cancelled()  # the only one who knew it has gone
    assert here.cluster.result(TOP, future).status == "busy"
    here.client.threads = {"old": 1, "new": 1}
    here.look()
    assert here.answered(TOP, (unknown, (), "new")).status == "unknown"


def test_a_cell_at_which_another_process_is_waits_and_one_that_it_did_is_kept(here):
    with Store(here.store.path).claim(TOP):
        assert here.cluster.submit(TOP, ()) is None
    execute(here.plan, Store(here.store.path), only=[TOP])
    future = here.cluster.submit(TOP, ())
    assert here.cluster.result(TOP, future).status == "kept"
    assert here.client.sent == []


def test_two_cells_are_sent_for_each_thread_and_some_before_there_are_workers(here, monkeypatch):
    here.client.threads = {}
    assert here.look() == FIRST
    here.client.threads = {"a": 2, "b": 1}
    assert here.look() == 3 * AHEAD
    here.cluster.submit(TOP, ())
    assert here.look() == 3 * AHEAD - 1
    here.client.threads = {}
    monkeypatch.setattr("sysid_evo.plan.dask_executor.ALONE", -1.0)
    here.look()
    assert here.told == ["the scheduler has no worker: waiting for one"]


def test_a_connection_that_breaks_is_waited_for_and_one_that_is_closed_is_an_error(here):
    here.look()
    here.client.status, here.client.breaks = "connecting", True
    assert here.look() == 0
    assert here.cluster.submit(TOP, ()) is None
    with here.store.claim(TOP) as ours:
        assert ours
    here.client.status = "closed"
    with pytest.raises(SchedulerLost, match=r"the scheduler at tcp://made\.up:1 no longer answers"):
        here.look()


def test_an_error_with_a_working_connection_is_raised(here):
    here.client.breaks = True
    for deed in (here.look, lambda: here.cluster.submit(TOP, ())):
        with pytest.raises(RuntimeError, match="broken"):
            deed()


@pytest.mark.parametrize("name", ["auto", "reference"])
def test_a_worker_has_the_engine_of_the_process_that_sent_the_cell(monkeypatch, here, tmp_path, name):
    """Read on a machine whose own environment names nothing."""
    monkeypatch.setenv("SYSID_EVO_ENGINE", name)
    here.cluster.submit(TOP, ())
    worker = SimpleNamespace(
        local_directory=tmp_path, address="a", get_current_task=lambda: "key", status=distributed.Status.running,
        state=SimpleNamespace(tasks={"key": SimpleNamespace(state="executing")}),
    )  # fmt: skip
    monkeypatch.setattr(distributed, "get_worker", lambda: worker)
    monkeypatch.setattr(dask_executor, "run_sent", lambda *_: CellEnd("failed", reason=resolve()))
    monkeypatch.delenv("SYSID_EVO_ENGINE")
    assert dask_executor.compute(here.client.sent[0].task, ())[0].reason == name
