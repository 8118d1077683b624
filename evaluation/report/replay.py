"""The replay: one trial of every controller on every system, for the reader to watch side by side."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from evaluation.plots import plotted_places
from evaluation.transfer import Trace, TransferMatrix
from sysid_evo.angles import wrap
from sysid_evo.arrays import Array
from sysid_evo.evolution import Champion
from sysid_evo.system import Channel, System

MOST_NUMBERS = 1_200_000
"""Numbers of trials that a page holds, about 3 MB: beyond it, trials on models that were not evolved against go."""
NO_NUMBER = 65535
APART = 0.1
"""Two trials part where they are this share of the robot's trial apart: of its extent, of the range of a state."""


ON_A_PLANE = (
    "Blue: forwards, orange: backwards; positions from above. The outline is the robot at the same time, the cross "
    "where the model has left its path by a tenth of its extent."
)
OVER_TIME = (
    "Blue: the state, grey: what it was to be, with the tolerance; dotted: on the robot. The vertical line: where the "
    "model has left the robot by a tenth of the range of a state."
)
CONTROLS = " Bars: the controls, from neutral. All begin alike, in the first trial if no other is named."


@dataclass(frozen=True)
class Replay:
    """What the page's script plays: ``document`` is JSON for a script element, ``rows`` the names of the controllers.

    ``paths`` tells whether bodies on a plane are shown, or states over time; ``left_out`` trials would make the page
    too large.
    """

    rows: tuple[str, ...]
    document: str
    paths: bool
    left_out: int = 0

    @property
    def caption(self) -> str:
        fewer = f" {self.left_out} trials on other models are left out to keep the page small." if self.left_out else ""
        return (ON_A_PLANE if self.paths else OVER_TIME) + CONTROLS + fewer


