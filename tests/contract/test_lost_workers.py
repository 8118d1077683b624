"""How a scheduler is reached, and what becomes of a cell that comes back without a result; nothing is sent anywhere."""

import logging
from contextlib import ExitStack
from types import SimpleNamespace

import dask
import distributed
import pytest
from distributed import KilledWorker

from sysid_evo.errors import InvalidArgument, SchedulerLost
from sysid_evo.plan import Again, Plan, Store
from sysid_evo.plan.dask_executor import AHEAD, FIRST, LOST, Away, Cluster, address_of, connected
from sysid_evo.plan.dask_worker import BLOCKED, ENDED, FAILED, LACKS
from sysid_evo.plan.plan import at_home
from sysid_evo.plan.run_state import Ledger
from sysid_evo.version import versions
from tests.fixtures.cells import AtHome, Number, Watching

ONE = Number(1, label="one")
TOP = Number(2, (ONE,), label="top")


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


def test_a_client_that_was_given_stays_open_and_must_be_one_that_waits():
    given = MadeUpClient()
    with connected(given) as client:
        assert client is given
    assert not given.closed
    with (
        pytest.raises(InvalidArgument, match="expected a synchronous Client"),
        connected(MadeUpClient(asynchronous=True)),
    ):
        pass


def test_where_nobody_answers_the_error_says_what_to_do(monkeypatch):
    def refuse(*_, **__):
        raise OSError("timed out\nafter 1 s")

    monkeypatch.setattr(MadeUpClient, "__init__", refuse)
    with pytest.raises(SchedulerLost) as lost, connected("tcp://127.0.0.1:9"):
        pass
    assert "no scheduler answers at tcp://127.0.0.1:9 (timed out): start one with 'dask scheduler'" in str(lost.value)
    assert "the same command goes on from there" in str(lost.value)
    assert logging.getLogger("distributed.client").level != logging.CRITICAL


def test_certificates_are_asked_for_where_the_address_needs_some(made):
    with (
        dask.config.set({"distributed.comm.tls.client.cert": None}),
        pytest.raises(InvalidArgument, match=r"scheduler tls://127\.0\.0\.1:9: expected certificates"),
        connected("tls://127.0.0.1:9"),
    ):
        pass
    assert made == []


def test_an_address_stands_in_the_file_of_a_scheduler(tmp_path):
    (tmp_path / "there.json").write_text('{"address": "tcp://127.0.0.1:9", "id": "x"}')
    assert address_of(str(tmp_path / "there.json")) == "tcp://127.0.0.1:9"
    assert address_of("tls://there:1") == "tls://there:1"


@pytest.mark.parametrize("text", ["{", "[1]", "{}", "3"])
def test_a_file_that_is_not_a_schedulers_is_named(tmp_path, text):
    (tmp_path / "odd.json").write_text(text)
    with pytest.raises(InvalidArgument, match=r"expected the file of a scheduler, .*odd\.json is none"):
        address_of(str(tmp_path / "odd.json"))


class MadeUpPost:
    """Remembers what is sent, and to whom."""

    def __init__(self):
        self.sent, self.mistrusted, self.listened = [], [], 0
        self.there, self.nobody = {}, False
        self.needed = set()

    def submit(self, digest, needs, failed, only, priority):
        self.sent.append({"digest": digest, "needs": needs, "failed": failed, "only": only, "priority": priority})
        return None if self.nobody else SimpleNamespace(add_done_callback=lambda _: None, cancel=lambda: None)

    def mistrust(self, needed):
        self.mistrusted.append(needed)

    def listen(self):
        self.listened += 1

    def workers(self):
        return self.there

    def forget(self, needed):
        self.needed = needed


class Here:
    """A cluster of nobody, and what the observer of its run is told."""

    def __init__(self, folder, *cells):
        self.watching, self.store, self.plan = Watching(), Store(folder), Plan.of(cells)
        ledger = Ledger(self.plan, self.store, self.watching)
        ledger.open()
        self.cluster = Cluster(ledger, Again("m:f", {}), "tcp://nowhere:1")
        self.post = MadeUpPost()
        self.cluster.post = self.post
        self.cluster.looked = float("inf")

    def away(self, cell, status="lost", error=None):
        future = SimpleNamespace(status=status, exception=lambda: error)
        return Away(cell, future, None, ExitStack())

    def ended(self, cell):
        found = self.cluster.ledger.ended.get(cell.digest)
        return None if found is None else found.reason


@pytest.fixture
def here(tmp_path):
    return Here(tmp_path, ONE, TOP)


@pytest.mark.parametrize(
    ("allowed", "said"),
    [(0, "1 worker died while it was there"), (3, "4 workers, one after the other, died while it was there")],
)
def test_a_cell_at_which_workers_die_fails(here, allowed, said):
    last = SimpleNamespace(address="a")
    error = KilledWorker("key", last, allowed)
    here.cluster._undone(here.away(ONE, "error", error))
    assert here.ended(ONE) == said
    assert here.store.find(ONE.digest) is not None


