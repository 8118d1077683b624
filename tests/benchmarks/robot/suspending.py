"""The host is suspended (SIGSTOP) and resumed: are old commands executed?"""

from __future__ import annotations

import signal
import time
from pathlib import Path

import numpy as np

from hardware.link.messages import CommandMessage, State, StatusMessage
from tests.benchmarks.robot.outcome import Row
from tests.benchmarks.robot.rig import TIME_TO_LIVE, Rig, messages
from tests.system.rig.journal import Entry

DURATIONS = (0.1, 1.0, 5.0)  # s
WATCHED = 0.5  # s after it is resumed
MOST = 1


def suspend(folder: Path, *, repeats: int, seed: int, durations: tuple[float, ...] = DURATIONS) -> list[Row]:
    """Stop ``repeats`` hosts for each of ``durations``.

    A stale command is one that was decided before the stop, reached the robot after it, and closed a
    button. A stop beyond the time to live must trip the robot, and no command may close a button
    until a new session.
    """
    rng = np.random.default_rng(seed)
    rows = []
    for duration in durations:
        stale, tripped, driven_on = [], 0, 0
        for repeat in range(repeats):
            place = folder / f"{duration}-{repeat}"
            place.mkdir()
            with Rig(place, seed=seed + repeat) as rig:
                began = time.monotonic()
                host = rig.drive()
                time.sleep(rng.uniform(0.5, 1.0))
                stopped = host.signal(signal.SIGSTOP)
                time.sleep(duration)
                went_on = host.signal(signal.SIGCONT)
                time.sleep(WATCHED)
                entries = rig.entries(began)
                host.signal(signal.SIGTERM)
                host.wait()
                stale.append(len(stale_commands(entries, host.entries(), stopped, went_on)))
                states = [
                    m.state for time, m in messages(entries, "out") if isinstance(m, StatusMessage) and time > stopped
                ]
                tripped += State.TRIPPED in states
                driven_on += any(e.event == "buttons" and e.value and e.time > went_on for e in entries)
        holds = [count <= MOST for count in stale]
        demand = f"at most {MOST} stale command acted on"
        figures = {"stale": max(stale), "tripped": tripped, "drove_on": driven_on}
        passed = sum(holds) if duration <= TIME_TO_LIVE or driven_on == 0 else 0
        rows.append(Row(f"SIGSTOP for {duration} s", demand, passed, repeats, figures))
    return rows


def stale_commands(car: list[Entry], host: list[Entry], stopped: float, went_on: float) -> list[int]:
    """Return the sequences of the accepted driving commands that were decided before the stop and came after it.

    The host notes when it decides and when it sends; a command belongs to the newest decision before
    it came, and is accepted if the robot names it in a status while it drives.
    """
    decided = [entry.time for entry in host if entry.event == "decide"]
    accepted = {
        message.last_sequence
        for _, message in messages(car, "out")
        if isinstance(message, StatusMessage) and message.state is State.DRIVING
    }
    return [
        message.sequence
        for came, message in messages(car, "in")
        if isinstance(message, CommandMessage)
        and came > went_on
        and message.buttons
        and message.sequence in accepted
        and max((time for time in decided if time <= came), default=came) < stopped
    ]
