"""One cell of the transfer matrix: one controller on one system, over fresh trials."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sysid_evo.arrays import Array, Seeds
from sysid_evo.data import Trajectory
from sysid_evo.engine import Rollouts, Runner
from sysid_evo.evolution import Champion
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_controller, make_task
from sysid_evo.system import Channel
from sysid_evo.tasks import Target, Task

TRANSFER = 2**31 + 1
"""The generation number of the transfer trials: no evolution and no selection of a champion meets them."""


NOT_RUN = "not run"
"""The reason of a cell that nobody tried: a gap in the matrix, not a failure."""


@dataclass(frozen=True)
class Trace:
    """One recorded trial. ``waypoints`` (k, 2) in m are the markers of the task's `Scene`.

    ``waypoint_radius`` is in m; a task without markers has none. ``walls`` and ``targets`` are those of the scene.
    """

    trajectory: Trajectory
    fitness: float
    waypoints: Array = field(default_factory=lambda: np.empty((0, 2)))
    waypoint_radius: float = 0.0
    walls: tuple[Array, ...] = ()
    targets: tuple[Target, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the trace as strict JSON."""
        t = self.trajectory
        return {
            "name": t.name,
            "dt": t.dt,
            "states": t.states.tolist(),
            "controls": t.controls.tolist(),
            "pose": None if t.pose is None else t.pose.tolist(),
            "fitness": self.fitness,
            "waypoints": self.waypoints.tolist(),
            "waypoint_radius": self.waypoint_radius,
            "walls": [wall.tolist() for wall in self.walls],
            "targets": [
                {
                    "channel": target.channel.to_dict(),
                    "place": target.place,
                    "values": target.values.tolist(),
                    "tolerance": target.tolerance,
                }
                for target in self.targets
            ],
        }

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> Trace:
        """Undo `to_dict`."""
        pose = None if value["pose"] is None else np.asarray(value["pose"], dtype=np.float64)
        states, controls = (np.asarray(value[key], dtype=np.float64) for key in ("states", "controls"))
        waypoints = np.asarray(value["waypoints"], dtype=np.float64).reshape(-1, 2)
        trajectory = Trajectory(states, controls, value["dt"], pose, value["name"])
        walls = tuple(np.asarray(wall, dtype=np.float64) for wall in value.get("walls", ()))
        targets = tuple(
            Target(
                Channel.from_dict(target["channel"]),
                target["place"],
                np.asarray(target["values"], dtype=np.float64),
                target["tolerance"],
            )
            for target in value.get("targets", ())
        )
        return cls(trajectory, value["fitness"], waypoints, value["waypoint_radius"], walls, targets)


@dataclass(frozen=True)
class Cell:
    """What ``champion`` did on ``column`` in E trials, or the ``reason`` why it did nothing.

    ``fitness`` (E,) in ``unit``; ``clipped_share`` of all steps had their state clipped to the
    model's envelope; ``diverged_share`` of the trials stopped being numbers. ``engine`` names the
    form of the rollout that ran. ``missing`` gives a reason for each trial that a robot did not finish.
    ``measures`` are the means of what else the task tells of its trials (`Task.measures`), None without a number.
    """

    champion: str
    column: str
    fitness: Array = field(default_factory=lambda: np.empty(0))
    clipped_share: float = 0.0
    diverged_share: float = 0.0
    unit: str = ""
    engine: str = ""
    traces: tuple[Trace, ...] = field(default=(), repr=False)
    reason: str = ""
    missing: tuple[str, ...] = ()
    measures: Mapping[str, float | None] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        return bool(self.reason)

    @property
    def trials(self) -> int:
        return len(self.fitness)

    @property
    def mean(self) -> float:
        """Mean fitness, nan for a failed cell."""
        return float(self.fitness.mean()) if len(self.fitness) else float("nan")

    @property
    def std(self) -> float:
        """Standard deviation of the fitness over trials (n - 1), nan below two trials."""
        return float(self.fitness.std(ddof=1)) if len(self.fitness) > 1 else float("nan")

    @property
    def standard_error(self) -> float:
        """Standard error of the mean, nan below two trials."""
        return self.std / np.sqrt(len(self.fitness)) if len(self.fitness) else float("nan")

    def to_dict(self) -> dict[str, Any]:
        """Return the cell as strict JSON, so that it need not be computed twice."""
        return {
            "champion": self.champion,
            "column": self.column,
            "fitness": self.fitness.tolist(),
            "clipped_share": self.clipped_share,
            "diverged_share": self.diverged_share,
            "unit": self.unit,
            "engine": self.engine,
            "traces": [trace.to_dict() for trace in self.traces],
            "reason": self.reason,
            "missing": list(self.missing),
            "measures": dict(self.measures),
        }

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> Cell:
        """Undo `to_dict`."""
        fields = dict(value)
        fields["fitness"] = np.asarray(fields["fitness"], dtype=np.float64)
        fields["traces"] = tuple(Trace.from_dict(trace) for trace in fields["traces"])
        fields["missing"] = tuple(fields.get("missing", ()))
        return cls(**fields)


