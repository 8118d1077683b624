"""The cells of a plan on the workers of a Dask cluster, which need not see the run folder.

This process alone writes the store, as results come in, and chains no cell to another in the cluster: what is finished
is here, whatever dies there.
"""

from __future__ import annotations

import hashlib
import json
import logging
import time
import warnings
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, TypeAlias, Union

from sysid_evo.errors import ArtefactError, InvalidArgument, SchedulerLost
from sysid_evo.plan import dask_worker
from sysid_evo.plan.cell import Cell
from sysid_evo.plan.dask_worker import BLOCKED, DONE, FAILED, LACKS
from sysid_evo.plan.plan import Again, at_home, work_ahead
from sysid_evo.plan.run_state import PATIENCE, TRIES, Here, Ledger
from sysid_evo.plan.store import Parcel, Store, digest_of, packed
from sysid_evo.processors import resolve
from sysid_evo.version import versions

if TYPE_CHECKING:
    from distributed import Client, Future

LOOK = 1.0  # s, between two looks at who is there
ALONE = 5.0  # s without workers, after which that is told
LOST = 20
"""How often a cell is handed out whose data are lost on the way."""
AHEAD = 2
"""Cells that are handed out for every thread of the workers, so that none waits for this process."""
FIRST = 16
"""Cells that are handed out beside, also while there are no workers: a cluster that grows with its work sees some."""


@dataclass
class Away:
    """A cell that was handed out: the future of its result, the workers it may be computed on, our claim on it."""

    cell: Cell
    future: Future[Any]
    only: frozenset[str] | None
    claim: ExitStack
    began: float = field(default_factory=time.monotonic)
    started: bool = False


