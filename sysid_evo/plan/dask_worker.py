"""What a worker of a cluster runs: one cell, in a process of its own that never saw the run folder.

In come texts and bytes, and out go texts and bytes: see `sysid_evo.plan.dask_executor` for the other side.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Lock, Timer
from typing import Any

from sysid_evo.plan.plan import Again
from sysid_evo.plan.processes import Inbox, Worker, said_of
from sysid_evo.plan.store import Parcel, Store, unpack
from sysid_evo.version import versions

IDLE = 60.0  # s, after which a process that nobody asks for anything ends
WATCH = 0.5  # s, between two looks at whether the result is still wanted
KEPT = 1000
"""Parcels that a process keeps unpacked; those not used for longest go first."""
LACKS, DONE, FAILED, BLOCKED, ENDED = "lacks", "done", "failed", "blocked", "ended"
"""How an order ends: the plan here has no such cell, the three ends of a cell, or the process of the cell ended."""


def hello() -> None:
    """Show that there is a worker."""


def compute(order: str, before: Sequence[Parcel], files: Parcel, needed: Sequence[Parcel]) -> tuple[str, Parcel]:
    """Compute the cell that ``order`` names; return how it ended as JSON, and its record and files.

    ``before`` and ``files`` are what its plan is made of, ``needed`` the results that it takes.
    """
    from distributed import Status, get_worker

    asked = json.loads(order)
    worker = get_worker()
    task = worker.get_current_task()

    def wanted() -> bool:
        state = worker.state.tasks.get(task)
        return worker.status in (Status.running, Status.paused) and state is not None and state.state == "executing"

    def tell(message: dict[str, Any]) -> None:
        worker.log_event(asked["topic"], message)

    child = CHILDREN.take(asked["run"]) or Child(Path(worker.local_directory), asked, before, files)
    answer: dict[str, Any] | None = None
    try:
        answer, parcel = child.compute(asked, needed, wanted, tell)
    finally:
        if answer is None or answer["status"] == ENDED:
            child.dismiss()
        else:
            CHILDREN.give(asked["run"], child)
    return json.dumps({**answer, "worker": worker.address}), parcel


class Unwanted(Exception):
    """Nobody waits for the result any more."""


class Child:
    """A process that computes cells of one plan, in a new folder below ``place``."""

    def __init__(self, place: Path, asked: Mapping[str, Any], before: Sequence[Parcel], files: Parcel) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="sysid-evo-", dir=place))
        self.store = Store(self.folder / "run")
        for parcel in before:
            unpack(parcel, self.store.path)
        self.before = {name for parcel in before for name, _, _ in parcel}
        unpack(files, self.folder / "files")
        names = {text: str(self.folder / "files" / name) for text, name in asked["files"].items()}
        again = Again(asked["function"], asked["settings"]).with_files_at(names)
        self.inbox: Inbox = SimpleQueue()
        self.worker = Worker(self.inbox)
        self.worker.say(threads=1, function=again.function, settings=again.settings, engine=asked["engine"])
        self.worker.say(folder=str(self.store.path))
        self.knows: frozenset[str] | None = None
        self.cannot = ""
        self.kept: dict[str, tuple[str, ...]] = {}

    def compute(
        self,
        asked: Mapping[str, Any],
        needed: Sequence[Parcel],
        wanted: Callable[[], bool],
        tell: Callable[[dict[str, Any]], None],
    ) -> tuple[dict[str, Any], Parcel]:
        """Return how the cell ended, and its parcel if it is done. Raises `Unwanted`."""
        for parcel in needed:
            self._keep(parcel)
        if self.knows is None:
            message = self._hear(wanted)
            if message is None:
                return self._lost(), ()
            self.knows, self.cannot = frozenset(message.get("knows", ())), message.get("cannot", "")
        if asked["digest"] not in self.knows:
            known = sorted(self.knows or ())
            return {"status": LACKS, "reason": self.cannot, "knows": known, "versions": versions()}, ()
        self.worker.say(compute=asked["digest"], failed=asked["failed"], alone=True)
        reason: str | None = None
        told: dict[str, list[str]] = {"remarks": [], "warnings": []}
        while (message := self._hear(wanted)) is not None and "idle" not in message:
            if "stop" in message:
                return {"status": ENDED, "reason": message["stop"][1]}, ()
            if "end" in message:
                reason = message["reason"]
            elif "remark" in message or "warning" in message:
                for kind, sentence in message.items():
                    told[f"{kind}s"].append(sentence)
            else:
                tell(message)
        return (self._lost(), ()) if message is None else self._ended(asked["digest"], reason, told)

    def dismiss(self) -> None:
        """End the process; what it had is removed."""
        self.worker.dismiss()
        self.worker.wait()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _hear(self, wanted: Callable[[], bool]) -> dict[str, Any] | None:
        while True:
            try:
                return self.inbox.get(timeout=WATCH)[1]
            except Empty:
                if not wanted():
                    raise Unwanted from None

    def _lost(self) -> dict[str, Any]:
        return {"status": ENDED, "reason": said_of(self.worker.wait())}

    def _ended(self, digest: str, reason: str | None, told: dict[str, Any]) -> tuple[dict[str, Any], Parcel]:
        record = self.store.find(digest)
        if reason is None:
            parcel = self.store.parcel(digest)
            self._keep(parcel)
            return {"status": DONE, **told}, parcel
        if record is None:
            return {"status": BLOCKED, "reason": reason, **told}, ()
        return {
            "status": FAILED,
            "reason": reason,
            "traceback": record.traceback,
            "seconds": record.seconds,
            **told,
        }, ()

    def _keep(self, parcel: Parcel) -> None:
        """Unpack a result that is not here yet; remove the one that was not used for longest, if there are many."""
        if not parcel or parcel[0][0] in self.before:
            return
        record = parcel[0][0]
        if self.kept.pop(record, None) is None and not (self.store.path / record).is_file():
            unpack(parcel[1:] + parcel[:1], self.store.path)
        self.kept[record] = tuple(name for name, _, _ in parcel)
        if len(self.kept) > KEPT:
            for name in self.kept.pop(next(iter(self.kept))):
                (self.store.path / name).unlink(missing_ok=True)


class Children:
    """The idle processes of this worker, by the run that they compute for."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._idle: dict[str, list[tuple[Child, Timer]]] = {}

    def take(self, run: str) -> Child | None:
        """Return an idle process for ``run``, if there is one."""
        with self._lock:
            waiting = self._idle.get(run)
            if not waiting:
                return None
            child, timer = waiting.pop()
            timer.cancel()
            return child

    def give(self, run: str, child: Child) -> None:
        """Keep a process for a while."""
        timer = Timer(IDLE, self._dismiss, (run, child))
        timer.daemon = True
        with self._lock:
            self._idle.setdefault(run, []).append((child, timer))
        timer.start()

    def _dismiss(self, run: str, child: Child) -> None:
        with self._lock:
            waiting = [pair for pair in self._idle.get(run, []) if pair[0] is not child]
            if len(waiting) == len(self._idle.get(run, [])):
                return
            self._idle[run] = waiting
        child.dismiss()


CHILDREN = Children()
