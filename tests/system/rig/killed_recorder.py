"""A recorder that is killed at some moment, and the records that its journal lacks.

A separate process records frames and commands as fast as possible, and first writes the number of each record to shared
memory. It is killed with SIGKILL; the journal must be readable and hold every record except, at most, the last one.
"""

from __future__ import annotations

import mmap
import os
import signal
import struct
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hardware.connection import Command, Measurement
from hardware.recording.journal import Recorder, TimedCommand, read_journal
from hardware.toy_car import CAR

COUNTER = struct.Struct("<q")
PATIENCE = 20.0  # s for the recorder to begin


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
    child = subprocess.Popen([sys.executable, "-m", "tests.system.rig.killed_recorder", path, counter])
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


if __name__ == "__main__":
    write_forever(*map(Path, sys.argv[1:]))
