"""Column maps: channel, unit and limits of each column of a log.

A map is a TOML file (described in ``docs/data.md``); some are shipped in the folder ``maps``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator
from pydantic_core import ErrorDetails

from sysid_evo.angles import TURN
from sysid_evo.data.units import to_si, units_of
from sysid_evo.errors import InvalidArgument, InvalidData, closest
from sysid_evo.files import parsed_toml
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System

ROLE_UNITS = {"forward": "m/s", "lateral": "m/s", "yaw_rate": "rad/s"}


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class _Scaled(_Strict):
    unit: str
    factor: float = 1.0

    @field_validator("unit")
    @classmethod
    def _known(cls, unit: str) -> str:
        to_si(unit)
        return unit

    @property
    def scale(self) -> float:
        """The factor from values of the file to SI units."""
        return self.factor * to_si(self.unit)[1]


class Column(_Scaled):
    """One column: its value times ``factor`` is in ``unit``, which is converted to SI units."""

    column: str


class TimeColumn(Column):
    """The column of time stamps."""

    unit: Literal["s", "ms", "us", "ns"] = "s"


class StateColumn(_Scaled):
    """A state: from a column, as the rate of the state ``derivative_of``, or, without both, from the pose.

    ``low``, ``high`` and ``neutral``, its value at rest, are in SI units. A ``periodic`` one is an angle
    with the period of a full turn.
    """

    column: str | None = None
    derivative_of: str | None = None
    low: float | None = None
    high: float | None = None
    neutral: float | None = None
    periodic: bool = False

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.column is not None and self.derivative_of is not None:
            raise ValueError("expected column or derivative_of, not both")
        return self

    @model_validator(mode="after")
    def _angle(self) -> Self:
        if self.periodic:
            _expect_unit("periodic", self.unit, "rad")
            if self.low is not None or self.high is not None:
                raise ValueError("a periodic state has no limits: leave out low and high, or periodic")
        return self


class ControlColumn(Column):
    """A control: it is multiplied by the column ``gate``; with ``non_negative``, negative values are set to 0.

    ``low`` and ``high``, or ``levels``, or ``neutral`` are in SI units, after factor and gate.
    Without limits the channel gets the lowest and highest value of the recordings. ``words`` maps each text of
    the column to a number; without limits these numbers are the levels. With ``hold`` an empty cell means the command
    of the row before it.
    """

    unit: str = ""
    gate: str | None = None
    words: Annotated[dict[str, float], Field(min_length=2)] | None = None
    non_negative: bool = False
    hold: bool = False
    low: float | None = None
    high: float | None = None
    levels: Annotated[tuple[float, ...], Field(strict=False)] | None = None
    neutral: float | None = None

    @model_validator(mode="after")
    def _one_kind_of_limit(self) -> Self:
        if (self.low is None) != (self.high is None):
            raise ValueError("expected both low and high, or neither")
        if self.levels is not None and self.low is not None:
            raise ValueError("expected low and high, or levels, not both")
        return self

    @property
    def all_levels(self) -> tuple[float, ...] | None:
        """The levels, given or from ``words``, in rising order; None if the control is continuous."""
        if self.levels is not None or self.words is None or self.low is not None:
            return self.levels
        return tuple(sorted({self.scale * number for number in self.words.values()}))

    @property
    def limited(self) -> bool:
        """Whether the map has limits or levels."""
        return self.all_levels is not None or self.low is not None


class MotionRoles(_Strict):
    """The states that move the pose of a planar body; ``lateral`` is optional."""

    kind: Literal["planar_body"] = "planar_body"
    forward: str
    yaw_rate: str
    lateral: str | None = None


class ColumnMap(_Strict):
    """A column map: control period ``dt`` in s, time, states, controls, pose, other columns, motion.

    ``condition`` is the column with the condition of each row, text or numbers. ``encoding`` is that of text logs.
    With ``missing`` "drop", rows with missing numbers are left out; else they are an error. ``advance`` is that of the
    `System`.
    """

    name: str
    dt: Annotated[float, Field(gt=0)]
    time: TimeColumn | None = None
    states: Annotated[dict[str, StateColumn], Field(min_length=1)]
    controls: dict[str, ControlColumn] = {}
    pose: dict[str, Column] = {}
    extra: dict[str, Column] = {}
    motion: MotionRoles | None = None
    condition: str | None = None
    encoding: str | None = None
    missing: Literal["refuse", "drop"] = "refuse"
    advance: bool = False

    @field_validator("encoding")
    @classmethod
    def _of_text(cls, encoding: str | None) -> str | None:
        try:
            "".encode(encoding or "utf-8")
        except LookupError:
            raise ValueError(f"no text encoding {encoding!r}: expected one such as utf-8, utf-16, cp1252") from None
        return encoding

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names = [*self.states, *self.controls, *self.pose, *self.extra]
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise ValueError(f"states, controls, pose and extra must have different names; repeated: {repeated}")
        roles = {} if self.motion is None else self.motion_of_states.roles()
        for role, state in roles.items():
            if state not in self.states:
                raise ValueError(f"motion.{role} names {state!r}, but the states are {', '.join(self.states)}")
            _expect_unit(f"states.{state}", self.states[state].unit, ROLE_UNITS[role])
        pose = () if self.motion is None else tuple(zip(PlanarBody.pose_names, PlanarBody.pose_units, strict=True))
        if self.pose and set(self.pose) != {name for name, _ in pose}:
            wanted = ", ".join(name for name, _ in pose) or "none, because there is no [motion]"
            raise ValueError(f"pose: expected {wanted}, got {', '.join(self.pose)}")
        for name, unit in pose if self.pose else ():
            _expect_unit(f"pose.{name}", self.pose[name].unit, unit)
        for name in self.rates:
            self._expect_rate(name, self.states[name])
        from_pose = [name for name in self.differentiated if name not in self.rates]
        underived = [name for name in from_pose if name not in roles.values()]
        if underived:
            raise ValueError(
                f"states {', '.join(underived)}: expected a column, derivative_of (the state whose rate it is), or a "
                "role in [motion]"
            )
        if from_pose and not self.pose:
            raise ValueError(f"states {', '.join(from_pose)} have no column, so [pose] is needed")
        return self

    def _expect_rate(self, name: str, state: StateColumn) -> None:
        of = self.states.get(state.derivative_of or "")
        if of is None or of.column is None:
            measured = ", ".join(other for other, its in self.states.items() if its.column is not None)
            raise ValueError(
                f"states.{name}.derivative_of: expected a state with a column ({measured or 'there is none'}), "
                f"got {state.derivative_of!r}"
            )
        if "[" not in of.unit:
            _expect_unit(f"states.{name}", state.unit, to_si(f"{to_si(of.unit)[0]}/s")[0])

    @property
    def differentiated(self) -> tuple[str, ...]:
        """The states without a column, which are derived from the pose or from another state."""
        return tuple(name for name, state in self.states.items() if state.column is None)

    @property
    def rates(self) -> dict[str, str]:
        """The state that is differentiated for each state with ``derivative_of``, by its name."""
        return {name: state.derivative_of for name, state in self.states.items() if state.derivative_of is not None}

    @property
    def motion_of_states(self) -> PlanarBody:
        """The motion with its roles filled. Raises `InvalidData` if the map has none."""
        if self.motion is None:
            raise InvalidData(f"column map {self.name!r} has no [motion]")
        return PlanarBody(self.motion.forward, self.motion.lateral, self.motion.yaw_rate)

    @property
    def columns(self) -> tuple[str, ...]:
        """Every column of the file that the map uses, each once."""
        worded = [control.column for control in self.controls.values() if control.words is not None]
        return tuple(dict.fromkeys([*self.number_columns, *worded]))

    @property
    def number_columns(self) -> tuple[str, ...]:
        """The columns of numbers, each once, without those of commands in words."""
        used = [] if self.time is None else [self.time.column]
        used += [state.column for state in self.states.values() if state.column is not None]
        for control in self.controls.values():
            used += [control.column] if control.words is None else []
            used += [control.gate] if control.gate else []
        used += [column.column for column in (*self.pose.values(), *self.extra.values())]
        return tuple(dict.fromkeys(used))

    def system(self, control_limits: Mapping[str, tuple[float, float]]) -> System:
        """Return the system that the map describes; ``control_limits`` limits the controls without limits."""
        states = tuple(
            Channel(
                name,
                to_si(state.unit)[0],
                low=-math.inf if state.low is None else state.low,
                high=math.inf if state.high is None else state.high,
                neutral=math.nan if state.neutral is None else state.neutral,
                period=TURN if state.periodic else None,
            )
            for name, state in self.states.items()
        )
        controls = []
        for name, control in self.controls.items():
            levels = control.all_levels
            if levels is not None:
                low, high = levels[0], levels[-1]
            elif control.low is not None and control.high is not None:
                low, high = control.low, control.high
            else:
                low, high = control_limits[name]
            neutral = math.nan if control.neutral is None else control.neutral
            controls.append(Channel(name, to_si(control.unit)[0], low, high, levels, neutral))
        motion = None if self.motion is None else self.motion_of_states
        return System(states, tuple(controls), self.dt, motion, self.name, self.advance)


def load_columns(source: str | Path) -> ColumnMap:
    """Return the column map in a TOML file, or a shipped one by its name. Raises `InvalidData`."""
    path = Path(source)
    if path.suffix != ".toml" and str(source) in shipped_names():
        return shipped_columns()[str(source)]
    if not path.is_file():
        found = "it is a folder" if path.is_dir() else "found neither"
        raise InvalidArgument(
            f"column map {str(source)!r}: expected a TOML file or one of {', '.join(shipped_names())}; {found}"
        )
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InvalidData(f"{path}: expected a TOML file, which is UTF-8: {error}") from error
    return parse_columns(text, str(path))


def parse_columns(text: str, source: str) -> ColumnMap:
    """Return the map that the TOML ``text`` describes; errors name ``source`` and the path of each key."""
    try:
        return ColumnMap.model_validate(parsed_toml(text))
    except ValidationError as error:
        lines = [f"  {'.'.join(map(str, item['loc'])) or 'map'}: {_explain(item)}" for item in error.errors()]
        raise InvalidData("\n".join([f"{source}: not a column map:", *lines])) from error
    except ValueError as error:
        raise InvalidData(f"{source}: not a TOML file: {error}") from error


def shipped_names() -> tuple[str, ...]:
    """Return the names of the maps that come with the library."""
    files = resources.files("sysid_evo.data").joinpath("maps").iterdir()
    return tuple(sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml")))


def shipped_columns() -> dict[str, ColumnMap]:
    """Return the maps that come with the library, by name."""
    folder = resources.files("sysid_evo.data").joinpath("maps")
    return {
        name: parse_columns(folder.joinpath(f"{name}.toml").read_text(encoding="utf-8"), name)
        for name in shipped_names()
    }


def choose_columns(header: Sequence[str], source: str) -> str:
    """Return the name of the shipped map for a log with this ``header``.

    All columns of the map must be in the header; of several such maps, the one that includes the columns of the others
    is used. Raises `InvalidData` if there is none.
    """
    used = {name: set(columns.columns) for name, columns in shipped_columns().items()}
    fitting = {name: columns for name, columns in used.items() if columns <= set(header)}
    best = [name for name, columns in fitting.items() if all(columns >= other for other in fitting.values())]
    if len(best) == 1:
        return best[0]
    listed = "\n".join(f"  {name}: {', '.join(sorted(columns))}" for name, columns in used.items())
    found = f"{', '.join(fitting)} all fit" if fitting else "no shipped column map fits"
    raise InvalidData(
        f"{source}: {found} its columns ({', '.join(header)}). "
        "For your own robot, write a column map (a TOML file, see docs/data.md) and give it with columns= "
        f"(--columns). Shipped maps and the columns they need:\n{listed}"
    )


def _expect_unit(where: str, unit: str, si_unit: str) -> None:
    if to_si(unit)[0] != si_unit:
        raise ValueError(f"{where}.unit: expected one of {', '.join(units_of(si_unit)) or si_unit}, got {unit!r}")


def _explain(error: ErrorDetails) -> str:
    """Return the error of a key, with a suggestion if the key is unknown."""
    if error["type"] != "extra_forbidden":
        return error["msg"].removeprefix("Value error, ")
    known = sorted({key for part in (ColumnMap, ControlColumn, StateColumn, MotionRoles) for key in part.model_fields})
    close = closest(str(error["loc"][-1]), known)
    return f"unknown key; did you mean {close!r}?" if close else "unknown key"
