"""Fits the zoo on two real cars and prints each family's prediction error beside the strongest peer's.

    python -m tests.benchmarks.prediction [FAMILY ...] [--preset standard] [--seeds 3] [--logs slippery_20hz free_20hz]

``--logs emulated_car`` records six minutes of the emulated car's excitation instead and holds back the
last quarter of every episode. N is the mean over channels of RMSE / standard deviation, after 1, 10,
20 and 60 steps and over the whole file, under `evaluation.prediction.PredictionProtocol`;
persistence is the first row, and a family that it beats after one second is marked. The peer is
trained here. Differences come from a paired block bootstrap of the errors pooled over the seeds: an
interval without zero is marked; with several families, who beats whom is listed at the end.
Coverage is that of 90 % intervals after one second, over all
channels and of each.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

import numpy as np

from evaluation.comparison.model_cells import with_preset
from evaluation.prediction import (
    Interval,
    MeasuredCases,
    ModelPrediction,
    Persistence,
    PredictionProtocol,
    assess_model,
    measured_cases,
)
from evaluation.prediction.bootstrap import interval
from hardware.recording.scripted import record_dataset
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.motion import PlanarBody
from sysid_evo.registry import Spec, make_model, make_robot, models
from sysid_evo.system import Channel, System
from tests.benchmarks.coverage import coverage
from tests.benchmarks.peers import LaggedOneStepEnsemble
from tests.benchmarks.standing import Scores, standing

TEST_EPISODE = {"slippery_20hz": "2025-04-16-17-36-01", "free_20hz": "car_1_Datarecording_09_16_2024_10_12_05"}
EMULATED, RECORDED_TIME, HELD_BACK = "emulated_car", 360.0, 0.25
PEER, PERSISTENCE = "peer: 4 one-step networks", "persistence"
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
        return record_dataset(make_robot(EMULATED), seed=0, duration=RECORDED_TIME).dataset.split(HELD_BACK)
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


def new_model(name: str, preset: str) -> DynamicsModel:
    """Return a family with its preset, the peer, or persistence."""
    if name == PEER:
        return LaggedOneStepEnsemble()
    if name == PERSISTENCE:
        return Persistence()
    spec = with_preset(Spec(name), preset)
    if "stochastic" in make_model(spec).get_params():
        spec = spec.with_parameters(stochastic=True)  # so that its intervals are calibrated; errors are without noise
    return make_model(spec)


def interval_coverage(model: DynamicsModel, cases: MeasuredCases) -> Array | None:
    """Return the share (nx,) of true states inside 90 % intervals after one second, None without a spread."""
    if "stochastic" not in model.get_params():
        return None
    windows = cases.windows
    model.set_params(stochastic=True)
    drawn = model.simulate(
        windows.past_states,
        windows.past_controls,
        windows.controls[:, :SECOND],
        samples=100,
        rng=np.random.default_rng(0),
    )
    model.set_params(stochastic=False)
    rows = cases.moving[:, SECOND - 1]
    return coverage(drawn[:, rows, -1], windows.states[rows, SECOND - 1])


def pooled(rows: list[ModelPrediction], horizon: int | None) -> tuple[float, np.ndarray]:
    """Return the mean N over seeds and its resamples (R,)."""
    scores = [score for row in rows if (score := row.score(horizon)) is not None]
    return float(np.mean([s.n for s in scores])), np.mean([s.resampled_n for s in scores], axis=0)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("families", nargs="*", help="default: every registered family")
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--logs", nargs="+", default=list(TEST_EPISODE), choices=[*TEST_EPISODE, EMULATED])
    arguments = parser.parse_args()
    write = sys.stdout.write
    by_log: dict[str, Scores] = {}
    for log in arguments.logs:
        training, test = recording(log)
        cases = measured_cases(training, test, PredictionProtocol(history=5))
        horizons: list[int | None] = [*cases.horizons, None]
        write(f"\n{log}: N after {', '.join(map(str, cases.horizons))} steps and over the whole file, ")
        write(f"mean of {arguments.seeds} seeds, preset {arguments.preset}\n")
        table: dict[str, list[ModelPrediction]] = {}
        for name in [PERSISTENCE, PEER, *(arguments.families or models.names())]:
            rows, seconds, covered = [], [], []
            for seed in range(1 if name == PERSISTENCE else arguments.seeds):
                model = new_model(name, arguments.preset)
                began = time.perf_counter()
                model.fit(training, rng=np.random.default_rng(seed))
                seconds.append(time.perf_counter() - began)
                if "stochastic" in model.get_params():
                    model.set_params(stochastic=False)
                rows.append(assess_model(f"{name}-{seed}", model, cases, family=name))
                covered.append(interval_coverage(model, cases))
            table[name] = rows
            figures = "  ".join(f"{pooled(rows, horizon)[0]:.3f}" for horizon in horizons)
            touched = max(row.divergence.share for row in rows if row.divergence is not None)
            known = [value for value in covered if value is not None]
            extra = ""
            if known:
                by_channel = ", ".join(f"{100 * share:.0f}" for share in np.mean(known, axis=0))
                extra = f"  90 % intervals hold {100 * float(np.mean(known)):.0f} % ({by_channel})"
            if pooled(rows, SECOND)[0] > pooled(table[PERSISTENCE], SECOND)[0]:
                extra += "  worse than persistence"
            write(f"  {name:26s} {figures}  fit {np.mean(seconds):6.1f} s  diverged {100 * touched:.1f} %{extra}\n")
            sys.stdout.flush()
        own_families = [name for name in table if name not in (PEER, PERSISTENCE)]
        best = min(own_families, key=lambda name: pooled(table[name], SECOND)[0])
        write(f"  {best} against the {PEER}:\n")
        for horizon in horizons:
            own, own_draws = pooled(table[best], horizon)
            other, other_draws = pooled(table[PEER], horizon)
            between: Interval = interval(own_draws - other_draws, 0.95)
            mark = "" if between.spans(0.0) else " *"
            label = "file" if horizon is None else f"{horizon:4d}"
            write(f"    {label}: {100 * (own / other - 1):+.1f} %  {own - other:+.3f} ")
            write(f"[{between.low:+.3f}, {between.high:+.3f}]{mark}\n")
        by_log[log] = {name: pooled(table[name], SECOND) for name in own_families}
    if len(own_families) > 1:
        standing(by_log, write)


if __name__ == "__main__":
    main()