def transfer_seeds(seed: int, trials: int) -> Seeds:
    """Return the seeds of fresh trials (trials,), common to all cells."""
    return trial_seeds(seed, trials, generation=TRANSFER)


def kept_traces(traces: int, *, own: bool) -> int:
    """Return how many of ``traces`` trials a cell keeps: all on the robot and on models evolved against (``own``).

    Elsewhere one is enough, to be shown beside those.
    """
    return traces if own else min(traces, 1)


def run_cell(champion: Champion, column: str, runner: Runner, seeds: Seeds, *, traces: int = 0) -> Cell:
    """Run ``champion``, see `run_on`; whatever is raised becomes the reason of a failed cell."""
    try:
        return run_on(champion, column, runner, seeds, traces=traces)
    except Exception as error:  # a plugin or a robot may fail in any way; the other cells must go on
        return Cell(champion.name, column, reason=f"{type(error).__name__}: {error}")


def run_on(champion: Champion, column: str, runner: Runner, seeds: Seeds, *, traces: int = 0) -> Cell:
    """Run ``champion`` on ``runner`` in a trial of every seed (E,); the first ``traces`` are kept."""
    controller, task = make_controller(champion.controller), make_task(champion.task)
    rollouts = runner.run(controller, champion.parameters[None], task, seeds, record=traces > 0)
    return cell_of(champion, column, rollouts, task, traces=traces)


def cell_of(champion: Champion, column: str, rollouts: Rollouts, task: Task, *, traces: int = 0) -> Cell:
    """Return the cell of trials that were run; one without a single finished trial is a failed cell."""
    if rollouts.fitness.size == 0:
        reason = "; ".join(("no trial was finished", *rollouts.missing[:1]))
        return Cell(champion.name, column, reason=reason, missing=rollouts.missing)
    fitness = rollouts.fitness[0]
    return Cell(
        champion=champion.name,
        column=column,
        fitness=fitness,
        clipped_share=float(rollouts.clipped.sum() / max(1, rollouts.survived.sum())),
        diverged_share=float((fitness < task.worst).mean()),
        unit=task.fitness_unit,
        engine=rollouts.engine,
        traces=_traces(rollouts, traces, task),
        missing=rollouts.missing,
        measures={} if champion.system is None else _measures(rollouts, task.bind(champion.system)),
    )


def _measures(rollouts: Rollouts, task: Task) -> dict[str, float | None]:
    """Return the mean of each of the task's measures over the trials that have one."""
    found: dict[str, float | None] = {}
    for name, values in task.measures(rollouts.task_state).items():
        known = values[np.isfinite(values)]
        found[name] = float(known.mean()) if len(known) else None
    return found


def _traces(rollouts: Rollouts, wanted: int, task: Task) -> tuple[Trace, ...]:
    """Return the first trials that were recorded; a trial without a step has no trajectory."""
    trials = np.flatnonzero(rollouts.survived[0] > 0)
    kept = []
    for trial, trajectory in list(zip(trials, rollouts.trajectories, strict=False))[:wanted]:
        scene = task.scene(rollouts.task_state, int(trial))
        fitness = float(rollouts.fitness[0, trial])
        kept.append(Trace(trajectory, fitness, scene.markers, scene.radius, scene.walls, scene.targets))
    return tuple(kept)