class Cluster:
    """Hands cells to the workers of ``scheduler``, those first on whose results most work waits.

    What the plan is made ``again`` of, what must be computed where the run is, and what no worker knows, is computed in
    this process.
    """

    def __init__(self, ledger: Ledger, again: Again, scheduler: Scheduler) -> None:
        self.ledger, self.store, self.again, self.scheduler = ledger, ledger.store, again, scheduler
        self.here = Here(ledger)
        self.heard: SimpleQueue[tuple[str, Any]] = SimpleQueue()
        self.away: dict[str, Away] = {}
        self.home = at_home(ledger.plan)
        self.ahead = work_ahead(ledger.plan)
        self.tried: Counter[str] = Counter()
        self.lost: Counter[str] = Counter()
        self.elsewhere: dict[str, float] = {}  # when to look again at what another process computes
        self.lacking: dict[str, frozenset[str]] = {}  # what each worker cannot compute
        self.told: set[str] = set()  # of what workers cannot plan, and why, each once
        self.workers: dict[str, int] = {}
        self.looked, self.seen = 0.0, time.monotonic()

    def to_the_end(self, cells: Sequence[Cell]) -> None:
        """Bring all of ``cells`` to their end. Raises `SchedulerLost`, OSError if a result cannot be written."""
        with connected(self.scheduler) as client:
            first = [cell for cell in cells if cell.digest in self.again.after]
            self.here.to_the_end(first)
            if first and all(self.ledger.ended[cell.digest].failed for cell in first):
                self.here.to_the_end(cells)
            self._with(client, cells)

    def _with(self, client: Client, cells: Sequence[Cell]) -> None:
        self.post = Dispatch(client, self.store, self.again, lambda said: self.heard.put(("said", said)))
        try:
            while left := self.ledger.left(cells):
                self._look(left)
                self._hand_out(left)
                self._hear()
        finally:
            self.post.take_back([away.future for away in self.away.values()])
            for digest in tuple(self.away):
                self._back(digest)

    def _look(self, left: Collection[Cell]) -> None:
        """See, now and then, who is there, and let go of what nobody needs."""
        now = time.monotonic()
        if now - self.looked < LOOK:
            return
        self.looked = now
        self.workers = self.post.workers()
        self.seen = now if self.workers else self.seen
        if now - self.seen > ALONE:
            self.ledger.tell("there is no worker: waiting for one")
        self.post.forget({needed.digest for cell in left for needed in cell.needs})
        for digest, away in tuple(self.away.items()):
            if away.only is not None and not away.only & set(self.workers):
                self._back(digest).future.cancel()

    def _hand_out(self, left: Sequence[Cell]) -> None:
        """Hand out what waits for nothing; compute one cell here if only this process can."""
        now = time.monotonic()
        ready = [
            cell
            for cell in left
            if cell.digest not in self.away
            and not self.ledger.waits(cell)
            and self.elsewhere.get(cell.digest, 0.0) <= now
        ]
        ready.sort(key=lambda cell: -self.ahead[cell.digest])
        own = [cell for cell in ready if self._only_here(cell)]
        room = FIRST + AHEAD * sum(self.workers.values()) - len(self.away)
        known = set(own)
        for cell in [cell for cell in ready if cell not in known][: max(0, room)]:
            self._hand(cell)
        if own and not self.here.attempt(own[0]):
            self.elsewhere[own[0].digest] = now + PATIENCE

    def _only_here(self, cell: Cell) -> bool:
        """Whether no worker can compute ``cell``."""
        there = [worker for worker in self.workers if cell.digest not in self.lacking.get(worker, ())]
        return cell.digest in self.home or bool(self.workers and not there)

    def _hand(self, cell: Cell) -> None:
        """Hand ``cell`` out, unless another process is at it, or nobody is there."""
        claim = ExitStack()
        if not claim.enter_context(self.store.claim(cell)):
            self.elsewhere[cell.digest] = time.monotonic() + PATIENCE
            return
        with claim:
            if self.ledger.found(cell):
                return
            failed = {needed.digest for needed in cell.needs if self.ledger.ended[needed.digest].failed}
            needs = {needed.digest for needed in cell.needs} - failed
            able = frozenset(one for one in self.workers if cell.digest not in self.lacking.get(one, ()))
            only = able if len(able) < len(self.workers) else None
            future = self.post.submit(cell.digest, needs, failed, only, self.ahead[cell.digest])
            if future is None:
                self.elsewhere[cell.digest] = time.monotonic() + LOOK
                return
            self.away[cell.digest] = Away(cell, future, only, claim.pop_all())
            future.add_done_callback(lambda done: self.heard.put(("done", (cell.digest, done))))

    def _back(self, digest: str) -> Away:
        """Give up the claim on a cell that was handed out."""
        away = self.away.pop(digest)
        away.claim.close()
        return away

    def _hear(self) -> None:
        """Take in all that workers said and gave; wait a little if there is nothing."""
        done: dict[str, Future[Any]] = {}
        try:
            wait: float | None = PATIENCE if self.elsewhere else LOOK
            while True:
                kind, what = self.heard.get(timeout=wait) if wait else self.heard.get_nowait()
                wait = None
                if kind == "said":
                    self._said(what)
                elif what[0] in self.away and self.away[what[0]].future is what[1]:
                    done[what[0]] = what[1]
        except Empty:
            pass
        finished = {digest: future for digest, future in done.items() if future.status == "finished"}
        for digest, (answer, parcel) in (self.post.results(finished) if finished else {}).items():
            self._answered(self._back(digest), answer, parcel)
        for digest in done:
            if digest in self.away:
                self._undone(self._back(digest))

    def _said(self, message: dict[str, Any]) -> None:
        """Hand on to the observer what a worker says about its cell."""
        away = self.away.get(message.get("start") or message.get("progress") or "")
        if away is None:
            return
        self._started(away)
        if "progress" in message:
            self.ledger.observer.progress(away.cell, message["done"], message["total"], message["note"])

    def _started(self, away: Away) -> None:
        if not away.started:
            away.started = True
            self.ledger.observer.start(away.cell)

    def _answered(self, away: Away, answer: dict[str, Any], parcel: Parcel) -> None:
        """Put down how a cell ended."""
        cell, status = away.cell, answer["status"]
        for sentence in answer.get("warnings", ()):
            warnings.warn(sentence, stacklevel=2)
        self.ledger.tell(*answer.get("remarks", ()))
        if status == LACKS:
            self._lacks(cell, answer)
            return
        self._started(away)
        if status == DONE:
            try:
                record = self.store.take(cell, parcel)
            except ArtefactError as error:
                self._try_again(away, str(error))
            else:
                self.store.checkpoint(cell).unlink(missing_ok=True)
                self.ledger.end(cell, None, record.seconds)
        elif status == FAILED:
            self.ledger.fail(cell, answer["reason"], answer["traceback"] or "", answer["seconds"])
        elif status == BLOCKED:
            self.ledger.end(cell, answer["reason"], 0.0)
        else:
            self._try_again(away, answer["reason"])

    def _try_again(self, away: Away, why: str) -> None:
        """The process of a cell ended without a result: it is tried once more, then it counts as failed."""
        cell = away.cell
        self.tried[cell.digest] += 1
        if self.tried[cell.digest] >= TRIES:
            seconds = time.monotonic() - away.began
            self.ledger.fail(cell, f"its process ended {TRIES} times ({why})", "", seconds)
        else:
            self.ledger.tell(f"the process of {cell.title} ended ({why}): it is computed again")

    def _undone(self, away: Away) -> None:
        """A cell has no result: its workers were lost too often, workers cannot run it, or what it needs is lost."""
        from distributed import KilledWorker

        cell, seconds = away.cell, time.monotonic() - away.began
        if away.future.status != "error":  # the next look says whether the scheduler is there
            self.looked = 0.0
            self.lost[cell.digest] += 1
            if self.lost[cell.digest] > LOST:
                self.ledger.fail(cell, f"it, or what it needs, was lost in the cluster {LOST} times", "", seconds)
            self.post.mistrust({needed.digest for needed in cell.needs})
            self.post.listen()
            return
        error = away.future.exception()
        if isinstance(error, KilledWorker):
            times = error.allowed_failures + 1
            died = "1 worker" if times == 1 else f"{times} workers, one after the other,"
            self.ledger.fail(cell, f"{died} died while it was there", "", seconds)
        else:
            self.home.add(cell.digest)
            self.ledger.tell(f"workers cannot compute this, so it is computed here: {type(error).__name__}: {error}")

    def _lacks(self, cell: Cell, answer: dict[str, Any]) -> None:
        """A worker does not know the cell: it has another version of something."""
        asked = {one.digest for one in self.ledger.plan} - self.home
        unknown = frozenset(asked - set(answer["knows"]) | {cell.digest})
        self.lacking[answer["worker"]] = unknown
        ours = versions()
        there = {name: version for name, version in answer["versions"].items() if version != ours.get(name)}
        differing = ", ".join(f"{name} {version} instead of {ours.get(name)}" for name, version in there.items())
        why = "; ".join(filter(None, (answer["reason"], differing))) or "a plugin there may be another one"
        told = (
            f"cannot plan {len(unknown)} of {len(self.ledger.plan)} cells ({why}): that is computed by others, or here"
        )
        if told not in self.told:
            self.told.add(told)
            self.ledger.tell(f"the worker {answer['worker']} {told}")


