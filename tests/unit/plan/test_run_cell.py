"""One cell: how an attempt at it ends, and what is sent to a worker; and the order in which cells are handed out."""

import pickle
import warnings
from concurrent.futures import Future

import pytest

from sysid_evo.errors import LinkLost
from sysid_evo.plan import Plan, Store, execute
from sysid_evo.plan.executors import Execution
from sysid_evo.plan.run_cell import CellEnd, CellLost, Unsendable, pickled, run_cell, run_sent
from sysid_evo.plan.store import Stored
from tests.fixtures.cells import Number, Watching, number, tolerant

ONE = number(1, label="one")


def test_an_attempt_ends_as_done_kept_failed_or_busy(tmp_path):
    store = Store(tmp_path)
    with Store(tmp_path).claim(ONE):
        assert run_cell(store, ONE).status == "busy"
    assert [run_cell(store, ONE).status for _ in range(2)] == ["done", "kept"]
    failing = number(2, then=lambda: 1 / 0)
    end = run_cell(store, failing)
    assert end.status == "failed"
    assert 0.0 < end.seconds < 60.0
    assert 0.02 < run_cell(store, number(4, seconds_long=0.02)).seconds < 60.0
    assert end.reason.startswith("ZeroDivisionError: division by zero")
    assert store.find(failing.digest).reason == end.reason
    assert "ZeroDivisionError" in end.traceback
    cell = tolerant(3, (ONE, failing))
    assert run_cell(store, cell, [failing.digest]).status == "done"
    assert run_cell(store, cell, [failing.digest]).status == "kept"
    assert run_cell(store, cell).status == "failed"  # it is not stored: the missing result is expected to be there


def test_what_cannot_be_read_is_computed_again_only_where_that_is_wanted(tmp_path):
    top, watching = number(2, (ONE,)), Watching()
    execute(Plan.of([ONE]), Store(tmp_path))
    (file,) = tmp_path.glob("results/*.txt")
    file.write_text("[")
    end = run_cell(Store(tmp_path), top, repair=False)
    assert "cannot be read" in end.reason
    assert run_cell(Store(tmp_path), top, observer=watching).status == "done"
    assert "count one is computed again" in watching.remarks[0]
    assert watching.computed == ["one"]
    assert Store(tmp_path).load(top) == 3


def test_what_a_repaired_cell_needs_is_repaired_as_well(tmp_path):
    middle = number(2, (ONE,), label="middle")
    top, watching = number(4, (middle,), label="top"), Watching()
    execute(Plan.of([middle]), Store(tmp_path))
    for file in tmp_path.glob("results/*.txt"):
        file.write_text("[")
    assert run_cell(Store(tmp_path), top, observer=watching).status == "done"
    assert watching.computed == ["one", "middle"]
    assert Store(tmp_path).load(top) == 7


def sent(cell, store):
    return run_sent(store, pickled(cell, store), (), lambda *_: None)


@pytest.mark.filterwarnings("default")
def test_a_cell_is_sent_with_its_lambdas_and_returns_with_its_warnings(tmp_path):
    value = 7
    end = sent(number(2, then=lambda: warnings.warn(f"odd {value}", stacklevel=1)), Store(tmp_path))
    assert (end.status, end.warnings) == ("done", ("odd 7",))
    with pytest.raises(Unsendable, match="count one cannot be sent: "):
        pickled(number(2, then=Future().result), Store(tmp_path))


def test_a_lost_link_comes_back_as_it_was_raised_and_other_errors_as_their_reason(tmp_path):
    def lose():
        raise LinkLost("no answer")

    def fail():
        raise RuntimeError("no")

    assert isinstance(sent(number(2, then=lose), Store(tmp_path)).error, ConnectionError)
    end = sent(number(3, then=fail), Store(tmp_path))
    assert (end.status, end.error) == ("failed", None)


def test_recordings_are_not_sent_but_their_record_is(tmp_path):
    local, store = Number(5, label="x" * 10_000).cell(local=True), Store(tmp_path)
    top = number(6, (local, local))
    assert len(pickled(top, store)) > 10_000  # it was not computed: there is nothing else
    run_cell(store, local)
    _, content = pickle.loads(pickled(top, store))
    first, second = pickle.loads(content).needs
    assert (first.digest, first is second, type(first.settings)) == (local.digest, True, Stored)
    assert sent(top, store).status == "done"
    assert store.load(top) == 6 + 5 + 5


def test_a_cell_that_is_another_one_here_is_unknown(tmp_path, monkeypatch):
    cell, store = Plan.of([number(2)]).cells[0], Store(tmp_path)
    bundle = pickled(cell, store)
    monkeypatch.setattr("sysid_evo.plan.cell.CONTRACT", -1)
    end = run_sent(store, bundle, (), lambda *_: None)
    assert (end.status, end.reason) == ("unknown", "another version, or another plugin of that name")
    assert run_sent(store, b"", (), lambda *_: None).reason.startswith("EOFError: ")
    assert store.records() == []


