"""A process that computes cells, seen from the one that hands them out.

Both talk in lines of JSON, on standard input and output: nothing but digests, numbers and sentences. Results go
through the store.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from queue import SimpleQueue
from threading import Thread
from typing import Any, TypeAlias

from sysid_evo.processors import INNER_THREADS

PROGRAM = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from sysid_evo.plan.working import main; main()"
GRACE = 10.0  # s, in which a process may write down what it has so far
Inbox: TypeAlias = "SimpleQueue[tuple[Worker, dict[str, Any] | None]]"
"""What workers say; None is the last of each."""


class Worker:
    """A process of its own, with one inner thread; what it says goes into ``inbox``."""

    def __init__(self, inbox: Inbox) -> None:
        environment = dict.fromkeys(INNER_THREADS, "1") | dict(os.environ)
        command = [sys.executable, "-c", PROGRAM, json.dumps(sys.path)]
        with _uninterrupted():
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="utf-8", env=environment
            )
        self._inbox = inbox
        Thread(target=self._listen, daemon=True).start()

    def say(self, **message: Any) -> None:
        """Say something to the process; that it has ended is heard in the inbox."""
        assert self._process.stdin is not None
        with suppress(OSError, ValueError):  # ValueError: dismissed
            self._process.stdin.write(json.dumps(message) + "\n")
            self._process.stdin.flush()

    def dismiss(self) -> None:
        """Let the process end: at once if it is idle, else as soon as it has written down how far it is."""
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.close()

    def wait(self) -> int:
        """Return the exit code of a process that was dismissed, or ended; one that takes too long is killed."""
        try:
            return self._process.wait(GRACE)
        except (subprocess.TimeoutExpired, KeyboardInterrupt):
            self._process.kill()
            return self._process.wait()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                self._inbox.put((self, json.loads(line)))
        self._inbox.put((self, None))


def said_of(code: int) -> str:
    """Return the exit ``code`` of a process as people say it."""
    return signal.Signals(-code).name if code < 0 else f"exit code {code}"


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Let processes that are started inside be deaf to Ctrl-C: this one hears it, and ends them in good order."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
