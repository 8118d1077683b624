"""Settings of a study: study.toml, axes, points."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from evaluation.experiment import MEANINGLESS, Experiment, meaningful, no_setting, read_toml, write_toml
from sysid_evo.display import Displayed, listed
from sysid_evo.errors import InvalidArgument, did_you_mean, refuse_meaningless

STUDY_FILE = "study.toml"

PARTS = ("title", "experiment", "grid", "compare_with")
CONTROLLER = "controller"
"""Key in ``compare_with`` of the controller that others are compared with."""
REPEATED = ("robot", "data", "seed")
"""Axes over which means and intervals are computed; the others distinguish rows of a table."""
DEFAULT_LABEL = "usual"
"""Label of an axis in a grid that does not set it."""


@dataclass(frozen=True)
class Point:
    """One experiment of a study; ``labels`` has the label of its value for each axis."""

    labels: Mapping[str, str]
    experiment: Experiment

    @property
    def name(self) -> str:
        """Name in tables: the robot, the seed, then the other axes."""
        return name_of(self.labels)

    @property
    def where(self) -> str:
        """The robot or the recordings."""
        found = [self.labels[axis] for axis in ("robot", "data") if axis in self.labels]
        return ", ".join(found) or str(self.experiment.robot or "emulated_car")

    @property
    def group(self) -> tuple[str, ...]:
        """The labels of the axes that distinguish rows of a table."""
        return tuple(label for axis, label in self.labels.items() if axis not in REPEATED)


def group_name(axes: Sequence[str], group: Sequence[str]) -> str:
    """Return the labels of a group of rows with their axes, empty for the only group."""
    return ", ".join(f"{axis} {label}" for axis, label in zip(axes, group, strict=True))


def name_of(labels: Mapping[str, str]) -> str:
    """Return labels of axes as a text; robot and recordings need no name before them."""
    parts = [labels[axis] for axis in ("robot", "data") if axis in labels]
    parts += [f"seed {labels['seed']}"] if "seed" in labels else []
    parts += [f"{axis} {label}" for axis, label in labels.items() if axis not in REPEATED]
    return ", ".join(parts)


@dataclass(frozen=True, repr=False)
class Study(Displayed):
    """A grid of experiments: common settings, and the axes whose combinations are the points.

    ``experiment`` are settings of `Experiment` common to all points, ``grids`` the axes by setting; the points of
    several grids are combined. ``compare_with`` names the row that others are compared with: a controller, and the
    labels of the axes that vary; empty for the polished controller. ``file`` is the file it was read from.
    """

    title: str
    experiment: Mapping[str, Any]
    grids: tuple[Mapping[str, Axis], ...]
    compare_with: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)
    file: Path | None = field(default=None, compare=False, repr=False)

    def facts(self) -> Mapping[str, str]:
        return {"title": self.title, "points": str(len(self.points)), "axes": listed(self.axes)}

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> Study:
        """Return the study with these settings, all checked. Raises `InvalidArgument` that names the wrong one."""
        settings = _plain(settings)
        for name in settings:
            if name not in PARTS:
                hint = did_you_mean(name, PARTS) or f" A study has {', '.join(PARTS)}."
                raise InvalidArgument(f"{name} is no part of a study.{hint}")
        title = settings.get("title", "Study")
        if not isinstance(title, str):
            raise InvalidArgument(f"title: expected a text, got {title!r}")
        common = _table("experiment", settings.get("experiment", {}))
        for name in ("title", "data_digest"):
            if name in common:
                raise InvalidArgument(f"experiment.{name}: not here; the title of a study belongs above [experiment]")
        try:
            Experiment.of(common)
            # a setting may need another one that is an axis of the grid
            refuse_meaningless([rule for rule in MEANINGLESS if rule.when], common, common)
        except InvalidArgument as error:
            raise InvalidArgument(f"[experiment]: {error}") from error
        given = settings.get("grid", {})
        several = given if isinstance(given, (list, tuple)) else [given]
        grids = tuple({name: Axis.of(name, values) for name, values in _table("grid", one).items()} for one in several)
        for name in dict.fromkeys(name for grid in grids for name in grid):
            if name in common:
                raise InvalidArgument(f"{name} is both under [experiment] and in the grid; leave it out of one of them")
        study = cls(title, common, grids, _reference(settings.get("compare_with", {}), grids), dict(settings))
        if not study.points:
            raise InvalidArgument("grid: expected at least one axis, such as seed = [0, 1, 2], got none")
        return study

    @classmethod
    def read(cls, path: str | Path) -> Study:
        """Return the study in a TOML file, or in that of a study's folder. Raises `InvalidArgument`."""
        file = Path(path) / STUDY_FILE if Path(path).is_dir() else Path(path)
        settings = read_toml(file, "a study")
        try:
            return replace(cls.of({"title": file.stem, **settings}), file=file)
        except InvalidArgument as error:
            raise InvalidArgument(f"{file}: {error}") from error

    def with_plugins(self, plugins: Sequence[str]) -> Study:
        """Return the same study with these plugin files."""
        if list(plugins) == list(self.experiment.get("plugins", ())):
            return self
        experiment = {**self.experiment, "plugins": list(plugins)}
        return replace(Study.of({**self.settings, "experiment": experiment}), file=self.file)

    def write(self, path: str | Path) -> Path:
        """Write the study to a TOML file."""
        return write_toml(self.settings, Path(path))

    @property
    def axes(self) -> tuple[str, ...]:
        """The settings that differ from point to point, in the order in which they are first named."""
        return tuple(dict.fromkeys(name for grid in self.grids for name in grid))

    @property
    def group_axes(self) -> tuple[str, ...]:
        """The axes that distinguish rows of a table."""
        return tuple(name for name in self.axes if name not in REPEATED)

    @cached_property
    def points(self) -> tuple[Point, ...]:
        """Every combination of values, each once. Raises `InvalidArgument` for one that is no experiment."""
        found: dict[str, Point] = {}
        for point in self._points():
            found.setdefault(point.experiment.model_dump_json(), point)
        names = [point.name for point in found.values()]
        repeated = next((name for name in names if names.count(name) > 1), None)
        if repeated is not None:
            raise InvalidArgument(f"grid: two points are called {repeated!r}; give the values of one axis other names")
        return tuple(found.values())

    def _points(self) -> Iterator[Point]:
        for grid in self.grids:
            if not grid:
                continue
            for labels in itertools.product(*(axis.values for axis in grid.values())):
                named = dict(zip(grid, labels, strict=True))
                values = {name: axis.values[named[name]] for name, axis in grid.items()}
                ordered = {name: named.get(name, DEFAULT_LABEL) for name in self.axes}
                try:
                    yield Point(ordered, Experiment.of(meaningful(self.experiment, values)))
                except InvalidArgument as error:
                    raise InvalidArgument(f"point {name_of(ordered)}: {error}") from error


