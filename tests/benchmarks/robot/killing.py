"""The host is killed at a random moment: how soon do the buttons open?"""

from __future__ import annotations

import signal
import time
from pathlib import Path

import numpy as np

from tests.benchmarks.robot.outcome import Row, spread
from tests.benchmarks.robot.rig import TIME_TO_LIVE, Rig
from tests.system.rig.journal import opened_after

MARGIN = 0.02  # s beyond the time to live
RUN = 1.0  # s: the moment lies within the first second of driving
SETTLED = TIME_TO_LIVE + 0.25  # s after which the buttons are as they will stay


def kill(folder: Path, *, repeats: int, seed: int, margin: float = MARGIN) -> list[Row]:
    """Kill ``repeats`` hosts, each with the command that closes the buttons under way or just sent."""
    rng = np.random.default_rng(seed)
    delays: list[float] = []
    with Rig(folder, seed=seed) as rig:
        for _ in range(repeats):
            host = rig.drive()
            time.sleep(rng.uniform(0.0, RUN))
            killed = host.signal(signal.SIGKILL)
            host.wait()
            time.sleep(SETTLED)
            opened = opened_after(rig.entries(), killed)
            delays.append(np.inf if opened is None else opened - killed)
    passed = sum(delay <= TIME_TO_LIVE + margin for delay in delays)
    demand = f"open within {1000.0 * (TIME_TO_LIVE + margin):.0f} ms"
    return [Row("kill -9 of the host", demand, passed, repeats, spread(delays))]
