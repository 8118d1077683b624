"""Makes one plan of the cells of all points of a study, each cell once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from evaluation.planning import Comparison, plan_comparison
from evaluation.study.study import Point, Study, name_of
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidArgument, SysidEvoError
from sysid_evo.plan import Cell, CellRecord, Plan
from sysid_evo.registry import load_named_plugins, load_plugin, make_robot, robot_spec


@dataclass(frozen=True)
class PlannedStudy:
    """A study, the comparison of each of its points, and the one plan of all their cells."""

    study: Study
    comparisons: tuple[Comparison, ...]
    plan: Plan

    @property
    def points(self) -> tuple[tuple[Point, Comparison], ...]:
        """Every point with its comparison."""
        return tuple(zip(self.study.points, self.comparisons, strict=True))

    @cached_property
    def places(self) -> Mapping[str, str]:
        """For each cell, by its digest, the labels shared by all points that need it, as a name."""
        shared: dict[str, dict[str, str]] = {}
        for point, comparison in self.points:
            for cell in comparison.plan:
                known = shared.get(cell.digest)
                labels = dict(point.labels)
                same = labels if known is None else {a: label for a, label in known.items() if labels[a] == label}
                shared[cell.digest] = same
        return {digest: name_of(labels) for digest, labels in shared.items()}

    def where(self, cell: Cell) -> str:
        """Return the prefix of the title of ``cell`` that names its points."""
        place = self.places.get(cell.digest, "")
        return f"{place}: " if place else ""


def plan_study(study: Study) -> PlannedStudy:
    """Return the plan of ``study``; nothing is computed. Errors in a point are raised with its name.

    Plugins named in its file must be trusted. Recordings that experiments name are read once each. Cells that several
    points share have the same digest and are computed once.
    """
    plugins = study.experiment.get("plugins", ())
    if study.file is not None:
        study = study.with_plugins(load_named_plugins(plugins, study.file))
    else:
        for plugin in plugins:
            load_plugin(plugin)
    known: dict[tuple[Any, ...], Dataset] = {}
    comparisons = []
    for point in study.points:
        try:
            data, robot, dataset = point.experiment.data, point.experiment.robot, None
            if data is not None:
                key = (data, point.experiment.columns)
                if key not in known:
                    known[key] = Dataset.read(data, columns=point.experiment.columns)
                dataset = known[key]
            elif robot is not None and make_robot(robot_spec(robot)).physical:
                raise InvalidArgument(
                    f"{robot} is a physical robot, which a study does not drive: record it once with "
                    "sysid-evo record, and name the recordings as data"
                )
            comparisons.append(plan_comparison(point.experiment, dataset=dataset))
        except SysidEvoError as error:
            raise InvalidArgument(f"point {point.name}: {error}") from error
    remarks = dict.fromkeys(remark for comparison in comparisons for remark in comparison.plan.remarks)
    plan = Plan.of((cell for comparison in comparisons for cell in comparison.plan), remarks=remarks)
    return PlannedStudy(study, tuple(comparisons), plan)


def seconds_about(planned: PlannedStudy, records: Mapping[str, CellRecord | None]) -> dict[str, float]:
    """Return the estimated time of each cell, by digest: its own estimate, corrected by finished cells of its kind."""
    took: dict[str, float] = {}
    foreseen: dict[str, float] = {}
    for cell in planned.plan:
        record = records[cell.digest]
        if record is not None and record.status == "done":
            took[cell.kind] = took.get(cell.kind, 0.0) + record.seconds
            foreseen[cell.kind] = foreseen.get(cell.kind, 0.0) + cell.expected_seconds
    ratio = {kind: took[kind] / expected for kind, expected in foreseen.items() if expected > 0.0}
    return {cell.digest: cell.expected_seconds * ratio.get(cell.kind, 1.0) for cell in planned.plan}