def test_what_workers_cannot_run_is_computed_here(here):
    here.cluster.workers = {"a": 1}
    assert not here.cluster._only_here(ONE)
    here.cluster._undone(here.away(ONE, "error", ImportError("no such module")))
    assert here.ended(ONE) is None
    assert here.cluster._only_here(ONE)
    assert here.watching.remarks == ["workers cannot compute this, so it is computed here: ImportError: no such module"]


def test_what_is_lost_on_the_way_is_sent_again_but_not_for_ever(here):
    for _ in range(LOST):
        here.cluster._undone(here.away(TOP))
    assert here.ended(TOP) is None
    assert here.post.mistrusted == [{ONE.digest}] * LOST
    assert here.post.listened == LOST
    assert here.cluster.looked == 0.0  # it is seen at once who is there
    here.cluster._undone(here.away(TOP))
    assert here.ended(TOP) == f"it, or what it needs, was lost in the cluster {LOST} times"


def test_a_process_that_ends_twice_in_a_cell_fails_it(here):
    for times in (1, 2):
        here.cluster._answered(here.away(ONE), {"status": ENDED, "reason": "SIGKILL"}, ())
        assert (here.ended(ONE) is None) == (times == 1)
    assert here.watching.remarks == ["the process of count one ended (SIGKILL): it is computed again"]
    assert here.ended(ONE) == "its process ended 2 times (SIGKILL)"


def test_a_result_that_is_not_whole_counts_as_none(here):
    here.cluster._answered(here.away(ONE), {"status": "done"}, ())
    assert here.ended(ONE) is None
    assert "count one ended (count one: what came has no readable record" in here.watching.remarks[0]


def test_a_failure_elsewhere_is_kept_with_its_time_and_what_is_blocked_is_not_kept(here):
    answer = {"status": FAILED, "reason": "it broke", "traceback": "there", "seconds": 2.5, "remarks": ["so"]}
    with pytest.warns(UserWarning, match="odd"):
        here.cluster._answered(here.away(ONE), {**answer, "warnings": ["odd"]}, ())
    record = here.store.find(ONE.digest)
    assert (record.reason, record.traceback, record.seconds) == ("it broke", "there", 2.5)
    assert here.watching.remarks == ["so"]
    here.cluster._answered(here.away(TOP), {"status": BLOCKED, "reason": "needs count one, which failed"}, ())
    assert here.ended(TOP) == "needs count one, which failed"
    assert here.store.find(TOP.digest) is None


def test_a_worker_that_plans_otherwise_is_not_asked_for_that_again(here):
    here.cluster.workers = {"old": 1, "new": 1}
    ours = versions()
    name = next(iter(ours))
    told = {"status": LACKS, "worker": "old", "knows": [TOP.digest], "reason": "", "versions": {**ours, name: "0.0"}}
    here.cluster._answered(here.away(ONE), told, ())
    assert here.cluster.lacking == {"old": frozenset({ONE.digest})}
    (remark,) = here.watching.remarks
    assert remark.startswith(f"the worker old cannot plan 1 of 2 cells ({name} 0.0 instead of {ours[name]})")
    here.cluster._answered(here.away(ONE), {**told, "worker": "older"}, ())
    assert len(here.watching.remarks) == 1  # of what cannot be planned, each is told once
    here.cluster._hand(ONE)
    assert here.post.sent[-1]["only"] == {"new"}
    here.cluster.lacking["new"] = frozenset({ONE.digest})
    assert here.cluster._only_here(ONE)
    assert not here.cluster._only_here(TOP)


def test_an_order_says_what_failed_and_comes_the_earlier_the_more_waits_for_it(here):
    here.cluster.workers = {"a": 1}
    here.cluster.ledger.fail(ONE, "it broke", "", 1.0)
    for cell in (ONE, TOP):
        here.cluster._hand(cell)
    first, second = here.post.sent
    assert (first["needs"], first["failed"], first["only"]) == (set(), set(), None)
    assert (second["needs"], second["failed"]) == (set(), {ONE.digest})
    assert first["priority"] > second["priority"]
    assert set(here.cluster.away) == {ONE.digest, TOP.digest}


def test_where_nobody_takes_it_a_cell_is_free_for_others(here):
    here.post.nobody = True
    here.cluster._hand(ONE)
    assert here.cluster.away == {}
    with here.store.claim(ONE) as ours:
        assert ours
    assert here.cluster.elsewhere[ONE.digest] > 0.0


def test_no_more_is_handed_out_than_a_cluster_has_room_for(tmp_path):
    cells = [Number(i, label=str(i)) for i in range(FIRST + 3 * AHEAD + 5)]
    here = Here(tmp_path, *cells)
    here.cluster._hand_out(cells)
    assert len(here.post.sent) == FIRST
    here.cluster.workers = {"a": 2, "b": 1}
    here.cluster._hand_out(cells)
    assert len(here.post.sent) == FIRST + 3 * AHEAD


def test_what_needs_a_cell_that_stays_here_stays_here_too():
    home = AtHome(1, label="home")
    after = Number(2, (home,), label="after")
    plan = Plan.of([home, after, Number(3, (after,), label="last"), Number(4, label="free")])
    assert {cell.name for cell in plan if cell.digest in at_home(plan)} == {"home", "after", "last"}