def _table(name: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise InvalidArgument(f"{name}: expected a table [{name}], got {value!r}")
    return dict(value)


def _reference(value: Any, grids: Sequence[Mapping[str, Axis]]) -> dict[str, str]:
    """Return the labels of the row that others are compared with. Raises `InvalidArgument`."""
    given = {name: str(label) for name, label in _table("compare_with", value).items()}
    for name, label in given.items():
        known = dict.fromkeys(one for grid in grids if name in grid for one in grid[name].values)
        if name in REPEATED or (name != CONTROLLER and not known):
            raise InvalidArgument(
                f"compare_with.{name}: expected controller, or an axis of the grid other than {', '.join(REPEATED)}"
            )
        if known and label not in known:
            raise InvalidArgument(f"compare_with.{name}: expected one of {', '.join(known)}, got {label!r}")
    return given


def _plain(value: Any) -> Any:
    """Return tuples as lists, as TOML and JSON have them."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value


RANGE = re.compile(r"(?P<before>[^.]*?)(?P<first>\d+)\.\.(?P<last>\d+)(?P<after>[^.]*)")
RANGED = ("seed", "robot")
"""Settings whose values may be ranges."""
LEFT_OUT = ("title", "data_digest", "tried_models", "step_seconds", "plugins")
"""Settings that cannot be an axis: without effect, written by the program, or common to all points."""


@dataclass(frozen=True)
class Axis:
    """One setting of experiments and its ``values`` by label."""

    setting: str
    values: Mapping[str, Any]

    @classmethod
    def of(cls, setting: str, given: Any) -> Axis:
        """Return the axis from a list, a range, or a table of named values.

        Raises `InvalidArgument` that names the error.
        """
        where = f"grid.{setting}"
        if setting in LEFT_OUT:
            hint = "; name it under [experiment]" if setting == "plugins" else ""
            raise InvalidArgument(f"{where}: cannot be an axis{hint}")
        if setting not in Experiment.model_fields:
            raise InvalidArgument(f"{where}: {no_setting(setting)}")
        if isinstance(given, Mapping):
            pairs = [(str(label), value) for label, value in given.items()]
        else:
            listed = list(given) if isinstance(given, Sequence) and not isinstance(given, str) else [given]
            pairs = [(label_of(value), value) for one in listed for value in _ranged(setting, one, where)]
            if not isinstance(given, (list, tuple)) and len(pairs) < 2:
                raise InvalidArgument(
                    f'{where}: expected a list of values, a range such as "0..4" or a table of named values, '
                    f"got {given!r}; settings common to all points belong under [experiment]"
                )
        if not pairs:
            raise InvalidArgument(f"{where}: expected at least one value, got none")
        labels, values = zip(*pairs, strict=True)
        for label, value in pairs:
            if values.count(value) > 1:
                raise InvalidArgument(f"{where}: {label_of(value)!r} occurs twice")
            if labels.count(label) > 1:
                raise InvalidArgument(
                    f"{where}: two values are called {label!r}; name them, such as {{a = ..., b = ...}}"
                )
        for value in values:
            try:
                Experiment.of({setting: value})
            except InvalidArgument as error:
                raise InvalidArgument(f"grid.{error}") from error
        return cls(setting, dict(pairs))


def label_of(value: Any) -> str:
    """Return the label of a value that has no name of its own."""
    if isinstance(value, (list, tuple)):
        return ", ".join(map(label_of, value)) or "none"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _ranged(setting: str, value: Any, where: str) -> list[Any]:
    """Return the values of a range ``A..B``, both included; anything else is one value."""
    found = RANGE.fullmatch(value) if isinstance(value, str) and setting in RANGED else None
    if found is None:
        return [value]
    first, last = int(found["first"]), int(found["last"])
    if last < first:
        raise InvalidArgument(f"{where}: expected a range from the lower to the higher number, got {value!r}")
    texts = [f"{found['before']}{number}{found['after']}" for number in range(first, last + 1)]
    return [int(text) for text in texts] if setting == "seed" and all(map(str.isdecimal, texts)) else texts