RUNNING = "running"
PATIENT = 5.0  # s, to wait for a worker that takes data
BEFORE, FILES = "before", "files"


class Dispatch:
    """Sends the cells of one run, whose results are in ``store`` and whose plan is made ``again``, over ``client``.

    Every parcel is sent once, and stays in the cluster as long as some cell needs it; ``tell`` is called with what
    workers say while they compute.
    """

    def __init__(self, client: Client, store: Store, again: Again, tell: Callable[[dict[str, Any]], None]) -> None:
        self.client, self.store, self.again, self._tell = client, store, again, tell
        self._address = getattr(client.scheduler, "address", "its address")
        self._sent: dict[str, Future[Any]] = {}
        self._hello: Future[Any] | None = None
        self._orders = self._sendings = 0
        names, files = _packed_files(again.files)
        made_of = {FILES: files, **_made_of(again, store)}
        self._made_of: dict[str, Parcel] = {name: parcel for name, parcel in made_of.items() if parcel}
        self._plan = {"function": again.function, "settings": again.settings, "files": names, "engine": resolve()}
        told = [json.dumps(self._plan, sort_keys=True), *map(digest_of, self._made_of.values())]
        self._run = hashlib.sha256("\n".join(told).encode()).hexdigest()
        self._topic = f"sysid-evo-{self._run[:12]}-{time.time_ns()}"
        self.listen()

    def listen(self) -> None:
        """Ask the scheduler for what workers say: again, if it is a new one."""
        with self._unless_lost():
            self.client.subscribe_topic(self._topic, lambda event: self._tell(event[1]))

    def workers(self) -> dict[str, int]:
        """Return the threads of each worker by its address, none while the scheduler is away. Raises `SchedulerLost`.

        Where there is none, one is asked for, so that a cluster that grows with its work does.
        """
        if self.client.status not in (RUNNING, "connecting"):
            raise SchedulerLost(f"the scheduler at {self._address} does not answer any more: {GO_ON}")
        found: dict[str, int] = {}
        with self._unless_lost():
            info = self.client.scheduler_info()
            found = {address: worker["nthreads"] for address, worker in info["workers"].items()}
            if not found and (self._hello is None or self._hello.status != "pending"):
                self._hello = self.client.submit(dask_worker.hello, pure=False)
        return found if self.client.status == RUNNING else {}

    def submit(
        self,
        digest: str,
        needs: Collection[str],
        failed: Collection[str],
        only: Collection[str] | None,
        priority: float,
    ) -> Future[Any] | None:
        """Ask for the cell ``digest``, to be computed on the workers ``only``; None if there is nobody now."""
        from distributed import TimeoutError as NobodyThere

        future: Future[Any] | None = None
        with self._unless_lost(), suppress(NobodyThere):
            made_of = self._futures(self._made_of)
            needed = self._futures(dict.fromkeys(needs))
            order = {**self._plan, "run": self._run, "topic": self._topic, "digest": digest, "failed": sorted(failed)}
            self._orders += 1
            future = self.client.submit(
                dask_worker.compute,
                json.dumps(order),
                [made for name, made in made_of.items() if name != FILES],
                made_of.get(FILES, ()),
                list(needed.values()),
                key=f"sysid-evo-{digest[:16]}-{self._topic[-19:]}-{self._orders}",
                workers=None if only is None else sorted(only),
                priority=priority,
                pure=False,
            )
        return future

    def results(self, futures: Mapping[str, Future[Any]]) -> dict[str, tuple[dict[str, Any], Parcel]]:
        """Return what came of those ``futures`` that are finished; what was lost on the way is left out."""
        found: dict[str, tuple[dict[str, Any], Parcel]] = {}
        with self._unless_lost():
            came = self.client.gather(dict(futures), errors="skip")
            found = {digest: (json.loads(text), parcel) for digest, (text, parcel) in came.items()}
        return found

    def forget(self, needed: Collection[str]) -> None:
        """Let go of the parcels of all cells but ``needed`` ones, and of what is lost."""
        kept = {name for name in (*needed, *self._made_of) if self._is_there(name)}
        self._sent = {name: future for name, future in self._sent.items() if name in kept}

    def mistrust(self, needed: Collection[str]) -> None:
        """Send the parcels of ``needed`` cells, and what the plan is made of, again when they are asked for."""
        for name in (*needed, *self._made_of):
            self._sent.pop(name, None)

    def take_back(self, futures: Collection[Future[Any]]) -> None:
        """Stop what is under way, and let go of all that was sent."""
        if self.client.status == RUNNING:
            with self._unless_lost():
                self.client.cancel(list(futures))
                self.client.unsubscribe_topic(self._topic)
        self._sent.clear()

    def _futures(self, wanted: Mapping[str, Parcel | None]) -> dict[str, Future[Any]]:
        """Return the futures of parcels; those that are not in the cluster are sent. None is that of a cell."""
        missing = {name: parcel for name, parcel in wanted.items() if not self._is_there(name)}
        parcels = {name: self.store.parcel(name) if parcel is None else parcel for name, parcel in missing.items()}
        if parcels:
            self._sendings += 1  # with a key of an earlier sending, what is let go of it later would go, too
            sending = f"{self._topic[-19:]}-{self._sendings}"
            keys = {name: f"sysid-evo-parcel-{digest_of(parcel)}-{sending}" for name, parcel in parcels.items()}
            came = self.client.scatter({keys[name]: parcel for name, parcel in parcels.items()}, timeout=PATIENT)
            self._sent |= {name: came[key] for name, key in keys.items()}
        return {name: self._sent[name] for name in wanted}

    def _is_there(self, name: str) -> bool:
        return name in self._sent and self._sent[name].status == "finished"

    @contextmanager
    def _unless_lost(self) -> Iterator[None]:
        """Leave the block at once where the connection breaks; Dask tells it in many ways."""
        try:
            yield
        except Exception:  # whatever a closed connection raises
            if self.client.status == RUNNING:
                raise


