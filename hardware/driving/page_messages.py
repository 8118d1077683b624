"""The messages of the page, all of them JSON: the keys that it sends, and what it is sent to show."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np

from hardware.control_loop import PLANAR
from sysid_evo.system import Channel, System
from sysid_evo.tasks import Scene, Task
from sysid_evo.types import Array

FORWARD, BACKWARD, LEFT, RIGHT = 1, 2, 4, 8
ALL_KEYS = FORWARD | BACKWARD | LEFT | RIGHT
LARGEST_CLOCK = 1e12  # s


class InvalidWord(ValueError):
    """What came is not what the page sends."""


def keys_message(word: Any) -> tuple[int, float, bool]:
    """Return the keys held (a bit for each), the page's clock in s, and whether ``word`` wants a new trial.

    One without ``new`` wants none. Raises `InvalidWord`.
    """
    if not isinstance(word, dict) or not {"keys", "clock"} <= word.keys() <= {"keys", "clock", "new"}:
        raise InvalidWord("expected keys, clock and perhaps new")
    keys, clock, new = word["keys"], word["clock"], word.get("new", False)
    if type(keys) is not int or not 0 <= keys <= ALL_KEYS:
        raise InvalidWord(f"keys: expected 0 to {ALL_KEYS}, got {keys!r}")
    if type(clock) not in (int, float) or not abs(clock) < LARGEST_CLOCK:
        raise InvalidWord(f"clock: expected seconds, got {clock!r}")
    if type(new) is not bool:
        raise InvalidWord(f"new: expected true or false, got {new!r}")
    return keys, clock, new


MOST_TRACES = 4
"""States whose course is drawn where the task has no targets."""
MOST_CONTROLS = 2  # whose course is drawn below them


class DrivePanel(Protocol):
    """What the server asks for; another thread may change it meanwhile. All of it is strict JSON."""

    def setting(self) -> dict[str, Any]:
        """Return what stays the same in a session."""
        ...

    def scenery(self) -> dict[str, Any]:
        """Return what stays the same in a trial: walls, and what states were to be."""
        ...

    def reading(self) -> dict[str, Any]:
        """Return what there is to see now; ``trial`` is the number of the trial."""
        ...


def setting_of(robot: str, task: Task, *, by_hand: bool) -> dict[str, Any]:
    """Return the setting of a session with ``robot`` at the bound ``task``, driven ``by_hand`` or by a controller."""
    system = task.system
    scene = first_scene(task)
    places = traced(system, scene)
    return {
        "robot": robot,
        "by_hand": by_hand,
        "dt": system.dt,
        "horizon": task.horizon,
        "unit": task.fitness_unit,
        "top_view": system.n_pose == PLANAR,
        "arena": scene.extent,
        "waypoint_radius": scene.radius or None,
        "controls": [channel.name for channel in system.controls],
        "traces": [_trace(system.states[place]) for place in places],
        "control_traces": [_trace(channel) for channel in system.controls[: MOST_CONTROLS if places else 0]],
    }


def first_scene(task: Task) -> Scene:
    """Return what can be drawn of a trial of the bound ``task``, for what is the same in all of them."""
    return task.scene(task.begin(np.zeros(1, dtype=np.uint64)), 0)


def traced(system: System, scene: Scene) -> tuple[int, ...]:
    """Return which states are drawn over time: those that are led, else the first ones of what has no place to show."""
    led = tuple(target.place for target in scene.targets)
    return led or (() if system.n_pose == PLANAR else tuple(range(min(MOST_TRACES, system.nx))))


def scenery_of(system: System, scene: Scene) -> dict[str, Any]:
    """Return the walls (x and y in m) of a trial, and targets and tolerances of the states that are traced."""
    targets = {target.place: target for target in scene.targets}
    return {
        "walls": [np.round(wall, 3).tolist() for wall in scene.walls],
        "targets": [
            None
            if place not in targets
            else {"values": targets[place].values.tolist(), "tolerance": targets[place].tolerance}
            for place in traced(system, scene)
        ],
    }


def numbers(values: Array | None) -> list[float | None] | None:
    """Return ``values`` (n,) for JSON, None for each that is not finite."""
    return None if values is None else [value if math.isfinite(value) else None for value in values.tolist()]


def speed_of(system: System, state: Array | None) -> float | None:
    """Return how fast a body drives in ``state`` (nx,); None if it has no such speed or it is not known."""
    forward = None if system.motion is None else system.motion.roles().get("forward")
    if state is None or forward is None or not np.isfinite(state).all():
        return None
    return float(state[system.state_names.index(forward)])


def _trace(channel: Channel) -> dict[str, Any]:
    return {
        "name": channel.name,
        "unit": channel.unit,
        "neutral": channel.neutral,
        "period": channel.period,
        "bounds": [channel.low, channel.high] if channel.bounded else None,
    }
