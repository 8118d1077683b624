"""What is sent over a connection, how often, and what is said when it breaks; the cluster is made up."""

import json
from queue import SimpleQueue
from types import SimpleNamespace

import pytest

from sysid_evo.errors import SchedulerLost
from sysid_evo.plan import Again, Plan, Store, dask_worker, execute
from sysid_evo.plan.dask_executor import BEFORE, FILES, Dispatch
from sysid_evo.plan.dask_worker import BLOCKED, DONE, ENDED, FAILED, LACKS, Child, Children, Unwanted
from sysid_evo.plan.store import digest_of
from tests.fixtures.cells import number

ONE, OTHER = number(1, label="one"), number(2, label="other")


class Broken(Exception):
    """What a closed connection raises."""


class MadeUpClient:
    """Remembers what it is asked; everything fails while ``breaks``."""

    def __init__(self):
        self.status, self.breaks = "running", False
        self.scheduler = SimpleNamespace(address="tcp://made.up:1")
        self.threads = {}
        self.scattered = []
        self.submitted = []
        self.cancelled = []
        self.topics = []
        self.came = {}

    def subscribe_topic(self, topic, handler):
        self._ask()
        self.topics.append(topic)

    def unsubscribe_topic(self, topic):
        self.topics.remove(topic)

    def scheduler_info(self):
        self._ask()
        return {"workers": {name: {"nthreads": n} for name, n in self.threads.items()}}

    def submit(self, function, *arguments, **options):
        self._ask()
        future = SimpleNamespace(status="pending", function=function, arguments=arguments, options=options)
        self.submitted.append(future)
        return future

    def scatter(self, parcels, timeout):
        self._ask()
        self.scattered.append(dict(parcels))
        return {key: SimpleNamespace(status="finished", key=key) for key in parcels}

    def gather(self, futures, errors):
        self._ask()
        assert errors == "skip"
        return {name: self.came[name] for name in futures if name in self.came}

    def cancel(self, futures):
        self.cancelled += futures

    def _ask(self):
        if self.breaks:
            raise Broken


@pytest.fixture
def client():
    return MadeUpClient()


@pytest.fixture
def store(tmp_path):
    """A store with two results, and files that the plan is made of."""
    store = Store(tmp_path / "run")
    execute(Plan.of([ONE, OTHER]), store)
    for name in ("measured/a", "measured/.hidden", "other/b"):
        (store.path / name).parent.mkdir(exist_ok=True)
        (store.path / name).write_text(name)
    return store


def of(client, store, **settings):
    again = Again("module:function", {"n": 1}, **settings)
    return Dispatch(client, store, again, lambda _: None)


def ask(dispatch, *needs, **options):
    given = {"failed": (), "only": None, "priority": 1.0, **options}
    return dispatch.submit("d" * 64, needs, **given)


def sent(client):
    """Return how many parcels went at a time."""
    return [len(parcels) for parcels in client.scattered]


def test_a_parcel_is_sent_once_as_long_as_a_cell_needs_it(client, store):
    dispatch = of(client, store)
    for needs in ((ONE.digest,), (ONE.digest, OTHER.digest), (ONE.digest, OTHER.digest)):
        ask(dispatch, *needs)
    assert sent(client) == [1, 1]
    dispatch.forget([OTHER.digest])
    ask(dispatch, OTHER.digest)
    assert sent(client) == [1, 1]
    ask(dispatch, ONE.digest)
    assert sent(client) == [1, 1, 1]
    assert len({key for parcels in client.scattered for key in parcels}) == 3  # what is let go of has another key
    (needed,) = client.submitted[-1].arguments[3]
    assert client.scattered[-1][needed.key] == store.parcel(ONE.digest)


def test_a_parcel_that_the_cluster_has_lost_is_sent_again(client, store):
    dispatch = of(client, store)
    ask(dispatch, ONE.digest)
    client.submitted[0].arguments[3][0].status = "lost"
    ask(dispatch, ONE.digest)
    assert sent(client) == [1, 1]


def test_what_the_plan_is_made_of_goes_along_and_stays(client, store, tmp_path):
    (tmp_path / "own.py").write_text("x = 1")
    own = str(tmp_path / "own.py")
    broken = number(3, label="broken")
    store.fail(broken, reason="it broke", traceback="", seconds=1.0)
    dispatch = of(client, store, after=(ONE.digest, broken.digest, "f" * 64), inside=("measured",), files={own: (own,)})
    ask(dispatch)
    assert sent(client) == [3]
    dispatch.forget(())
    ask(dispatch)
    assert sent(client) == [3]
    dispatch.mistrust(())
    ask(dispatch)
    assert sent(client) == [3, 3]
    _, before, files, needed = client.submitted[-1].arguments
    parcels = client.scattered[-1]
    assert parcels[files.key] == (("0/own.py", 0, b"x = 1"),)
    assert needed == []
    assert {digest_of(parcels[one.key]) for one in before} == {
        digest_of(store.parcel(ONE.digest)),
        digest_of(dispatch._made_of[BEFORE]),
    }
    assert [name for name, _, _ in dispatch._made_of[BEFORE]] == ["measured/a"]
    assert set(dispatch._made_of) == {ONE.digest, BEFORE, FILES}