def _made_of(again: Again, store: Store) -> dict[str, Parcel]:
    """Return what must stand in the run folder before the plan can be made again, as far as it is there."""
    records = {digest: store.find(digest) for digest in again.after}
    found = {digest: store.parcel(digest) for digest, record in records.items() if record and record.status == "done"}
    inside = [
        file.relative_to(store.path).as_posix()
        for name in again.inside
        for file in sorted((store.path / name).rglob("*"))
        if file.is_file() and not file.name.startswith(".")
    ]
    return {**found, BEFORE: packed(store.path, inside)}


def _packed_files(files: Mapping[str, tuple[str, ...]]) -> tuple[dict[str, str], Parcel]:
    """Return where each file that the settings name will stand, and all of them."""
    names, parcel = {}, []
    for number, (text, parts) in enumerate(sorted(files.items())):
        names[text] = f"{number}/{Path(text).name}"
        parcel += [(f"{number}/{Path(part).name}", 0, Path(part).read_bytes()) for part in parts]
    return names, tuple(parcel)


Scheduler: TypeAlias = Union[str, Path, "Client"]
"""``tcp://HOST:PORT``, ``tls://HOST:PORT``, the file that a scheduler wrote, or a client of it."""
FILE_ENDS = ".json"
SCHEMES = ("tcp://", "tls://", "ws://", "wss://")
GO_ON = (
    "what was finished until then is kept, and the same command goes on from there, with another scheduler or without"
)


