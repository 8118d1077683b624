"""The line is cut or clogged, the firmware starts again, or speaks another version: the car stops and stays stopped."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.benchmarks.robot.outcome import Row, spread
from tests.benchmarks.robot.rig import TIME_TO_LIVE, Rig
from tests.system.rig.faults import Fault

MARGIN = 0.02  # s beyond the time to live
BOUNDS = {"unplug": TIME_TO_LIVE, "stall": TIME_TO_LIVE, "reset": 0.0}  # s
HANG = 1.0  # s
AWAY = 0.5  # s that the port is away
WATCHED = 0.5  # s after it is back


def cut(
    folder: Path, *, repeats: int, seed: int, margin: float = MARGIN, kinds: Sequence[str] = tuple(BOUNDS)
) -> list[Row]:
    """Apply each of ``kinds`` ``repeats`` times in the middle of a run, and another protocol version once."""
    rows = [_interrupted(folder, kind, repeats=repeats, seed=seed, bound=BOUNDS[kind] + margin) for kind in kinds]
    return [*rows, _refused(folder, seed)]


def _interrupted(folder: Path, kind: str, *, repeats: int, seed: int, bound: float) -> Row:
    rng = np.random.default_rng(seed)
    delays, ends, drove_on, codes, passed = [], [], 0, [], 0
    place = folder / kind
    place.mkdir()
    with Rig(place, seed=seed) as rig:
        for _ in range(repeats):
            began = time.monotonic()
            host = rig.drive()
            time.sleep(rng.uniform(0.3, 1.3))
            rig.car.inject(Fault(kind=kind, duration=AWAY))
            code, _ = host.wait()
            ended = host.entries()[-1].time
            time.sleep(AWAY + WATCHED)
            entries = rig.entries(began)
            happened = next(entry.time for entry in entries if entry.event == "fault")
            opened = happened
            for entry in entries:
                if entry.event == "buttons" and entry.time >= happened:
                    opened = entry.time if entry.value == 0 else np.inf
                    break
            on = any(e.event == "buttons" and e.value and e.time > opened for e in entries)
            delays.append(opened - happened)
            ends.append(ended - happened)
            drove_on += on
            codes.append(code)
            passed += opened - happened <= bound and ended - happened <= HANG and not on and code != 0
    figures = {
        "open": spread(delays),
        "host_ended": spread(ends),
        "drove_on": drove_on,
        "exit_codes": sorted(set(codes)),
    }
    demand = f"open within {1000.0 * bound:.0f} ms, host ends within {HANG} s, nothing drives on"
    return Row(f"{kind} in mid-run", demand, passed, repeats, figures)


def _refused(folder: Path, seed: int) -> Row:
    place = folder / "version"
    place.mkdir()
    with Rig(place, seed=seed, faults=[Fault(kind="version")]) as rig:
        host = rig.start_host()
        code, errors = host.wait()
        said = errors + str([entry.value for entry in host.entries() if entry.event == "ended"])
        still = not any(entry.event == "buttons" for entry in rig.entries())
    passed = code != 0 and still and "1" in said and "2" in said
    demand = "refused, both versions named, nothing moves"
    return Row("another major version", demand, int(passed), 1, {"exit_code": code, "said": said.strip()[-160:]})
