"""Recordings of two real cars and of the emulated car, each with held-out data, and errors over seeds."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from evaluation.prediction.scores import ModelPrediction
from sysid_evo.data import Dataset
from sysid_evo.motion import PlanarBody
from sysid_evo.registry import make_robot
from sysid_evo.system import Channel, System
from sysid_evo.validation.estimates import Draws

TEST_EPISODE = {"slippery_20hz": "2025-04-16-17-36-01", "free_20hz": "car_1_Datarecording_09_16_2024_10_12_05"}
EMULATED, RECORDED_TIME, HELD_BACK = "emulated_car", 360.0, 0.25
SECOND = 20
CAR = System(
    states=(Channel("forward_speed", "m/s"), Channel("lateral_speed", "m/s"), Channel("yaw_rate", "rad/s")),
    controls=(Channel("drive", low=0.0, high=1.0), Channel("steer", low=-1.0, high=1.0)),
    dt=0.05,
    motion=PlanarBody(),
    name="throttle car",
)


def recording(log: str) -> tuple[Dataset, Dataset]:
    """Return training and test set of one of the cars."""
    if log == EMULATED:
        return make_robot(EMULATED).record(seed=0, duration=RECORDED_TIME).dataset.split(HELD_BACK)
    root = Path(os.environ.get("SYSID_EVO_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
    states, controls, names = [], [], []
    for path in sorted((root / "dart" / log).glob("*.csv")):
        rows = np.genfromtxt(path, delimiter=",", names=True)
        fields = rows.dtype.names or ()
        safety = rows["safety"] if "safety" in fields else 1.0
        states.append(np.stack([rows["u"], rows["v"], rows["r"]], axis=1))
        controls.append(np.stack([np.maximum(rows["throttle"], 0.0) * safety, rows["steering"]], axis=1))
        names.append(path.stem)
    return Dataset.from_arrays(CAR, states, controls, names=names).split([TEST_EPISODE[log]])


def pooled(rows: list[ModelPrediction], horizon: int | None) -> Draws:
    """Return the mean N over seeds with its draws; N is RMSE / standard deviation, the mean over states."""
    return Draws.joined([score.draws for row in rows if (score := row.score(horizon)) is not None])