@contextmanager
def connected(scheduler: Scheduler) -> Iterator[Client]:
    """Connect to ``scheduler``; a client that was given stays connected, another one is closed in the end.

    Certificates for ``tls://`` are those of Dask's configuration. Raises `InvalidArgument`, and `SchedulerLost` if
    nobody answers there.
    """
    from distributed import Client, Security

    if isinstance(scheduler, Client):
        if scheduler.asynchronous:
            raise InvalidArgument("scheduler: expected a synchronous Client, got one with asynchronous=True")
        yield scheduler
        return
    address = address_of(str(scheduler))
    if address.startswith("tls://") and Security().get_connection_args("client").get("ssl_context") is None:
        raise InvalidArgument(
            f"scheduler {address}: expected certificates in Dask's configuration, found none; the page 'A cluster' of "
            "the documentation tells how to make them and where they are named"
        )
    with _quiet():
        try:
            client = Client(address, set_as_default=False, name="sysid-evo")
        except OSError as error:
            why = (str(error).splitlines() or [type(error).__name__])[0]
            raise SchedulerLost(
                f"no scheduler answers at {address} ({why}): start one with 'dask scheduler', name the "
                f"address that it prints, or compute without one; {GO_ON}"
            ) from error
        try:
            yield client
        finally:
            client.close()


@contextmanager
def _quiet() -> Iterator[None]:
    """Let Dask's client log nothing: that a scheduler is lost is an error of ours, told once."""
    log = logging.getLogger("distributed.client")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(level)


def address_of(text: str) -> str:
    """Return the address that ``text`` is, or that stands in the file that it names. Raises `InvalidArgument`."""
    if text.endswith(FILE_ENDS):
        try:
            found = json.loads(Path(text).read_text(encoding="utf-8"))["address"]
        except FileNotFoundError:
            raise InvalidArgument(
                f"scheduler: expected the file that 'dask scheduler --scheduler-file {text}' writes, found none"
            ) from None
        except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
            raise InvalidArgument(f"scheduler: expected the file of a scheduler, {text} is none: {error}") from error
        return str(found)
    if not text.startswith(SCHEMES):
        raise InvalidArgument(
            f"scheduler: expected tcp://HOST:PORT, tls://HOST:PORT or the {FILE_ENDS} file of a scheduler, got {text!r}"
        )
    return text
