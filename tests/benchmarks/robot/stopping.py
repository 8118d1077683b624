"""The host is stopped or fails: time until the car is in neutral, and the message of the host."""

from __future__ import annotations

import signal
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hardware.link.messages import Stop
from tests.benchmarks.robot.outcome import Row, spread
from tests.benchmarks.robot.rig import TIME_TO_LIVE, Rig, messages
from tests.system.rig.journal import opened_after

BOUND = 0.05  # s
SETTLED = TIME_TO_LIVE + 0.1  # s
FAILURES = {"exception": ("--exception-at", "{samples}"), "dying thread": ("--thread-dies-after", "{seconds}")}
CASES = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, *FAILURES)


def stop(
    folder: Path, *, repeats: int, seed: int, bound: float = BOUND, cases: Sequence[signal.Signals | str] = CASES
) -> list[Row]:
    """End ``repeats`` hosts in each of the ``cases``; a STOP, not the deadman, must have opened the buttons."""
    rng = np.random.default_rng(seed)
    rows = []
    with Rig(folder, seed=seed) as rig:
        for case in cases:
            delays, codes = [], []
            for _ in range(repeats):
                began, moment = time.monotonic(), rng.uniform(0.5, 1.5)
                if isinstance(case, signal.Signals):
                    host = rig.drive()
                    time.sleep(moment)
                    stopped_at = host.signal(case)
                    code, _ = host.wait()
                else:
                    host = rig.start_host(*(w.format(samples=int(20 * moment), seconds=moment) for w in FAILURES[case]))
                    code, _ = host.wait()
                    stopped_at = next(entry.time for entry in host.entries() if entry.event == "fails")
                time.sleep(SETTLED)
                opened = opened_after(rig.entries(), stopped_at)
                driven = any(entry.event == "buttons" and entry.value for entry in rig.entries(began))
                stops = [
                    m for came, m in messages(rig.entries(began), "in") if isinstance(m, Stop) and came >= stopped_at
                ]
                delays.append(opened - stopped_at if driven and stops and opened is not None else np.inf)
                codes.append(code)
            passed = sum(delay <= bound and code != 0 for delay, code in zip(delays, codes, strict=True))
            name = case.name if isinstance(case, signal.Signals) else case
            demand = f"STOP and neutral within {1000.0 * bound:.0f} ms, exit code not 0"
            rows.append(Row(name, demand, passed, repeats, {**spread(delays), "exit_codes": sorted(set(codes))}))
    return rows
