"""What a study found: rows for points, models and controllers, each a plain record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from evaluation.study.study import Study

Kind: TypeAlias = Literal["single", "ensemble", "recommended", "robot", "by hand"]
"""What a controller comes from: one model, several at once, the recommended recipe, the robot itself, a person."""


@dataclass(frozen=True)
class Error:
    """N of a model ``horizon`` steps ahead, with its 95 % interval over the test data; it has no unit."""

    horizon: int
    n: float
    low: float
    high: float


@dataclass(frozen=True)
class ModelRow:
    """One fitted model of one point, or the ``reason`` why there is none.

    ``claimed`` and ``achieved`` are means over the controllers that were evolved in it, ``kept`` is the share of the
    claim that is achieved, ``exploited`` whether the claim is. ``seconds`` is how long the fit took.
    """

    point: str
    model: str
    family: str
    errors: tuple[Error, ...] = ()
    exploited: bool | None = None
    claimed: float | None = None
    achieved: float | None = None
    kept: float | None = None
    seconds: float | None = None
    reason: str = ""

    def n(self, horizon: int) -> float | None:
        """Return N at a horizon, None where it was not measured."""
        return next((error.n for error in self.errors if error.horizon == horizon), None)


@dataclass(frozen=True)
class ControllerRow:
    """One controller of one point, or the ``reason`` why there is none; fitness is in the unit of the point's task.

    ``achieved`` is that on the robot; ``worst`` that on ``worst_on``, the system where it is lowest of all that it was
    not evolved against. ``expected`` says whether what is achieved lies in the 90 % interval of the forecast.
    ``error`` is the mean of N after a second of the models that it was evolved in. ``yardstick`` is the best that is
    achieved on this robot in the study, ``share`` what is achieved of it, both measured from ``floor``, controls at
    rest, where those were run.
    """

    point: str
    controller: str
    kind: Kind
    members: tuple[str, ...]
    aggregate: str = ""
    claimed: float | None = None
    achieved: float | None = None
    achieved_error: float | None = None
    forecast: float | None = None
    forecast_low: float | None = None
    forecast_high: float | None = None
    expected: bool | None = None
    worst: float | None = None
    worst_on: str = ""
    error: float | None = None
    exploited: bool | None = None
    floor: float | None = None
    yardstick: float | None = None
    share: float | None = None
    chosen: bool = False
    file: str = ""
    reason: str = ""

    @property
    def in_models(self) -> bool:
        """Whether it was evolved in models, and not on the robot itself or by a person."""
        return self.kind in ("single", "ensemble", "recommended")


@dataclass(frozen=True)
class PointRow:
    """One point: how many of its ``cells`` are done, failed and ``missing``, and which controller is ``chosen``.

    ``where`` is its robot or its recordings, ``group`` the labels of the axes that tell rows of a table apart.
    """

    name: str
    labels: Mapping[str, str]
    where: str
    seed: str
    group: tuple[str, ...]
    cells: int
    done: int
    failed: int
    missing: int
    task: str = ""
    unit: str = ""
    chosen: str = ""

    @property
    def finished(self) -> bool:
        """Whether nothing of it is still to be computed."""
        return self.missing == 0


@dataclass(frozen=True)
class Failed:
    """A cell that failed, in which point, and why."""

    point: str
    cell: str
    reason: str


@dataclass(frozen=True)
class CellTime:
    """How long one cell took that was computed, once for all points that need it."""

    kind: str
    seconds: float
    failed: bool = False


@dataclass(frozen=True)
class StudyResults:
    """All that is known of a study, from its plan and its store alone."""

    study: Study
    points: tuple[PointRow, ...]
    models: tuple[ModelRow, ...] = ()
    controllers: tuple[ControllerRow, ...] = ()
    failures: tuple[Failed, ...] = ()
    times: tuple[CellTime, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)

    @property
    def finished(self) -> tuple[PointRow, ...]:
        """The points of which nothing is missing."""
        return tuple(point for point in self.points if point.finished)

    def point(self, name: str) -> PointRow:
        """Return the point of this name."""
        return next(point for point in self.points if point.name == name)
