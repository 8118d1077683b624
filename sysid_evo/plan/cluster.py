"""Computes the cells of a plan on the workers of a Dask cluster, which need not see the run folder.

This process alone writes the store, as results come in, and chains no cell to another in the cluster: what is finished
is here, whatever dies there.
"""

from __future__ import annotations

import time
import warnings
from collections import Counter
from collections.abc import Collection, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from sysid_evo.errors import ArtefactError
from sysid_evo.plan.again import Again
from sysid_evo.plan.cell import Cell
from sysid_evo.plan.dispatch import Dispatch
from sysid_evo.plan.execution import PATIENCE, Here
from sysid_evo.plan.ledger import Ledger
from sysid_evo.plan.parcels import Parcel
from sysid_evo.plan.plan import Plan
from sysid_evo.plan.remote import BLOCKED, DONE, FAILED, LACKS
from sysid_evo.plan.scheduler import Scheduler, connected
from sysid_evo.plan.side_by_side import TRIES, work_ahead
from sysid_evo.store.manifest import versions

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


def at_home(plan: Plan) -> set[str]:
    """Return the digests of the cells that must be computed where the run is, and of those that need them."""
    found: set[str] = set()
    for cell in plan:
        if cell.at_home or any(needed.digest in found for needed in cell.needs):
            found.add(cell.digest)
    return found
