"""Starts and ends the emulated car's process."""

from __future__ import annotations

import contextlib
import json
import os
import select
import subprocess
import sys
import time
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import IO, cast

from hardware.connection import Closeable
from sysid_evo.errors import LinkLost
from tests.system.rig.faults import Fault

START = 30.0  # s for an interpreter and its libraries on a busy machine, and a compiler the first time
PATIENCE = 2.0  # s for the process to end by itself


class TerminalProcess(Closeable):
    """A running ``python -m tests.system.rig``; use it in a ``with`` statement.

    ``port`` is the path to open, the same after every unplugging; ``pid`` the process. Frames go to
    ``tracker``. It is in a session of its own, so that an interrupt at the keyboard reaches the host
    alone, and it ends with its host, however that ends. Raises `LinkLost` if it does not start.
    """

    def __init__(
        self,
        *,
        tracker: tuple[str, int] | None = None,
        seed: int | None = None,
        car: int | None = None,
        faults: Sequence[Fault] = (),
        journal: Path | None = None,
    ) -> None:
        options: dict[str, object] = {}
        if tracker is not None:
            options["--tracker"] = f"{tracker[0]}:{tracker[1]}"
        options |= {"--seed": seed} if seed is not None else {}
        options |= {"--car": car} if car is not None else {}
        options |= {"--journal": journal} if journal is not None else {}
        words = [str(word) for pair in options.items() for word in pair]
        words += [word for fault in faults for word in ("--fault", fault.to_json())]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.system.rig", *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            start_new_session=True,
        )
        self._end = weakref.finalize(self, _end, self._process)
        try:
            ready = self._ready(START)
        except BaseException:
            self.close()
            raise
        self.port = str(ready["port"])
        self.pid = int(str(ready["pid"]))

    def inject(self, fault: Fault) -> None:
        """Let ``fault`` happen, its ``at`` counted from now. Raises `LinkLost` if the process has ended."""
        if self._process.stdin is None or self._process.poll() is not None:
            raise LinkLost("the emulated car's process has ended: start another")
        self._process.stdin.write(fault.to_json().encode() + b"\n")

    def close(self) -> None:
        """End the process; a second call does nothing."""
        self._end()

    def _ready(self, timeout: float) -> dict[str, object]:
        """Return what the process prints when it is ready."""
        output = cast("IO[bytes]", self._process.stdout).fileno()
        deadline, line = time.monotonic() + timeout, b""
        while not line.endswith(b"\n"):
            left = deadline - time.monotonic()
            if left <= 0.0 or not select.select([output], [], [], left)[0]:
                raise LinkLost(f"the emulated car's process was not ready within {timeout} s")
            piece = os.read(output, 4096)
            if not piece:
                raise LinkLost("the emulated car's process ended before it was ready; its errors stand above")
            line += piece
        return dict(json.loads(line))


def _end(process: subprocess.Popen[bytes]) -> None:
    """End ``process`` by closing its input, by force if that does not help."""
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            pipe.close()
    for insist in (process.terminate, process.kill):
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(PATIENCE)
            return
        insist()
    process.wait()
