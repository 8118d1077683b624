"""Replay of one trial of each controller on every system; its path in its own model and on the robot."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.plots import plot_state, plot_trace, plotted_states
from evaluation.report.elements import (
    QUARTER,
    THIRD,
    Drawing,
    DrawingPair,
    FigureElement,
    ReplayElement,
    Section,
    present,
)
from evaluation.results import ComparisonResults
from evaluation.transfer.matrix import Trace, TransferMatrix
from sysid_evo.angles import wrap
from sysid_evo.evolution import Champion
from sysid_evo.motion import PlanarBody
from sysid_evo.rigid_body import RigidBody
from sysid_evo.system import System
from sysid_evo.types import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def section(report: ComparisonResults) -> Section | None:
    """Return replay and traces; None without controllers."""
    matrix, summary = report.matrix, report.transfer
    if matrix is None or summary is None:
        return None
    shown = replay(matrix, first=summary.pick)
    items = [] if shown is None else present(shown, traces_picture(matrix))
    return Section("Replay", items, absent=_absent(report, shown))


def _absent(report: ComparisonResults, shown: ReplayElement | None) -> list[str]:
    """Return what cannot be replayed, and why."""
    if shown is None:
        return ["No trial was kept, so nothing can be replayed (--traces)."]
    found = []
    if report.matrix is not None and report.matrix.robot is None:
        found.append("Without a robot the moment at which a model diverges from it is not known.")
    if not shown.paths:
        found.append("Nothing moves on a plane here, so states are shown over time instead of paths.")
    return found


ON_A_PLANE = (
    "Blue: forwards, orange: backwards; seen from above. The outline is the robot at the same time; the cross marks "
    "where a model has left the path of the robot by a tenth of its extent."
)
OVER_TIME = (
    "Blue: the state, grey: its target with the tolerance, dotted: on the robot. The vertical line marks where a model "
    "has left the robot by a tenth of the range of a state."
)
IN_SPACE = " Above: seen from above, below: from the side, with up at the top."
CONTROLS = (
    " Bars: the controls, from neutral. All systems start from the same state. Keys: space plays and pauses, comma and "
    "full stop go one step back and forward."
)

MOST_NUMBERS = 1_200_000
"""Numbers in the trials of a page, about 3 MB; beyond it trials on models not evolved in are left out."""


def replay(matrix: TransferMatrix, *, first: str | None = None) -> ReplayElement | None:
    """Return the first kept trial of every cell; None if no cell has one.

    The controller ``first`` is shown at the start (default: the first row).
    """
    system = next((champion.system for champion in matrix.champions if champion.system is not None), None)
    kept = [trace for cell in matrix.cells.values() for trace in cell.traces[:1]]
    if system is None or not kept:
        return None
    paths = all(has_path(trace) and not trace.targets for trace in kept)
    rows: dict[str, None] = {}
    runs: list[dict[str, Any]] = []
    numbers = left_out = 0
    for champion in matrix.champions:
        row = champion.name
        cells = {column: matrix.cell(row, column).traces for column in _ordered(matrix, champion)}
        traces = {column: kept[0] for column, kept in cells.items() if kept}
        robot = traces.get(matrix.robot or "")
        for column, trace in traces.items():
            own, on_robot = column in champion.against, column == matrix.robot
            if numbers > MOST_NUMBERS and not (own or on_robot):
                left_out += 1
                continue
            numbers += _numbers(trace, paths=paths)
            other = None if on_robot else robot
            apart = None if other is None else divergence_time(trace, other, system, paths=paths)
            place = {"row": row, "column": column, "own": own, "robot": on_robot}
            runs.append({**place, "compared": other is not None, "apart": apart, **_trial(trace, system, paths=paths)})
            rows[row] = None
    document = {
        "unit": matrix.unit,
        "first": first if first in rows else next(iter(rows)),
        "paths": paths,
        "states": [channel.to_dict() for channel in system.states],
        "controls": [channel.to_dict() for channel in system.controls],
        "shown": list(plotted_states(kept[0], system)),
        "runs": runs,
    }
    text = json.dumps(document, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    fewer = f" {left_out} trials on other models are left out to keep the page small." if left_out else ""
    space = IN_SPACE if paths and isinstance(system.motion, RigidBody) else ""
    caption = (ON_A_PLANE if paths else OVER_TIME) + space + CONTROLS + fewer
    return ReplayElement(tuple(rows), text.replace("<", "\\u003c"), paths, caption)


def _ordered(matrix: TransferMatrix, champion: Champion) -> tuple[str, ...]:
    """Return the columns, the robot first, then the models that a controller was evolved in."""
    robots = [column for column in matrix.columns if column == matrix.robot]
    return tuple(dict.fromkeys((*robots, *(c for c in matrix.columns if c in champion.against), *matrix.columns)))


def has_path(trace: Trace) -> bool:
    """Whether the trial has the pose of a body on a plane or in space."""
    pose = trace.trajectory.pose
    return pose is not None and pose.shape[1] in (3, RigidBody.n_pose)


FROM_THE_SIDE = " from the side"


def views(trace: Trace, system: System | None) -> dict[str, Trace]:
    """Return a trial as trials on planes, by the words to add to their names; a body in space is seen from two sides.

    Their poses are x, y and heading, to the right, up, and counter-clockwise in the drawing: east and north from above,
    east and up from the side.
    """
    pose = trace.trajectory.pose
    if pose is None or system is None or not isinstance(system.motion, RigidBody):
        return {"": trace}
    w, x, y, z = pose[:, 3:].T
    ahead = np.stack([1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)], axis=1)
    place, ahead, markers, *walls = (
        _from_above_and_north(values, system.motion) for values in (pose[:, :3], ahead, trace.waypoints, *trace.walls)
    )

    def seen(columns: list[int]) -> Trace:
        heading = np.arctan2(ahead[:, columns[1]], ahead[:, columns[0]])
        run = replace(trace.trajectory, pose=np.column_stack([place[:, columns], heading]))
        return replace(
            trace, trajectory=run, waypoints=markers[:, columns], walls=tuple(wall[:, columns] for wall in walls)
        )

    return {" from above": seen([0, 1]), FROM_THE_SIDE: seen([0, 2])}


def _from_above_and_north(values: Array, motion: RigidBody) -> Array:
    """Return vectors (n, 3) of the world as east, north and up; (n, 2) of an empty list as none."""
    if values.shape[1] != 3:
        return np.empty((0, 3))
    return values if motion.frame == "ENU" else values[:, [1, 0, 2]] * [1.0, 1.0, -1.0]


APART = 0.1
"""Two trials diverge at a distance of this share of the robot's trial: of its extent, of the range of a state."""