def replay(
    matrix: TransferMatrix, *, first: str | None = None, watched: Mapping[str, int] | None = None
) -> Replay | None:
    """Return the first trial of every cell that kept one; None if there is none.

    The controller ``first`` is the one shown at the start (default: the first row). Of the controllers that are
    ``watched`` another trial is shown too, by its number from 0, where it was kept.
    """
    system = next((champion.system for champion in matrix.champions if champion.system is not None), None)
    kept = [trace for cell in matrix.cells.values() for trace in cell.traces[:1]]
    if system is None or not kept:
        return None
    paths = all(is_planar(trace) and not trace.targets for trace in kept)
    rows: dict[str, None] = {}
    runs: list[dict[str, Any]] = []
    numbers = left_out = 0
    for champion, trial in _trials(matrix, watched or {}):
        row = trial_name(champion.name, trial)
        traces = {column: _kept(matrix, champion.name, column, trial) for column in _ordered(matrix, champion)}
        robot = traces.get(matrix.robot or "")
        for column, trace in traces.items():
            if trace is None:
                continue
            own, on_robot = column in champion.against, column == matrix.robot
            if numbers > MOST_NUMBERS and not (own or on_robot):
                left_out += 1
                continue
            numbers += _numbers(trace, paths=paths)
            other = None if on_robot else robot
            apart = None if other is None else parting(trace, other, system, paths=paths)
            told = {"row": row, "column": column, "own": own, "robot": on_robot}
            runs.append({**told, "compared": other is not None, "apart": apart, **_trial(trace, paths=paths)})
            rows[row] = None
    document = {
        "unit": matrix.unit,
        "first": first if first in rows else next(iter(rows)),
        "paths": paths,
        "states": [channel.to_dict() for channel in system.states],
        "controls": [channel.to_dict() for channel in system.controls],
        "shown": list(plotted_places(kept[0], system)),
        "runs": runs,
    }
    text = json.dumps(document, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    return Replay(tuple(rows), text.replace("<", "\\u003c"), paths, left_out)


def trial_name(controller: str, trial: int) -> str:
    """Return the row of the replay that shows this trial of a controller, counted from 0."""
    return controller if trial == 0 else f"{controller}, trial {trial + 1}"


def _trials(matrix: TransferMatrix, watched: Mapping[str, int]) -> Iterator[tuple[Champion, int]]:
    """Yield each controller with its first trial, and where one more is watched with that."""
    for champion in matrix.champions:
        yield champion, 0
        if watched.get(champion.name):
            yield champion, watched[champion.name]


def _ordered(matrix: TransferMatrix, champion: Champion) -> tuple[str, ...]:
    """Return the columns, the robot first, then those that a controller was evolved on."""
    robots = [column for column in matrix.columns if column == matrix.robot]
    return tuple(dict.fromkeys((*robots, *(c for c in matrix.columns if c in champion.against), *matrix.columns)))


def _kept(matrix: TransferMatrix, row: str, column: str, trial: int) -> Trace | None:
    traces = matrix.cell(row, column).traces
    return traces[trial] if trial < len(traces) else None


def is_planar(trace: Trace) -> bool:
    """Tell whether the trial has the pose of a body on a plane."""
    pose = trace.trajectory.pose
    return pose is not None and pose.shape[1] == 3


def parting(trace: Trace, robot: Trace, system: System, *, paths: bool) -> float | None:
    """Return the seconds after which a trial is apart from the one on the robot for the first time; None if never.

    Of bodies on a plane the positions are compared, of other systems the states that are drawn. Apart is a tenth of
    the extent of the robot's path, or of the range of a state (its target counts) in the robot's trial.
    """
    steps = min(len(trace.trajectory.states), len(robot.trajectory.states))
    if paths:
        assert trace.trajectory.pose is not None
        assert robot.trajectory.pose is not None
        here, there = trace.trajectory.pose[:steps, :2], robot.trajectory.pose[:steps, :2]
        extent = np.array([np.ptp(there, axis=0).max()])
        distance = np.hypot(*(here - there).T)[:, None]
    else:
        places = list(plotted_places(robot, system))
        here, there = trace.trajectory.states[:steps, places], robot.trajectory.states[:steps, places]
        channels = [system.states[place] for place in places]
        distance = np.abs(_shortest(here - there, channels))
        extent = np.array([_range(robot, place, there[:, i], system) for i, place in enumerate(places)])
    apart = (distance > APART * np.where(extent > 0.0, extent, np.inf)).any(axis=1)
    return float(np.argmax(apart) * trace.trajectory.dt) if apart.any() else None


def _range(trace: Trace, place: int, values: Array, system: System) -> float:
    """Return how far a state goes in a trial, its target included; a periodic one at most one period."""
    wanted = [target.values for target in trace.targets if target.place == place]
    spread = float(np.ptp(np.concatenate([values, *wanted])))
    period = system.states[place].period
    return spread if period is None else min(spread, period)


def _shortest(difference: Array, channels: list[Channel]) -> Array:
    """Return differences of states (n, k), periodic ones the shorter way round."""
    columns = [
        difference[:, i] if channel.period is None else wrap(difference[:, i], channel.period)
        for i, channel in enumerate(channels)
    ]
    return np.stack(columns, axis=1)


def _trial(trace: Trace, *, paths: bool) -> dict[str, Any]:
    trajectory = trace.trajectory
    return {
        "dt": trajectory.dt,
        "fitness": round(trace.fitness, 4) if np.isfinite(trace.fitness) else None,
        "states": None if paths else _packed(trajectory.states),
        "controls": _packed(trajectory.controls),
        "pose": _packed(trajectory.pose) if paths and trajectory.pose is not None else None,
        "markers": trace.waypoints.round(3).tolist(),
        "radius": trace.waypoint_radius,
        "walls": [wall.round(3).tolist() for wall in trace.walls],
        "targets": [
            {"place": target.place, "tolerance": target.tolerance, "values": _packed(target.values)}
            for target in trace.targets
        ],
    }


def _numbers(trace: Trace, *, paths: bool) -> int:
    trajectory = trace.trajectory
    shown = trajectory.pose if paths and trajectory.pose is not None else trajectory.states
    return int(shown.size + trajectory.controls.size)


def _packed(values: Array) -> dict[str, Any]:
    """Return numbers (n, k) as k columns of n steps from the lowest, 16 bit each in base 64, little-endian.

    A number is that many times ``step`` above ``low``, to a 65534th of the range of its column; the highest number
    stands for what is no number.
    """
    table = np.asarray(values, dtype=np.float64)
    table = table[:, None] if table.ndim == 1 else table
    known = np.where(np.isfinite(table), table, np.nan)
    low = [float(np.nanmin(column)) if np.isfinite(column).any() else 0.0 for column in known.T]
    high = [float(np.nanmax(column)) if np.isfinite(column).any() else 0.0 for column in known.T]
    step = [(top - bottom) / (NO_NUMBER - 1) for top, bottom in zip(high, low, strict=True)]
    scaled = (known - low) / np.where(np.array(step) > 0.0, step, 1.0)
    steps = np.where(np.isfinite(scaled), np.round(scaled), NO_NUMBER).astype("<u2")
    data = base64.b64encode(np.ascontiguousarray(steps).tobytes()).decode("ascii")
    return {"low": low, "step": step, "data": data}