class MadeUpWorkers:
    """Two workers that end cells in scripted ways, by label; other cells are done."""

    def __init__(self, store, **ends):
        self.store, self.ends, self.asked, self.under_way = store, ends, [], 0
        self.under_way_cell = None

    def n_idle(self):
        return 2 - self.under_way

    def submit(self, cell, failed):
        self.under_way += 1
        self.asked.append(cell.name)
        future = Future()
        future.set_result(None)
        return future

    def result(self, cell, future):
        self.under_way -= 1
        end = self.ends.get(cell.name, [])
        found = end.pop(0) if end else run_cell(self.store, cell)
        if isinstance(found, CellLost):
            raise found
        return found

    def progress(self):
        return [(self.under_way_cell, done, 2, "") for done in (1, 2)] if self.under_way_cell else []


def executed(folder, *cells, here=(), **ends):
    """Return the ends of the cells, the calls of the workers, and the observer."""
    watching, store = Watching(), Store(folder)
    execution = Execution(Plan.of(cells), store, watching, None)
    workers = MadeUpWorkers(store, **ends)
    execution.run(workers, here)
    return {cell.name: execution.ended[cell.digest].reason for cell in execution.plan}, workers.asked, watching


def test_that_comes_first_on_whose_result_most_work_waits(tmp_path):
    first, short = number(1, label="first"), number(2, label="short")
    middle = number(3, (first,), "middle")
    _, asked, _ = executed(tmp_path, short, number(5, label="shorter"), number(4, (middle,), "end"))
    assert asked == ["first", "short", "middle", "shorter", "end"]


def test_the_observer_hears_once_that_a_cell_starts_and_never_of_a_stored_one(tmp_path, monkeypatch):
    monkeypatch.setattr("sysid_evo.plan.executors.POLL_INTERVAL", 0.0)
    told = []

    class Told(Watching):
        def start(self, cell):
            told.append(cell.name)

        def progress(self, cell, done, total, note=""):
            told.append((cell.name, done, total))

    cells = [ONE, number(2, label="two"), number(3, label="kept")]
    execution = Execution(Plan.of(cells), Store(tmp_path), Told(), None)
    workers = MadeUpWorkers(execution.store, kept=[CellEnd("kept")])
    workers.under_way_cell = ONE
    execution.run(workers)
    assert sorted(what for what in told if isinstance(what, str)) == ["one", "two"]
    assert told.index("one") < told.index(("one", 1, 2)) < told.index(("one", 2, 2))


def test_a_cell_that_is_lost_is_tried_once_more_and_then_fails_alone(tmp_path):
    cells = [number(1, label="bad"), number(2, label="worse"), number(3, label="fine"), number(4, label="worst")]
    after = number(5, (cells[1],), "after")
    lost = {"bad": [CellLost("it died")], "worse": [CellLost("it died")] * 2, "worst": [CellLost("it died")] * 3}
    ended, asked, watching = executed(tmp_path, *cells, after, **lost)
    assert ended == {
        "bad": None, "worse": "it died, 2 times", "fine": None, "worst": "it died, 2 times",
        "after": "needs count worse, which failed",
    }  # fmt: skip
    assert sorted(asked) == ["bad", "bad", "fine", "worse", "worse", "worst", "worst"]
    assert sorted(watching.remarks) == [
        f"count {name} is computed again: it died" for name in ("bad", "worse", "worst")
    ]
    assert Store(tmp_path).find(cells[1].digest).reason == "it died, 2 times"


def test_a_cell_of_another_process_is_checked_again_and_others_continue(tmp_path):
    ended, asked, _ = executed(tmp_path, ONE, number(2, label="two"), one=[CellEnd("busy")] * 2)
    assert set(ended.values()) == {None}
    assert asked == ["one", "two", "one", "one"]


def test_what_workers_do_not_know_and_what_is_local_is_computed_here_with_a_remark(tmp_path):
    home, local = number(3, label="home"), Number(4, label="local").cell(local=True)
    ended, asked, watching = executed(
        tmp_path, ONE, number(2, label="two"), home, local, here={home.digest}, one=[CellEnd("unknown", reason="why")]
    )
    assert set(ended.values()) == {None}
    assert sorted(asked) == ["one", "two"]
    assert watching.remarks == ["cells that workers cannot run are computed in this process (why)"]


def test_a_long_chain_that_is_blocked_ends(tmp_path):
    cells = [number(0, label="0", then=lambda: 1 / 0)]
    for i in range(1, 2000):
        cells.append(number(i, (cells[-1],), str(i)))
    ended, asked, _ = executed(tmp_path, *cells[:300])
    assert asked == ["0"]
    assert ended["299"] == "needs count 298, which failed"