def divergence_time(trace: Trace, robot: Trace, system: System, *, paths: bool) -> float | None:
    """Return the seconds after which a trial is apart from the one on the robot for the first time; None if never.

    Of bodies with a pose the positions are compared, of other systems the states that are drawn. Apart is a tenth of
    the extent of the robot's path, or of the range of a state (its target counts) in the robot's trial.
    """
    steps = min(len(trace.trajectory.states), len(robot.trajectory.states))
    if paths:
        assert trace.trajectory.pose is not None
        assert robot.trajectory.pose is not None
        axes = 2 if robot.trajectory.pose.shape[1] == PlanarBody.n_pose else 3
        here, there = trace.trajectory.pose[:steps, :axes], robot.trajectory.pose[:steps, :axes]
        extent = np.array([np.ptp(there, axis=0).max()])
        distance = np.linalg.norm(here - there, axis=1)[:, None]
    else:
        places = list(plotted_states(robot, system))
        here, there = trace.trajectory.states[:steps, places], robot.trajectory.states[:steps, places]
        columns = zip((here - there).T, (system.states[place].period for place in places), strict=True)
        shorter = [column if period is None else wrap(column, period) for column, period in columns]
        distance = np.abs(np.stack(shorter, axis=1))
        extent = np.array([_range(robot, place, there[:, i], system) for i, place in enumerate(places)])
    apart = (distance > APART * np.where(extent > 0.0, extent, np.inf)).any(axis=1)
    return float(np.argmax(apart) * trace.trajectory.dt) if apart.any() else None


def _range(trace: Trace, place: int, values: Array, system: System) -> float:
    """Return the range of a state in a trial, its target included; at most the period of a periodic one."""
    wanted = [target.values for target in trace.targets if target.place == place]
    spread = float(np.ptp(np.concatenate([values, *wanted])))
    period = system.states[place].period
    return spread if period is None else min(spread, period)


def _trial(trace: Trace, system: System, *, paths: bool) -> dict[str, Any]:
    trajectory = trace.trajectory
    drawn = list(views(trace, system).values()) if paths else [trace]
    poses = [packed(view.trajectory.pose) for view in drawn if paths and view.trajectory.pose is not None]
    return {
        "dt": trajectory.dt,
        "fitness": round(trace.fitness, 4) if np.isfinite(trace.fitness) else None,
        "states": None if paths else packed(trajectory.states),
        "controls": packed(trajectory.controls),
        "pose": poses[0] if poses else None,
        "markers": _places([view.waypoints for view in drawn]),
        "radius": trace.waypoint_radius,
        "walls": [_places(list(wall)) for wall in zip(*(view.walls for view in drawn), strict=True)],
        **({"side": poses[1]} if len(poses) > 1 else {}),
        "targets": [
            {"place": target.place, "tolerance": target.tolerance, "values": packed(target.values)}
            for target in trace.targets
        ],
    }


