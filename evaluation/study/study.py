"""What a study is asked to do: the content of ``STUDY.toml``, validated and taken apart into points."""

from __future__ import annotations

import difflib
import itertools
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import tomli_w

from evaluation.comparison import Experiment
from evaluation.study.axes import Axis
from sysid_evo.errors import InvalidArgument
from sysid_evo.files import write_atomically

FILE = "study.toml"
PARTS = ("title", "experiment", "grid", "reference")
CONTROLLER = "controller"
"""Under ``reference``: the controller that others are compared with."""
REPEATED = ("robot", "data", "seed")
"""Axes over which means and intervals are taken; the others tell rows of a table apart."""
USUAL = "usual"
"""The label of an axis in a grid that leaves it open."""


@dataclass(frozen=True)
class Point:
    """One experiment of a study; ``labels`` says for each axis what its value is called."""

    labels: Mapping[str, str]
    experiment: Experiment

    @property
    def name(self) -> str:
        """What people read: the robot, the seed, then the other axes."""
        return name_of(self.labels)

    @property
    def where(self) -> str:
        """The robot or the recordings: what differs from car to car."""
        found = [self.labels[axis] for axis in ("robot", "data") if axis in self.labels]
        return ", ".join(found) or str(self.experiment.robot or "emulated_car")

    @property
    def group(self) -> tuple[str, ...]:
        """The labels of the axes that tell rows of a table apart."""
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


@dataclass(frozen=True)
class Study:
    """A grid of experiments: what all share, and the axes whose combinations are the points.

    ``experiment`` holds settings of `Experiment` that are common to all points, ``grids`` the axes by setting; the
    points of several grids are united. ``reference`` names the row that others are compared with: a controller, and
    the labels of axes that tell rows apart; empty for the recommended controller.
    """

    title: str
    experiment: Mapping[str, Any]
    grids: tuple[Mapping[str, Axis], ...]
    reference: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> Study:
        """Return the study with these settings, all checked. Raises `InvalidArgument` that names what is wrong."""
        settings = _plain(settings)
        for name in settings:
            if name not in PARTS:
                close = difflib.get_close_matches(name, PARTS, n=1)
                hint = f"; did you mean {close[0]}?" if close else f"; a study has {', '.join(PARTS)}"
                raise InvalidArgument(f"{name} is no part of a study{hint}")
        title = settings.get("title", "Study")
        if not isinstance(title, str):
            raise InvalidArgument(f"title: expected a text, got {title!r}")
        common = _table("experiment", settings.get("experiment", {}))
        for name in ("title", "data_digest"):
            if name in common:
                raise InvalidArgument(f"experiment.{name}: not here; the title of a study stands above [experiment]")
        try:
            Experiment.of(common)
        except InvalidArgument as error:
            raise InvalidArgument(f"[experiment]: {error}") from error
        given = settings.get("grid", {})
        several = given if isinstance(given, (list, tuple)) else [given]
        grids = tuple({name: Axis.of(name, values) for name, values in _table("grid", one).items()} for one in several)
        for name in dict.fromkeys(name for grid in grids for name in grid):
            if name in common:
                raise InvalidArgument(f"{name} stands under [experiment] and in the grid; leave it out of one of them")
        study = cls(title, common, grids, _reference(settings.get("reference", {}), grids), dict(settings))
        if not study.points:
            raise InvalidArgument("grid: expected at least one axis, such as seed = [0, 1, 2], got none")
        return study

    @classmethod
    def read(cls, path: str | Path) -> Study:
        """Return the study in a TOML file, or in that of a study's folder. Raises `InvalidArgument`."""
        file = Path(path) / FILE if Path(path).is_dir() else Path(path)
        try:
            settings = tomllib.loads(file.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise InvalidArgument(f"{file}: expected a study, found no such file") from None
        except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise InvalidArgument(f"{file}: expected a study in TOML: {error}") from error
        try:
            return cls.of({"title": file.stem, **settings})
        except InvalidArgument as error:
            raise InvalidArgument(f"{file}: {error}") from error

    def write(self, path: str | Path) -> Path:
        """Write the study to a TOML file."""
        text = tomli_w.dumps(dict(self.settings))
        return write_atomically(Path(path), lambda file: file.write_text(text, encoding="utf-8"))

    @property
    def axes(self) -> tuple[str, ...]:
        """The settings that differ from point to point, in the order in which they are first named."""
        return tuple(dict.fromkeys(name for grid in self.grids for name in grid))

    @property
    def group_axes(self) -> tuple[str, ...]:
        """The axes that tell rows of a table apart."""
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
            raise InvalidArgument(f"grid: two points are called {repeated!r}; name the values of one axis otherwise")
        return tuple(found.values())

    def _points(self) -> Iterator[Point]:
        for grid in self.grids:
            if not grid:
                continue
            for labels in itertools.product(*(axis.values for axis in grid.values())):
                named = dict(zip(grid, labels, strict=True))
                values = {name: axis.values[named[name]] for name, axis in grid.items()}
                ordered = {name: named.get(name, USUAL) for name in self.axes}
                try:
                    yield Point(ordered, Experiment.of({**self.experiment, **values}))
                except InvalidArgument as error:
                    raise InvalidArgument(f"point {name_of(ordered)}: {error}") from error


def _table(name: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise InvalidArgument(f"{name}: expected a table [{name}], got {value!r}")
    return dict(value)


def _reference(value: Any, grids: Sequence[Mapping[str, Axis]]) -> dict[str, str]:
    """Return the labels of the row that others are compared with. Raises `InvalidArgument`."""
    given = {name: str(label) for name, label in _table("reference", value).items()}
    for name, label in given.items():
        known = dict.fromkeys(one for grid in grids if name in grid for one in grid[name].values)
        if name in REPEATED or (name != CONTROLLER and not known):
            raise InvalidArgument(
                f"reference.{name}: expected controller, or an axis of the grid other than {', '.join(REPEATED)}"
            )
        if known and label not in known:
            raise InvalidArgument(f"reference.{name}: expected one of {', '.join(known)}, got {label!r}")
    return given


def _plain(value: Any) -> Any:
    """Return lists for tuples, as TOML and JSON give them."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value
