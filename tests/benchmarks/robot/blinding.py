"""The tracker fails in every way it can: the car stops in time, and nothing is computed across a jump."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hardware.link.messages import State, StatusMessage
from hardware.recording.journal import read_journal
from hardware.recording.journal_reader import raw_log
from hardware.toy_car import CAR
from sysid_evo.data.preparation import prepare
from tests.benchmarks.robot.outcome import Row, spread
from tests.benchmarks.robot.rig import Host, Rig, messages
from tests.system.rig.faults import Fault
from tests.system.rig.journal import Entry

BOUND = 0.16  # s from the last pose to neutral
STALE, LOST = 0.1, 0.5  # s: poses older than this mean neutral, end the run
FAULTS = (
    *((kind, duration) for duration in (0.05, 0.1, 0.15, 0.3) for kind in ("dropout", "silence")),
    ("frozen", 0.3),
    ("identity_swap", 0.3),
    ("yaw_flip", 0.3),
    ("dropout", 0.8),
)
REST = 1.0  # s between two faults, in which the car drives again
DRIVEN = 0.8  # s before a fault: longer than the filter of a recording, which needs 0.44 s without a gap
ATTEMPTS = 5
TOP_SPEED, TOP_YAW_RATE = 2.5, 6.0  # m/s, rad/s: more than the car reaches, less than any jump amounts to


def blind(
    folder: Path,
    *,
    repeats: int,
    seed: int,
    bound: float = BOUND,
    faults: Sequence[tuple[str, float]] = FAULTS,
) -> list[Row]:
    """Let each of ``faults`` (kind, s) happen ``repeats`` times while the car drives in circles."""
    rows = []
    for kind, duration in faults:
        place = folder / f"{kind}-{duration}"
        place.mkdir()
        if duration > LOST:
            rows.append(_ending(place, kind, duration, repeats=repeats, seed=seed, bound=bound))
        elif duration > STALE:
            rows.append(_long(place, kind, duration, repeats=repeats, seed=seed, bound=bound))
        else:
            rows.append(_short(place, kind, duration, repeats=repeats, seed=seed))
    return rows


def _short(folder: Path, kind: str, duration: float, *, repeats: int, seed: int) -> Row:
    with Rig(folder, seed=seed) as rig:
        host, windows = _drive_through(rig, kind, duration, repeats, seed)
        entries = rig.entries()
        ran = host.process.poll() is None
        _end(host)
    states = [m.state for t, m in messages(entries, "out") if isinstance(m, StatusMessage) and t > windows[0]]
    passed = repeats if ran and State.TRIPPED not in states else 0
    paused = sum(_neutral_after(entries, window) < window + REST for window in windows)
    return Row(
        f"{kind} for {1000 * duration:.0f} ms", "the run continues, no trip", passed, repeats, {"paused": paused}
    )


def _long(folder: Path, kind: str, duration: float, *, repeats: int, seed: int, bound: float) -> Row:
    with Rig(folder, seed=seed) as rig:
        host, windows = _drive_through(rig, kind, duration, repeats, seed)
        entries = rig.entries()
        _end(host)
    delays = [_neutral_after(entries, window) - _last_pose(host, window) for window in windows]
    speed, yaw_rate = _fastest(host)
    sound = speed < TOP_SPEED and yaw_rate < TOP_YAW_RATE
    passed = sum(delay <= bound for delay in delays) if sound else 0
    figures = {**spread(delays), "fastest": f"{speed:.2f} m/s {yaw_rate:.1f} rad/s"}
    demand = f"neutral within {1000.0 * bound:.0f} ms of the last pose, no speed out of a jump"
    return Row(f"{kind} for {1000 * duration:.0f} ms", demand, passed, repeats, figures)


def _ending(folder: Path, kind: str, duration: float, *, repeats: int, seed: int, bound: float) -> Row:
    delays, reasons = [], []
    with Rig(folder, seed=seed) as rig:
        for repeat in range(repeats):
            host, windows = _drive_through(rig, kind, duration, 1, seed + repeat)
            host.wait()
            delays.append(_neutral_after(rig.entries(), windows[0]) - _last_pose(host, windows[0]))
            reasons.append(host.entries()[-1].value["reason"])
    passed = sum(d <= bound and reason == "TRACKER_LOST" for d, reason in zip(delays, reasons, strict=True))
    demand = f"neutral within {1000.0 * bound:.0f} ms of the last pose, the run ends"
    figures = {**spread(delays), "ended": sorted(set(reasons))}
    return Row(f"{kind} for {1000 * duration:.0f} ms", demand, passed, repeats, figures)


def _drive_through(rig: Rig, kind: str, duration: float, repeats: int, seed: int) -> tuple[Host, list[float]]:
    """Start a host, let the fault happen ``repeats`` times, and return the host and when the windows opened (s).

    Begin again where the machine pauses longer than a command lives.
    """
    for _attempt in range(ATTEMPTS):
        rng = np.random.default_rng(seed)
        began = time.monotonic()
        host = rig.drive()
        for _ in range(repeats):
            time.sleep(DRIVEN + rng.uniform(0.0, 0.1))
            rig.car.inject(Fault(kind=kind, duration=duration))
            time.sleep(duration + REST)
        if not host.paused:
            break
    windows = [entry.time for entry in rig.entries(began) if entry.event == "fault"]
    return host, windows


def _end(host: Host) -> None:
    if host.process.poll() is None:
        host.process.terminate()
    host.wait()


def _neutral_after(entries: Sequence[Entry], time: float) -> float:
    """Return when the buttons next opened after ``time``; infinite if they did not."""
    return min((e.time for e in entries if e.event == "buttons" and e.value == 0 and e.time >= time), default=math.inf)


def _last_pose(host: Host, window: float) -> float:
    """Return when the newest true pose before ``window`` was taken."""
    return max(entry.time for entry in host.entries() if entry.event == "frame" and entry.time < window)


def _fastest(host: Host) -> tuple[float, float]:
    """Return the largest speed and yaw rate that the loop accepted or that the prepared recording holds."""
    seen = [np.array([entry.value["state"] for entry in host.entries() if entry.event == "decide"])]
    seen += [episode.states for episode in prepare(raw_log(read_journal(host.recording))[0], CAR).episodes]
    states = np.concatenate(seen)
    return float(np.hypot(states[:, 0], states[:, 1]).max()), float(np.abs(states[:, 2]).max())