def _places(drawn: Sequence[Array]) -> list[list[float]]:
    """Return the places (k, 2) of each view together: x and y from above, then z from the side."""
    found: list[list[float]] = np.column_stack([drawn[0], *(side[:, 1] for side in drawn[1:])]).round(3).tolist()
    return found


def _numbers(trace: Trace, *, paths: bool) -> int:
    trajectory = trace.trajectory
    shown = trajectory.pose if paths and trajectory.pose is not None else trajectory.states
    return int(shown.size + trajectory.controls.size)


NO_NUMBER = 65535
"""The highest number of 16 bits, which means nan."""


def packed(values: Array) -> dict[str, Any]:
    """Return numbers (n, k) as k columns of n steps from the lowest, 16 bit each in base 64, little-endian.

    A number is that many times ``step`` above ``low``, to a 65534th of the range of its column; see `NO_NUMBER`.
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


SHOWN_TRACES = 24
"""Drawings of traces on a page, two for each controller."""

SQUARE = (0.19, 0.17, 0.79, 0.79)
"""Left, bottom, width and height of the axes of a trace, as shares of its drawing."""


def traces_picture(matrix: TransferMatrix) -> FigureElement | None:
    """Return path or states of each controller in its own model and on the robot, in the first trial."""
    found = [(champion, column, trace) for champion in matrix.champions for column, trace in _traces(champion, matrix)]
    if not found:
        return None
    paths = all(has_path(trace) and not trace.targets for _, _, trace in found)
    panels: list[DrawingPair] = []
    for champion, column, trace in found[:SHOWN_TRACES]:
        label = f"{champion.name} on {column}"
        for words, view in views(trace, champion.system).items() if paths else [("", trace)]:
            number, title = len(panels), label + words
            drawing = _path(number, title, view) if paths else _over_time(number, title, view, champion)
            panels.append(DrawingPair(drawing, title=title, note=f"{trace.fitness:.4g} {matrix.unit}".strip()))
    left_out = " The first controllers only." if len(found) > SHOWN_TRACES else ""
    drawn = "Blue: the states, grey: their targets with the tolerance"
    if paths:
        walls = ", between the walls (grey)" if any(t.walls for _, _, t in found) else ""
        passed = ", through the waypoints in order (green: passed)" if any(len(t.waypoints) for *_, t in found) else ""
        drawn = f"Blue: forwards, orange: backwards; from the dot{walls}{passed}. Positions in metres"
    return FigureElement(
        "Traces: the first trial of each controller",
        f"{drawn}; the first trial, the same for all.{left_out}",
        tuple(panels),
        columns=4 if paths else 3,
        details=True,
    )


def _traces(champion: Champion, matrix: TransferMatrix) -> Sequence[tuple[str, Trace]]:
    """Return the first trace of a champion in a model that it was evolved in, and on the robot."""

    def first(column: str) -> Trace | None:
        traces = matrix.cell(champion.name, column).traces
        shown = bool(traces) and (has_path(traces[0]) or champion.system is not None)
        return traces[0] if shown else None

    own = next((column for column in champion.against if column in matrix.models and first(column) is not None), None)
    columns = [column for column in (own, matrix.robot) if column is not None]
    return [(column, trace) for column in columns if (trace := first(column)) is not None]


def _path(number: int, label: str, trace: Trace) -> Drawing:
    def draw(figure: Figure) -> None:
        figure.set_layout_engine("none")
        ax = plot_trace(trace, figure.add_axes(SQUARE))
        if label.endswith(FROM_THE_SIDE):
            ax.set_ylabel("height (m)")

    return Drawing(f"trace-{number}", f"path of {label}", draw, QUARTER, QUARTER)


def _over_time(number: int, label: str, trace: Trace, champion: Champion) -> Drawing:
    system = champion.system
    assert system is not None
    places = plotted_states(trace, system)

    def draw(figure: Figure) -> None:
        for place, ax in zip(places, figure.subplots(len(places), 1, sharex=True, squeeze=False)[:, 0], strict=True):
            plot_state(trace, system, place, ax)
            ax.label_outer()

    height = 0.5 + 1.3 * len(places)
    return Drawing(f"trace-{number}", f"states of {label} over time", draw, THIRD, height)
