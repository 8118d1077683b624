"""An emulated car and, in a process of its own, the host that drives it."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from hardware.connection import Closeable
from hardware.link.messages import FrameDecoder, Message, unpack
from hardware.recording.journal import SUFFIX
from tests.system.rig.faults import Fault
from tests.system.rig.journal import Entry, RigLogReader, read_journal
from tests.system.rig.terminal_process import TerminalProcess

TIME_TO_LIVE = 0.15  # s, of every command of the control loop
PATIENCE = 20.0  # s for a process to come up on a busy machine
LOOK = 0.005  # s


class Rig(Closeable):
    """One car with its journals in ``folder``; hosts come and go.

    Frames go to a port that is free when the rig is made; each host listens on it in turn.
    """

    def __init__(self, folder: Path, *, seed: int, faults: Sequence[Fault] = ()) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self._tracker = int(probe.getsockname()[1])
        self._folder = folder
        self._hosts: list[subprocess.Popen[bytes]] = []
        journal = folder / "car.jsonl"
        self._journal = RigLogReader(journal)
        self.car = TerminalProcess(tracker=("127.0.0.1", self._tracker), seed=seed, faults=faults, journal=journal)

    def start_host(self, *options: str) -> Host:
        """Start a host with ``options`` of `tests.benchmarks.robot.host`."""
        log = self._folder / f"host-{len(self._hosts)}.jsonl"
        recording = log.with_suffix(SUFFIX)
        words = ["--port", self.car.port, "--tracker", str(self._tracker), "--log", str(log)]
        words += ["--record", str(recording), *options]
        process = subprocess.Popen(
            [sys.executable, "-m", "tests.benchmarks.robot.host", *words],
            cwd=Path(__file__).parents[3],
            stderr=subprocess.PIPE,
        )
        self._hosts.append(process)
        return Host(process, log, recording)

    def entries(self, since: float = 0.0) -> list[Entry]:
        """Return the events of the car from ``since`` (s) on."""
        return [entry for entry in self._journal.update() if entry.time >= since]

    def drive(self, *options: str) -> Host:
        """Start a host and wait until it drives; another one where the machine pauses longer than a command lives."""
        since = time.monotonic()
        host = self.start_host(*options)
        deadline = since + PATIENCE
        while not any(entry.event == "buttons" and entry.value for entry in self.entries(since)):
            if host.process.poll() is not None:
                ended = host.wait()
                if not host.paused:
                    raise RuntimeError(f"the host ended before it drove: {ended} {host.entries()[-1:]}")
                host = self.start_host(*options)
            if time.monotonic() > deadline:
                raise TimeoutError(f"the host did not drive within {PATIENCE} s")
            time.sleep(LOOK)
        return host

    def close(self) -> None:
        for process in self._hosts:
            if process.poll() is None:
                process.kill()
            process.wait()
            if process.stderr is not None:
                process.stderr.close()
        self.car.close()


class Host:
    """A host's process, its log, and its recording."""

    def __init__(self, process: subprocess.Popen[bytes], log: Path, recording: Path) -> None:
        self.process = process
        self.recording = recording
        self._log = log

    def entries(self) -> list[Entry]:
        return read_journal(self._log) if self._log.exists() else []

    @property
    def paused(self) -> bool:
        """Whether it ended because the machine paused longer than a command lives."""
        return "longest pause" in str(self.entries()[-1:])

    def signal(self, number: int) -> float:
        """Send a signal; return when."""
        now = time.monotonic()
        os.kill(self.process.pid, number)
        return now

    def wait(self) -> tuple[int, str]:
        """Return the exit code and the standard error of the process after it has ended."""
        _, errors = self.process.communicate(timeout=PATIENCE)
        return self.process.returncode, errors.decode()


def messages(entries: Sequence[Entry], direction: str) -> list[tuple[float, Message]]:
    """Return the messages that passed the wire "in" to the car or "out" of it, each with the time of its end."""
    decoder, found = FrameDecoder(), []
    for entry in entries:
        if entry.event == direction:
            decoded = map(unpack, decoder.feed(bytes.fromhex(entry.value)))
            found += [(entry.time, message) for message in decoded if message is not None]
    return found
