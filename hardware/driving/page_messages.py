"""The contract with the page: every message in both directions, as JSON, and the panel that provides them."""

from __future__ import annotations

import json
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Any

import numpy as np

from hardware.control_loop import PLANAR
from sysid_evo.system import Channel
from sysid_evo.tasks import Scene, Task
from sysid_evo.types import Array

FORWARD, BACKWARD, LEFT, RIGHT = 1, 2, 4, 8
ALL_KEYS = FORWARD | BACKWARD | LEFT | RIGHT
LARGEST_CLOCK = 1e12  # s


@dataclass(frozen=True)
class Keys:
    """From the page: the keys held (a bit for each), its clock in s, whether a new trial is requested."""

    keys: int
    clock: float
    new_trial: bool


@dataclass(frozen=True)
class TracedChannel:
    """A state or a control, the one at ``place``, whose time series is drawn."""

    place: int
    name: str
    unit: str
    neutral: float
    period: float | None
    bounds: tuple[float, float] | None


@dataclass(frozen=True)
class Setting:
    """To the page: constants of a session.

    ``controller`` drives, None if a person does; trials are shown at ``playback_speed`` times real time. A speed is the
    state at the place ``forward``.
    """

    robot: str
    controller: str | None
    playback_speed: float
    dt: float
    horizon: int
    unit: str
    top_view: bool
    forward: int | None
    arena: float | None
    waypoint_radius: float
    controls: tuple[str, ...]
    traces: list[TracedChannel]
    control_traces: list[TracedChannel]


@dataclass(frozen=True)
class WantedState:
    """Target of the state at ``place`` at every step, or a constant one."""

    place: int
    values: Array
    tolerance: float


@dataclass(frozen=True)
class Scenery:
    """To the page: constants of a trial, its walls (x and y in m) and targets of states."""

    walls: list[list[list[float]]]
    targets: list[WantedState]


class Phase(StrEnum):
    """Phase of a trial."""

    SETTLING = "settling"
    READY = "ready"
    DRIVING = "driving"
    FINISHED = "finished"
    ENDED = "ended"


@dataclass(frozen=True)
class Reading:
    """To the page: the trial of this number, from 1, at ``step``; ``scores`` are those of finished trials.

    ``state`` is (nx,), ``control`` (nu,) the one in force; ``pose`` and ``waypoint`` (2,) are relative to the task's
    origin. The newest pose is ``tracker_age`` s old, ``tracker_rate`` poses arrive per second; ``link`` is the status
    of the robot.
    """

    trial: int = 0
    phase: Phase = Phase.SETTLING
    step: int = 0
    score: float = 0.0
    scores: tuple[float, ...] = ()
    state: Array | None = None
    pose: Array | None = None
    control: Array | None = None
    waypoint: Array | None = None
    keys: int = 0
    tracker_age: float | None = None
    tracker_rate: int = 0
    link: str | None = None
    link_age: float = 0.0
    message: str = ""
    is_driver: bool = False
    watchers: int = 0


IN_JAVASCRIPT = {"bool": "boolean", "int": "number", "float": "number", "str": "string", "Phase": "string"}
IN_JAVASCRIPT |= {"None": "null", "list": "array", "tuple": "array", "Array": "array"}


def messages_script() -> str:
    """Return the messages as a module of JavaScript: their fields, and the types of each field."""
    table: dict[str, dict[str, list[str]]] = {}
    for message in (Setting, Scenery, Reading, Keys):
        kinds = {one.name: str(one.type).split(" | ") for one in fields(message)}
        of_each = {name: [IN_JAVASCRIPT[kind.partition("[")[0]] for kind in kinds[name]] for name in kinds}
        table[message.__name__.lower()] = of_each
    return f"export const MESSAGES = {json.dumps(table)};\n"


def as_text(message: Setting | Scenery | Reading) -> str:
    """Return a message as strict JSON, with null for each number of an array that is not finite."""

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return [number if math.isfinite(number) else None for number in value.tolist()]
        return vars(value)

    return json.dumps({"type": type(message).__name__.lower(), **vars(message)}, default=plain, allow_nan=False)


class InvalidPageMessage(ValueError):
    """The text received is no message of the page."""


def keys_message(message: Any) -> Keys:
    """Return a message of the page. Raises `InvalidPageMessage` unless it is a complete message of type ``keys``."""
    names = [one.name for one in fields(Keys)]
    if not isinstance(message, dict) or message.keys() != {"type", *names} or message["type"] != "keys":
        raise InvalidPageMessage(f"expected a message of the type keys with {', '.join(names)}, got {message!r:.50}")
    keys, clock, new_trial = (message[name] for name in names)
    if type(keys) is not int or not 0 <= keys <= ALL_KEYS:
        raise InvalidPageMessage(f"keys: expected 0 to {ALL_KEYS}, got {keys!r:.50}")
    if type(clock) not in (int, float) or not abs(clock) < LARGEST_CLOCK:
        raise InvalidPageMessage(f"clock: expected seconds, got {clock!r:.50}")
    if type(new_trial) is not bool:
        raise InvalidPageMessage(f"new_trial: expected true or false, got {new_trial!r:.50}")
    return Keys(keys, clock, new_trial)


MOST_TRACES = 4
"""Number of states whose time series is drawn if the task has no targets."""
MOST_CONTROLS = 2  # number of controls whose time series is drawn below them


class DrivePanel(ABC):
    """Data of the page for trials of the bound ``task``; another thread may change them meanwhile.

    ``controller`` is the driver, None for a person; ``playback_speed`` is the ratio to real time.
    """

    def __init__(self, robot: str, task: Task, controller: str | None = None, *, playback_speed: float = 1.0) -> None:
        self.robot, self.task, self.controller, self.playback_speed = robot, task, controller, playback_speed
        self._always = task.scene(task.begin(np.zeros(1, dtype=np.uint64)), 0)  # the same in all trials
        # States with a target are drawn over time, else the first ones that the view does not show.
        few = 0 if task.system.n_pose == PLANAR else min(MOST_TRACES, task.system.nx)
        self._traced = [target.place for target in self._always.targets] or list(range(few))

    @abstractmethod
    def scene(self) -> Scene:
        """Return what can be drawn of the trial."""

    @abstractmethod
    def reading(self) -> Reading:
        """Return the present state of the trial."""

    def setting(self) -> Setting:
        """Return the constants of a session."""
        system, states = self.task.system, self._traced
        forward = None if system.motion is None else system.motion.roles().get("forward")
        return Setting(
            robot=self.robot,
            controller=self.controller,
            playback_speed=self.playback_speed,
            dt=system.dt,
            horizon=self.task.horizon,
            unit=self.task.fitness_unit,
            top_view=system.n_pose == PLANAR,
            forward=None if forward is None else system.state_names.index(forward),
            arena=self._always.extent,
            waypoint_radius=self._always.radius,
            controls=system.control_names,
            traces=[_trace(place, system.states[place]) for place in states],
            control_traces=[_trace(*one) for one in enumerate(system.controls[: MOST_CONTROLS if states else 0])],
        )

    def scenery(self) -> Scenery:
        """Return the constants of a trial."""
        scene = self.scene()
        targets = [WantedState(target.place, target.values, target.tolerance) for target in scene.targets]
        return Scenery([np.round(wall, 3).tolist() for wall in scene.walls], targets)


def _trace(place: int, channel: Channel) -> TracedChannel:
    bounds = (channel.low, channel.high) if channel.bounded else None
    return TracedChannel(place, channel.name, channel.unit, channel.neutral, channel.period, bounds)