def test_files_of_one_name_stand_apart(client, store, tmp_path):
    named = [tmp_path / folder / "own.py" for folder in "ab"]
    for file in named:
        file.parent.mkdir()
        file.write_text(file.parent.name)
    ask(of(client, store, files={str(file): (str(file),) for file in named}))
    assert json.loads(client.submitted[0].arguments[0])["files"] == {
        str(named[0]): "0/own.py",
        str(named[1]): "1/own.py",
    }
    parcel = client.scattered[-1][client.submitted[0].arguments[2].key]
    assert parcel == (("0/own.py", 0, b"a"), ("1/own.py", 0, b"b"))


def test_an_order_names_the_cell_what_failed_and_who_may_compute_it(client, store):
    dispatch = of(client, store)
    ask(dispatch, failed={"b", "a"}, only=frozenset({"two", "one"}), priority=7.5)
    ask(dispatch)
    first, second = client.submitted
    order = json.loads(first.arguments[0])
    assert order["digest"] == "d" * 64
    assert order["failed"] == ["a", "b"]
    assert order["settings"] == {"n": 1}
    assert first.options["workers"] == ["one", "two"]
    assert first.options["priority"] == 7.5
    assert first.options["pure"] is False
    assert second.options["workers"] is None
    assert first.options["key"] != second.options["key"]


def test_runs_of_other_settings_or_other_data_share_no_process(client, store):
    dispatches = [of(client, store), of(client, store), of(client, store, after=(ONE.digest,))]
    for dispatch in dispatches:
        ask(dispatch)
    runs = [json.loads(one.arguments[0])["run"] for one in client.submitted]
    assert runs[0] == runs[1] != runs[2]
    assert len(set(client.topics)) == 3


def test_where_there_is_no_worker_one_is_asked_for_once(client, store):
    dispatch = of(client, store)
    assert dispatch.workers() == dispatch.workers() == {}
    assert len(client.submitted) == 1
    client.submitted[0].status = "finished"
    client.threads = {"a": 4}
    assert dispatch.workers() == {"a": 4}
    client.threads = {}
    dispatch.workers()
    assert len(client.submitted) == 2


def test_a_connection_that_breaks_is_waited_for_and_one_that_is_closed_is_an_error(client, store):
    dispatch = of(client, store)
    client.status, client.breaks = "connecting", True
    assert dispatch.workers() == {}
    assert ask(dispatch, ONE.digest) is None
    assert dispatch.results({"a": None}) == {}
    dispatch.listen()
    client.breaks, client.threads = False, {"a": 1}
    assert dispatch.workers() == {}  # not before it is connected again
    client.status = "closed"
    with pytest.raises(SchedulerLost, match=r"the scheduler at tcp://made\.up:1 does not answer any more"):
        dispatch.workers()


def test_what_breaks_while_the_connection_stands_is_an_error(client, store):
    dispatch = of(client, store)
    client.breaks = True
    for deed in (dispatch.workers, dispatch.listen, lambda: ask(dispatch), lambda: dispatch.results({})):
        with pytest.raises(Broken):
            deed()


def test_results_that_were_lost_on_the_way_are_left_out(client, store):
    parcel = store.parcel(ONE.digest)
    client.came = {"a": (json.dumps({"status": "done"}), parcel)}
    found = of(client, store).results({"a": None, "b": None})
    assert found == {"a": ({"status": "done"}, parcel)}


def test_in_the_end_all_is_taken_back_unless_the_connection_is_gone(client, store):
    dispatch = of(client, store)
    ask(dispatch, ONE.digest)
    dispatch.take_back(["a", "b"])
    assert client.cancelled == ["a", "b"]
    assert client.topics == []
    ask(dispatch, ONE.digest)
    assert sent(client) == [1, 1]
    client.status = "closed"
    dispatch.take_back(["c"])
    assert client.cancelled == ["a", "b"]


ASKED = {
    "run": "r", "function": "tests:none", "settings": {}, "files": {"own.py": "0/own.py"}, "engine": "reference",
}  # fmt: skip


class MadeUpWorker:
    """A process that is none: it hears what it is told, and says what it is given."""

    def __init__(self, inbox):
        self.inbox, self.told, self.dismissed = inbox, [], False

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
    cells = [number(i, label=str(i)) for i in range(count)]
    store = Store(folder)
    execute(Plan.of(cells), store)
    return [store.parcel(cell.digest) for cell in cells]


def computed(child, digest="d", needed=(), wanted=True):
    asked = {**ASKED, "digest": digest, "failed": []}
    said = []
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
    put = []
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

    made = ()

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
    ended = []

    def made(name):
        return SimpleNamespace(dismiss=lambda: ended.append(name))

    children, used, forgotten = Children(), made("used"), made("forgotten")
    timers = MadeUpTimer.made = []
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
