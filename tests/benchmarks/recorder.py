"""Kills a recorder at random moments, counts lost records, and times its calls.

    python -m tests.benchmarks.recorder [--kills 50]

A separate process records frames and commands as fast as possible, and first writes the number of each record to shared
memory. It is killed with SIGKILL; the journal must be readable and hold every record except, at most, the last one.
"""

from __future__ import annotations

import argparse
import mmap
import os
import random
import signal
import struct
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from hardware.connection import Command, Measurement
from hardware.recording.journal import Recorder, TimedCommand, read_journal
from hardware.toy_car import CAR

COUNTER = struct.Struct("<q")
PATIENCE = 20.0  # s for the recorder to begin
CALLS = 20_000


@dataclass(frozen=True)
class Trial:
    """One kill: records begun, records that can be read, bytes of a torn one."""

    begun: int
    stored: int
    torn: int

    @property
    def lost(self) -> int:
        return self.begun - self.stored


def write_forever(path: Path, counter: Path) -> None:
    """Record numbered events until killed; ``counter`` holds the number begun last."""
    recorder = Recorder(path, CAR, robot="toy")
    with counter.open("r+b") as file, mmap.mmap(file.fileno(), COUNTER.size) as shared:
        number = 0
        while True:
            number += 1
            COUNTER.pack_into(shared, 0, number)
            tell(recorder, number)


def tell(recorder: Recorder, number: int) -> None:
    """Record event ``number``: every tenth event is a command, the others are frames."""
    if number % 10 == 0:
        recorder.on_command(Command(number, 0.0, 0.0, np.zeros(2)))
    else:
        recorder.on_measurement(Measurement(0.0, 0.0, number, "car", True, np.zeros(3)))


def kill_once(path: Path, *, delay: float) -> Trial:
    """Kill a recorder ``delay`` s after its first record and read what it left."""
    counter = path.with_suffix(".count")
    counter.write_bytes(COUNTER.pack(0))
    child = subprocess.Popen([sys.executable, "-m", "tests.benchmarks.recorder", "--write", path, counter])
    try:
        deadline = time.monotonic() + PATIENCE
        while COUNTER.unpack(counter.read_bytes())[0] == 0:
            if child.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError(f"the recorder did not begin (exit code {child.poll()})")
            time.sleep(0.001)
        time.sleep(delay)
    finally:
        os.kill(child.pid, signal.SIGKILL)
        child.wait()
    (begun,) = COUNTER.unpack(counter.read_bytes())
    journal = read_journal(path)
    numbers = [
        event.command.tick if isinstance(event, TimedCommand) else event.frame
        for event in journal.events
        if isinstance(event, (TimedCommand, Measurement))
    ]
    if numbers != list(range(1, len(numbers) + 1)):
        raise RuntimeError(f"{path}: records are missing in the middle")
    return Trial(begun, len(numbers), journal.torn)


def call_times(path: Path) -> np.ndarray:
    """Return the durations in s of calls at 1 kHz, five times a tracker's rate."""
    durations = np.empty(CALLS)
    with Recorder(path, CAR, robot="toy") as recorder:
        for number in range(CALLS):
            begin = time.perf_counter()
            tell(recorder, number + 1)
            durations[number] = time.perf_counter() - begin
            time.sleep(0.001)
    return durations


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write", nargs=2, type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.write:
        write_forever(*arguments.write)
    rng = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as folder:
        trials = [kill_once(Path(folder) / f"{i}.rcj", delay=rng.uniform(0.0, 0.3)) for i in range(arguments.kills)]
        durations = call_times(Path(folder) / "timed.rcj")
    console = Console(width=160)
    lost = [trial.lost for trial in trials]
    console.print(
        f"{len(trials)} kills of a recorder at {np.median([t.stored for t in trials]):.0f} records (median): "
        f"{len(trials)} journals readable, {sum(n == 0 for n in lost)} lost nothing, {sum(n == 1 for n in lost)} one "
        f"record, {sum(n > 1 for n in lost)} more; {sum(t.torn > 0 for t in trials)} had a torn tail"
    )
    console.print(
        f"a call: median {np.median(durations) * 1e6:.0f} us, p99 {np.quantile(durations, 0.99) * 1e6:.0f} us, "
        f"p99.9 {np.quantile(durations, 0.999) * 1e6:.0f} us, longest {durations.max() * 1e6:.0f} us of {CALLS}"
    )
    if max(lost) > 1:
        sys.exit("more than one record was lost")


if __name__ == "__main__":
    main()
