"""The scheduler of a Dask cluster, by its address, by the file that it wrote, or as a client that is there already."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, Union

from sysid_evo.errors import InvalidArgument, SchedulerLost

if TYPE_CHECKING:
    from distributed import Client

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
            raise SchedulerLost(
                f"no scheduler answers at {address} ({_first(error)}): start one with 'dask scheduler', name the "
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
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise InvalidArgument(f"scheduler: expected the file of a scheduler, {text} is none: {error}") from error
        return str(found)
    if not text.startswith(SCHEMES):
        raise InvalidArgument(
            f"scheduler: expected tcp://HOST:PORT, tls://HOST:PORT or the {FILE_ENDS} file of a scheduler, got {text!r}"
        )
    return text


def _first(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
