"""Spaces of Gymnasium environments as channels: observations to states, controls to actions; making environments."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sysid_evo.angles import TURN
from sysid_evo.errors import IncompatibleSystem, InvalidArgument, described
from sysid_evo.system import Channel, System
from sysid_evo.tasks.raw import RawInterface, RawValue
from sysid_evo.types import Array

if TYPE_CHECKING:
    import gymnasium


def make_environment(name: str, settings: Mapping[str, Any]) -> gymnasium.Env[Any, Any]:
    """Return the environment called ``name``. Raises `InvalidArgument` with the reason if there is none."""
    import gymnasium

    try:
        return gymnasium.make(name, disable_env_checker=True, **settings)
    except (gymnasium.error.Error, ImportError, TypeError, ValueError) as error:
        reason = str(error).rstrip(".")
        instead = "An environment of your own must be registered with Gymnasium: name the file that does so with "
        instead += "--plugin FILE"
        if isinstance(error, TypeError):
            instead = "Its arguments are given by settings={name: value}"
        raise InvalidArgument(f"robot gymnasium: cannot make the environment {name!r}: {reason}. {instead}") from error


LARGEST = 1e6
"""A limit beyond this counts as none."""
MOST = 64
"""More observations than this are not a state of a small model but an image."""
NAME = re.compile(r"(?P<name>[^\[\]]+?)\s*(?:\[(?P<unit>[^\[\]]*)\])?")


@dataclass(frozen=True)
class ObservationMap:
    """Conversion of observations (n,) to states: each state is one observation, or an angle.

    ``places`` has for each state its observation, or the cosine and the sine of its angle; ``wrapped`` are the states
    that are angles, from one number or two.
    """

    places: tuple[tuple[int, ...], ...]
    wrapped: frozenset[int]

    def state(self, observation: npt.ArrayLike) -> Array:
        """Return the states (..., nx) of ``observation`` (..., n); angles are in (-pi, pi]."""
        seen = np.asarray(observation, dtype=np.float64)
        columns = [
            np.arctan2(seen[..., place[1]], seen[..., place[0]]) if len(place) == 2 else seen[..., place[0]]
            for place in self.places
        ]
        return np.stack(columns, axis=-1)


def parse_angles(what: str, text: str, n: int) -> tuple[tuple[int, ...], ...]:
    """Return the groups of observations that are angles: ``"0,1; 4"`` is a cosine and its sine, and an angle in rad.

    ``n`` is the number of observations. Raises `InvalidArgument`.
    """
    groups = []
    for part in filter(str.strip, str(text).split(";")):
        try:
            group = tuple(int(number) for number in part.split(","))
        except ValueError:
            group = ()
        if len(group) not in (1, 2) or not all(0 <= number < n for number in group):
            raise InvalidArgument(
                f"{what}: angle: expected the numbers of a cosine and of its sine, '0,1', or of one angle in rad, '2', "
                f"several separated by ';', from 0 to {n - 1}; got {part.strip()!r}"
            )
        groups.append(group)
    used = [number for group in groups for number in group]
    if len(set(used)) < len(used):
        raise InvalidArgument(f"{what}: angle: an observation occurs in two angles of {text!r}")
    return tuple(groups)


def observation_map(what: str, space: gymnasium.Space[Any], angle: str) -> tuple[ObservationMap, tuple[Channel, ...]]:
    """Return the conversion of observations in ``space`` to states, and their channels, named by their numbers.

    Raises `IncompatibleSystem` if they are not a plain vector of numbers.
    """
    from gymnasium import spaces

    if not isinstance(space, spaces.Box) or len(space.shape) != 1 or not 1 <= space.shape[0] <= MOST:
        fits = space.is_np_flattenable and spaces.flatdim(space) <= MOST
        raise IncompatibleSystem(
            f"{what}: expected a Box of at most {MOST} observations in a row, got {space}. Wrap the environment, for "
            f"example in gymnasium.wrappers.{'Flatten' if fits else 'Transform'}Observation, and register that"
        )
    n = int(space.shape[0])
    groups = parse_angles(what, angle, n)
    grouped = {min(group): group for group in groups}
    inside = {number for group in groups for number in group}
    places = tuple(grouped.get(i, (i,)) for i in range(n) if i in grouped or i not in inside)
    wrapped = frozenset(k for k, place in enumerate(places) if place in groups)
    return ObservationMap(places, wrapped), tuple(
        Channel(f"angle_{place[0]}", "rad", period=TURN) if k in wrapped else _observed(space, place[0])
        for k, place in enumerate(places)
    )


def control_channels(what: str, space: gymnasium.Space[Any]) -> tuple[Channel, ...]:
    """Return the channels of the actions in ``space``; those of discrete actions have the actions as levels.

    Raises `IncompatibleSystem`.
    """
    from gymnasium import spaces

    if isinstance(space, spaces.Discrete):
        return (_levels("control", int(space.n), int(space.start)),)
    if isinstance(space, spaces.MultiDiscrete) and space.nvec.ndim == 1:
        starts = np.broadcast_to(getattr(space, "start", 0), space.nvec.shape)
        return tuple(
            _levels(f"control_{i}", int(n), int(first))
            for i, (n, first) in enumerate(zip(space.nvec, starts, strict=True))
        )
    if isinstance(space, spaces.MultiBinary) and len(space.shape) == 1:
        return tuple(_levels(f"control_{i}", 2, 0) for i in range(space.shape[0]))
    if isinstance(space, spaces.Box) and 0 not in space.shape and np.isfinite([space.low, space.high]).all():
        low, high = space.low.ravel().tolist(), space.high.ravel().tolist()
        names = ["control"] if len(low) == 1 else [f"control_{i}" for i in range(len(low))]
        return tuple(Channel(name, low=a, high=b) for name, a, b in zip(names, low, high, strict=True))
    raise IncompatibleSystem(
        f"{what}: expected discrete actions or a Box of them with finite limits, got {space}. Wrap the environment, "
        "for example in gymnasium.wrappers.TransformAction(env, lambda a: a, Box(-1, 1, (1,))), and register that"
    )


@dataclass(frozen=True)
class ActionMap:
    """Conversion of a control (nu,) in the units of ``controls`` to an action of ``space``."""

    space: gymnasium.Space[Any]
    controls: tuple[Channel, ...]

    def action(self, control: Array) -> Any:
        """Return the action of ``control``; a discrete one is rounded to its nearest level."""
        from gymnasium import spaces

        if isinstance(self.space, spaces.Box):
            return np.asarray(control, dtype=self.space.dtype).reshape(self.space.shape)
        chosen = [
            int(np.abs(np.asarray(channel.levels) - value).argmin())
            for channel, value in zip(self.controls, control, strict=True)
        ]
        if isinstance(self.space, spaces.Discrete):
            return int(self.space.start) + chosen[0]
        first = np.asarray(getattr(self.space, "start", 0))
        return (np.array(chosen) + first).astype(self.space.dtype)


def named_channels(what: str, given: str, channels: tuple[Channel, ...]) -> tuple[Channel, ...]:
    """Return ``channels`` with the names ``given``, separated by commas, each with its unit in brackets if it has one.

    Raises `InvalidArgument` for another number of names.
    """
    found = [NAME.fullmatch(name.strip()) for name in given.split(",")]
    if len(found) != len(channels) or not all(found):
        raise InvalidArgument(
            f"{what}: expected {len(channels)} names, as 'position [m], velocity [m/s]', for "
            f"{', '.join(channel.name for channel in channels)}; got {given!r}"
        )
    return tuple(
        replace(channel, name=match["name"], unit=match["unit"] or channel.unit)
        for match, channel in zip(found, channels, strict=True)
        if match is not None
    )


def _observed(space: gymnasium.Space[Any], place: int) -> Channel:
    """Return an observation as a channel with those limits that are finite and not huge."""
    name = f"observation_{place}"
    low, high = (float(getattr(space, side)[place]) for side in ("low", "high"))
    if not low < high:
        return Channel(name)
    return Channel(name, low=low if low > -LARGEST else -np.inf, high=high if high < LARGEST else np.inf)


def _levels(name: str, n: int, first: int) -> Channel:
    if n < 2:
        raise IncompatibleSystem(f"{name}: expected two or more actions to choose from, got {n}")
    levels = tuple(float(first + i) for i in range(n))
    return Channel(name, levels=levels, neutral=levels[0])


def raw_interface(
    name: str, settings: Mapping[str, Any], angle: str, system: System, scale: Sequence[float]
) -> RawInterface:
    """Return raw observations and actions of the environment ``name`` whose task is bound to ``system``."""
    env = make_environment(name, settings)
    try:
        observations, _ = observation_map(f"environment {name}", env.observation_space, angle)
        values = [RawValue()]
        for i, places in enumerate(observations.places):
            if i not in observations.wrapped:
                values.append(RawValue(places, float(system.neutral_state[i]), float(scale[i])))
            elif len(places) == 2:
                cosine, sine = places
                values += [RawValue((sine, cosine)), RawValue((cosine, sine))]
            else:
                values += [RawValue(places, angle="sine"), RawValue(places, angle="cosine")]
        size = env.observation_space.shape
        assert size is not None
        channels = tuple(_observed(env.observation_space, i) for i in range(size[0]))
        return RawInterface(channels, tuple(values), *_actions(f"environment {name}", env.action_space))
    finally:
        env.close()


def _actions(what: str, space: gymnasium.Space[Any]) -> tuple[tuple[tuple[int, ...] | None, ...], str, tuple[int, ...]]:
    """Return raw actions of the levels of each control, and type and shape of an action."""
    from gymnasium import spaces

    channels = control_channels(what, space)
    raw = tuple(None if channel.levels is None else tuple(map(int, channel.levels)) for channel in channels)
    if isinstance(space, spaces.Discrete):
        return raw, "integer", ()
    assert space.shape is not None
    return raw, "array" if isinstance(space, spaces.Box) else "integers", tuple(int(n) for n in space.shape)


TRIED_STEPS = 200
"""Number of random steps in which angles are found."""
ON_CIRCLE = 1e-6
NEAR_ONE = 0.9


MOVING_SCALES = ("NormalizeObservation", "NormalizeReward")
"""Wrappers with scales that change from step to step, so that the same state looks different later."""


def found_angles(what: str, env: gymnasium.Env[Any, Any]) -> tuple[str, Array]:
    """Return the pairs of observations that are cosine and sine of an angle, in the form of `parse_angles`.

    Also return the observations (N, n) in which they were found. Raises `IncompatibleSystem` if the spaces cannot be
    channels, or if the environment cannot be stepped.

    The squares of a pair add up to 1 in all steps under random actions, and both change. The cosine is the one that is
    near 1 when episodes begin, as of a joint that begins near 0, else the first of the two.
    """
    observation_map(what, env.observation_space, "")
    control_channels(what, env.action_space)
    layer: Any = env
    while layer is not env.unwrapped:
        if (name := type(layer).__name__) in MOVING_SCALES:
            raise IncompatibleSystem(
                f"{what}: {name} changes its scale from step to step: register the environment without it, since "
                "models scale by themselves"
            )
        layer = layer.env
    try:
        env.action_space.seed(0)
        begun = [env.reset(seed=0)[0]]
        later = []
        for step in range(TRIED_STEPS):
            observation, _, ended, late, _ = env.step(env.action_space.sample())
            later.append(observation)
            if ended or late:
                begun.append(env.reset(seed=step + 1)[0])
    except Exception as error:  # an environment may fail in any way
        raise IncompatibleSystem(f"{what}: it cannot be reset and stepped: {described(error)}") from error
    first_values, values = np.mean(begun, axis=0), np.array([*begun, *later], dtype=np.float64)
    free = [i for i in range(values.shape[1]) if np.ptp(values[:, i]) > ON_CIRCLE]
    pairs = []
    while free:
        one = free.pop(0)
        for other in free:
            if np.max(np.abs(np.hypot(values[:, one], values[:, other]) - 1.0)) < ON_CIRCLE:
                free.remove(other)
                cosine, sine = (other, one) if first_values[other] > NEAR_ONE else (one, other)
                pairs.append(f"{cosine},{sine}")
                break
    return "; ".join(pairs), values
