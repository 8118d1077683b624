"""The spaces of a system at a task, and what units their numbers have."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import numpy as np
from gymnasium import spaces

from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidArgument
from sysid_evo.system import Channel, System
from sysid_evo.tasks.task import Task

Actions: TypeAlias = Literal["auto", "continuous", "discrete"]
"""How a system is controlled: a Box of outputs as controllers have them, or the number of a level for each control."""


def action_space(system: System, actions: Actions) -> spaces.Space[Any]:
    """Return the space of the actions; "auto" is discrete where every control has levels.

    Continuous actions are a controller's outputs, a Box from -1 to 1, see `System.actuate`. Raises `InvalidArgument`.
    """
    if actions not in ("auto", "continuous", "discrete"):
        raise InvalidArgument(f"environment: actions are auto, continuous or discrete, not {actions!r}")
    levels = [len(channel.levels or ()) for channel in system.controls]
    if actions == "continuous" or (actions == "auto" and not all(levels)):
        system.actuate(np.zeros(system.nu))
        return spaces.Box(-1.0, 1.0, (system.nu,), dtype=np.float32)
    if not all(levels):
        free = next(channel.name for channel in system.controls if channel.levels is None)
        raise InvalidArgument(f"environment: control {free!r} has no levels, so that actions cannot be discrete")
    return spaces.Discrete(levels[0]) if len(levels) == 1 else spaces.MultiDiscrete(levels)


def control_of(system: System, space: spaces.Space[Any], action: Any, several: tuple[int, ...] = ()) -> Array:
    """Return the controls (*several, nu) of one action, or of ``several`` side by side. Raises `InvalidArgument`."""
    given = np.asarray(action)
    expected = (*several, *(space.shape or ()))
    if given.shape != expected:
        raise InvalidArgument(f"environment: expected an action of {space}, shape {expected}, got shape {given.shape}")
    if isinstance(space, spaces.Box):
        return system.actuate(given.astype(np.float64))
    chosen = given.astype(np.int64)
    if isinstance(space, spaces.Discrete):
        chosen = chosen[..., None]
    counts = np.array([len(channel.levels or ()) for channel in system.controls])
    if ((chosen < 0) | (chosen >= counts)).any() or (given != given.astype(np.int64)).any():
        raise InvalidArgument(f"environment: expected an action of {space}, got {action}")
    values = [np.asarray(channel.levels)[chosen[..., i]] for i, channel in enumerate(system.controls)]
    return np.stack(values, axis=-1)


def observation_space(task: Task) -> spaces.Box:
    """Return the space of what ``task`` shows: without limits, which a simulation may exceed."""
    return spaces.Box(-np.inf, np.inf, (len(task.observations),), dtype=np.float32)


def metadata_of(task: Task, space: spaces.Space[Any]) -> dict[str, Any]:
    """Return names and units of observations, actions and rewards, and the time of a step in s."""
    outputs = isinstance(space, spaces.Box)
    return {
        "render_modes": [],
        "render_fps": round(1.0 / task.system.dt),
        "dt": task.system.dt,
        "observations": _described(task.observations),
        "actions": {name: "" if outputs else unit for name, unit in _described(task.system.controls).items()},
        "controls": _described(task.system.controls),
        "reward": task.fitness_unit,
    }


def _described(channels: tuple[Channel, ...]) -> dict[str, str]:
    return {channel.name: channel.unit for channel in channels}
