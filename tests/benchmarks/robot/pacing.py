"""Timing of the control loop over a long run, alone and with other busy processes."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

import numpy as np

from hardware.recording.journal import SUFFIX
from tests.benchmarks.robot.outcome import Row
from tests.benchmarks.robot.rig import Rig

RATE = 20  # Hz
BUSY = 4
LATENESS, GAP, DRIFT, BUSY_GAP = 0.005, 0.1, 0.005, 0.15  # s


def pace_idle(folder: Path, *, duration: float, seed: int) -> list[Row]:
    """Drive for ``duration`` s on a machine that does nothing else."""
    figures = _drive(folder, duration, seed)
    holds = figures["p99_lateness"] <= LATENESS and figures["longest_gap"] < GAP and abs(figures["drift"]) < DRIFT
    demand = "p99 lateness <= 5 ms, no gap >= 100 ms, drift < 5 ms"
    return [_row(f"20 Hz for {duration:.0f} s, idle", demand, holds, figures)]


def pace_busy(folder: Path, *, duration: float, seed: int) -> list[Row]:
    """Drive for ``duration`` s while four processes compute without a pause."""
    spinners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(BUSY)]
    try:
        figures = _drive(folder, duration, seed)
    finally:
        for spinner in spinners:
            spinner.kill()
            spinner.wait()
    demand = "no gap >= 150 ms"
    return [
        _row(f"20 Hz for {duration:.0f} s, {BUSY} busy processes", demand, figures["longest_gap"] < BUSY_GAP, figures)
    ]


WRITER = """
import os, sys
while True:
    with open(sys.argv[1], "wb", buffering=0) as file:
        for _ in range(256):
            file.write(os.urandom(1 << 20))
        os.fsync(file.fileno())
"""
WRITERS = 2


def pace_disk(folder: Path, *, duration: float, seed: int) -> list[Row]:
    """Drive while four processes compute and two write to the disk of the journal without a pause.

    What the rig itself writes lies in memory, so that only the recorder of the run waits for the disk.
    """
    loads = [[WRITER, str(folder / f"load-{number}")] for number in range(WRITERS)] + [["while True: pass"]] * BUSY
    spinners = [subprocess.Popen([sys.executable, "-c", *load]) for load in loads]
    try:
        with tempfile.TemporaryDirectory(dir="/dev/shm") as memory:
            figures = _drive(Path(memory), duration, seed, "--record", str(folder / f"run{SUFFIX}"))
    finally:
        for spinner in spinners:
            spinner.kill()
            spinner.wait()
    case = f"20 Hz for {duration:.0f} s, {BUSY} busy processes, {WRITERS} that write"
    return [_row(case, "no gap >= 150 ms", figures["longest_gap"] < BUSY_GAP, figures)]


def _drive(folder: Path, duration: float, seed: int, *options: str) -> dict[str, float | str]:
    with Rig(folder, seed=seed) as rig:
        for task in Path(
            f"/proc/{rig.car.pid}/task"
        ).iterdir():  # a board does not share the load, where that is allowed
            with suppress(PermissionError):
                os.sched_setscheduler(int(task.name), os.SCHED_RR, os.sched_param(2))
        host = rig.start_host("--samples", str(int(duration * RATE)), *options)
        host.process.wait(duration + 60.0)
        ended = next(entry.value for entry in host.entries() if entry.event == "ended")
    rig_end = next(entry.value for entry in rig.entries() if entry.event == "end")
    lateness, gaps = np.array(ended["lateness"]), np.array(ended["gaps"])
    return {
        "ended": ended["reason"],
        "ticks": len(lateness),
        "p50_lateness": float(np.median(lateness)),
        "p99_lateness": float(np.quantile(lateness, 0.99)),
        "worst_lateness": float(lateness.max()),
        "longest_gap": float(gaps.max()),
        "drift": ended["drift"],
        "skipped": ended["skipped"],
        "stale": ended["stale"],
        "car_lateness": rig_end["lateness"],
    }


def _row(case: str, demand: str, holds: bool, figures: dict[str, float | str]) -> Row:
    shown = {
        name: value if isinstance(value, int | str) else f"{1000.0 * value:.2f} ms" for name, value in figures.items()
    }
    return Row(case, demand, int(holds and figures["ended"] == "SAMPLES"), 1, shown)
