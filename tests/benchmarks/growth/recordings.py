"""A car simulated by filters, for as long as is asked for: as a data set, and as a log with its column map."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import scipy

from sysid_evo.data import Dataset
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System
from sysid_evo.types import Array

DT = 0.05
LEVELS = (-1.0, 0.0, 1.0)
COLUMNS = """name = "long car"
dt = 0.05
[time]
column = "t"
unit = "ms"
[states]
forward_speed = { column = "v", unit = "m/s" }
lateral_speed = { column = "w", unit = "m/s" }
yaw_rate = { column = "r", unit = "deg/s" }
[controls]
drive = { column = "drive", levels = [-1.0, 0.0, 1.0] }
steer = { column = "steer", levels = [-1.0, 0.0, 1.0] }
[pose]
x = { column = "x", unit = "m" }
y = { column = "y", unit = "m" }
heading = { column = "heading", unit = "deg" }
[motion]
forward = "forward_speed"
lateral = "lateral_speed"
yaw_rate = "yaw_rate"
"""


@lru_cache(maxsize=1)
def driven(rows: int, seed: int = 0) -> tuple[Array, Array, Array]:
    """Return states (rows, 3), controls (rows, 2) and pose (rows, 3) of one long drive with noisy sensors."""
    rng = np.random.default_rng(seed)
    drive, steer = _held(rng, rows, 20), _held(rng, rows, 12)
    v = _lagged(1.5 * drive, 0.7)
    r = _lagged(1.8 * steer * v, 0.2)
    w = -0.08 * r * v
    heading = _summed(r)
    x = _summed(v * np.cos(heading) - w * np.sin(heading))
    y = _summed(v * np.sin(heading) + w * np.cos(heading))
    states = np.stack([v, w, r], axis=1) + rng.normal(0.0, [0.01, 0.005, 0.03], (rows, 3))
    return states, np.stack([drive, steer], axis=1), np.stack([x, y, heading], axis=1)


def long_car(steps: int) -> Dataset:
    """Return a drive of ``steps`` steps."""
    states, controls, _ = driven(steps + 1)
    names = ("forward_speed", "m/s"), ("lateral_speed", "m/s"), ("yaw_rate", "rad/s")
    system = System(
        tuple(Channel(*name) for name in names),
        (Channel("drive", levels=LEVELS), Channel("steer", levels=LEVELS)),
        DT,
        PlanarBody(),
        "long car",
    )
    return Dataset.from_arrays(system, [states], [controls[:-1]])


def write_log(folder: Path, rows: int) -> tuple[Path, Path]:
    """Write a CSV log of ``rows`` rows and its column map; return both paths."""
    import pyarrow as pa
    from pyarrow import csv

    states, controls, pose = driven(rows)
    stamps = np.arange(rows) * DT + np.random.default_rng(1).normal(0.0, 0.001, rows)
    columns = {"t": np.round(1e3 * stamps, 3), "x": pose[:, 0], "y": pose[:, 1], "heading": np.degrees(pose[:, 2])}
    columns |= {"v": states[:, 0], "w": states[:, 1], "r": np.degrees(states[:, 2])}
    columns |= {"drive": controls[:, 0], "steer": controls[:, 1]}
    log, car = folder / "long.csv", folder / "car.toml"
    csv.write_csv(pa.table(columns), log)
    car.write_text(COLUMNS)
    return log, car


def _held(rng: np.random.Generator, rows: int, samples: float) -> Array:
    """Return random levels, each held for ``samples`` samples on average."""
    change = rng.random(rows) < 1.0 / samples
    number = np.cumsum(change)
    return rng.choice(LEVELS, number[-1] + 1)[number]


def _lagged(wanted: Array, seconds: float) -> Array:
    """Return the answer of a first-order lag."""
    share = DT / seconds
    return np.asarray(scipy.signal.lfilter([0.0, share], [1.0, share - 1.0], wanted))


def _summed(rate: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(DT * rate)[:-1]])
