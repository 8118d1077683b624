"""What goes to the workers of a cluster and comes back, over a connection that may break."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid_evo.errors import SchedulerLost
from sysid_evo.plan import remote
from sysid_evo.plan.again import Again
from sysid_evo.plan.parcels import Parcel, digest_of, packed
from sysid_evo.plan.scheduler import GO_ON
from sysid_evo.plan.store import Store

if TYPE_CHECKING:
    from distributed import Client, Future

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
        self._plan = {"function": again.function, "settings": again.settings, "files": names}
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
                self._hello = self.client.submit(remote.hello, pure=False)
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
                remote.compute,
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
