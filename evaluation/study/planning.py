"""From a study to one plan of the cells of all its points, each once."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from evaluation.cells.data import GivenData
from evaluation.planning import Comparison, plan_comparison
from evaluation.study.study import Point, Study, name_of
from sysid_evo.data import Dataset
from sysid_evo.errors import ArtefactError, InvalidArgument, SysidEvoError
from sysid_evo.plan import Again, Cell, Plan, Record, Store, stored
from sysid_evo.registry import load_named_plugins, load_plugin, load_plugins_again, make_robot, robot_spec

AGAIN = "evaluation.study.planning:plan_again"
"""What makes the plan of a study again in another process."""


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
        """The name of what all points that need a cell have in common, by its digest."""
        shared: dict[str, dict[str, str]] = {}
        for point, comparison in self.points:
            for cell in comparison.plan:
                known = shared.get(cell.digest)
                labels = dict(point.labels)
                same = labels if known is None else {a: label for a, label in known.items() if labels[a] == label}
                shared[cell.digest] = same
        return {digest: name_of(labels) for digest, labels in shared.items()}

    def where(self, cell: Cell) -> str:
        """Return what stands before the title of ``cell``, so that it can be told apart: where it belongs."""
        place = self.places.get(cell.digest, "")
        return f"{place}: " if place else ""


def plan_study(study: Study, *, digests: Sequence[str | None] = (), store: Store | None = None) -> PlannedStudy:
    """Return the plan of ``study``; nothing is computed. Raises what is wrong with a point, with its name.

    Plugins that its file names must be trusted. Recordings that experiments name are read, each once. With the
    ``digests`` of the cells of their data, one for each point or None, they are taken from ``store`` instead.
    """
    plugins = study.experiment.get("plugins", ())
    if study.file is not None:
        study = study.with_plugins(load_named_plugins(plugins, study.file))
    else:
        for plugin in plugins:
            load_plugin(plugin)
    return _planned(study, digests, store)


def _planned(study: Study, digests: Sequence[str | None], store: Store | None) -> PlannedStudy:
    known: dict[tuple[Any, ...], Dataset] = {}
    comparisons = []
    for point, digest in itertools.zip_longest(study.points, digests):
        try:
            held = _held(store, digest)
            data, robot, dataset = point.experiment.data, point.experiment.robot, None
            if held is None and data is not None:
                key = (data, point.experiment.columns)
                if key not in known:
                    known[key] = Dataset.read(data, columns=point.experiment.columns)
                dataset = known[key]
            if robot is not None and data is None and make_robot(robot_spec(robot)).physical:
                raise InvalidArgument(
                    f"{robot} is a physical robot, which a study does not drive: record it once with "
                    "sysid-evo record, and name the recordings as data"
                )
            comparisons.append(plan_comparison(point.experiment, dataset=dataset, held=held))
        except SysidEvoError as error:
            raise InvalidArgument(f"point {point.name}: {error}") from error
    return PlannedStudy(study, tuple(comparisons), _united(study, comparisons))


def plan_again(settings: Mapping[str, Any], folder: Path) -> Plan:
    """Return the plan of the study with these settings; its recordings stand in the store ``folder``."""
    study = Study.of(settings["study"])
    load_plugins_again(study.experiment.get("plugins", ()))
    return _planned(study, settings["data"], Store(folder)).plan


def _united(study: Study, comparisons: list[Comparison]) -> Plan:
    """Return all cells, each once; cells of several points are found by their digests."""
    given = [one.data.digest if isinstance(one.data.settings, GivenData) else None for one in comparisons]
    again = Again(
        AGAIN,
        {"study": dict(study.settings), "data": given if any(given) else []},
        after=tuple(dict.fromkeys(digest for digest in given if digest is not None)),
        files={text: files for one in comparisons if one.plan.again for text, files in one.plan.again.files.items()},
    )
    remarks = dict.fromkeys(remark for comparison in comparisons for remark in comparison.plan.remarks)
    return Plan.of((cell for comparison in comparisons for cell in comparison.plan), remarks=remarks, again=again)


def _held(store: Store | None, digest: str | None) -> tuple[Cell, Any] | None:
    """Return the cell of data that stand in the store, and their system."""
    if store is None or digest is None:
        return None
    record = store.find(digest)
    data = None if record is None else stored(record)
    if data is None or not store.done(data):
        raise ArtefactError(f"{store.path}: its data are missing or damaged")
    return data, store.load(data).training.system


def seconds_about(planned: PlannedStudy, records: Mapping[str, Record | None]) -> dict[str, float]:
    """Return about how long each cell takes, by digest: what it foresees, corrected by what its kind took here."""
    took: dict[str, float] = {}
    foreseen: dict[str, float] = {}
    for cell in planned.plan:
        record = records[cell.digest]
        if record is not None and record.status == "done":
            took[cell.kind] = took.get(cell.kind, 0.0) + record.seconds
            foreseen[cell.kind] = foreseen.get(cell.kind, 0.0) + cell.seconds
    ratio = {kind: took[kind] / expected for kind, expected in foreseen.items() if expected > 0.0}
    return {cell.digest: cell.seconds * ratio.get(cell.kind, 1.0) for cell in planned.plan}
