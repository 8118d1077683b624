"""Gymnasium environments as simulators: spaces to channels, names of the classic ones, the robot."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from hardware.arguments import check_number, check_text
from hardware.simulators.simulator import LONGEST_SEED, ExternalSimulator, SimulatorSession
from hardware.simulators.simulator_robot import SimulatorRobot
from sysid_evo.angles import TURN, wrap
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.extras import check_installed
from sysid_evo.registry import register_robot
from sysid_evo.system import Channel, System
from sysid_evo.types import Array

if TYPE_CHECKING:
    import gymnasium


@register_robot("gymnasium")
class GymnasiumRobot(SimulatorRobot):
    """An environment of Gymnasium, by its ``id``.

    The states are its observations: a Box of numbers in a row. ``angle`` names those that are angles, so that they
    become one periodic state: ``"0,1"`` for a cosine and its sine, ``"2"`` for an angle in rad, several separated by
    semicolons. ``channels`` names the states and ``controls`` the controls, with units in brackets:
    ``"angle [rad], speed [rad/s]"``, ``"force [N]"``. ``dt`` (s) is the time from one step to the next, by default
    that of the environment. The classic environments have names, units and angles already. ``settings`` is a table of
    further arguments of `gymnasium.make`.

    An environment of another package is named ``"package:Name-v0"``. Raises `InvalidArgument` if there is no such
    environment, `IncompatibleSystem` if its spaces cannot be states and controls, `MissingExtra`.
    """

    requires: ClassVar[tuple[str, ...]] = ("gymnasium",)
    simulator: GymnasiumSimulator

    def __init__(
        self,
        *,
        id: str = "Pendulum-v1",  # noqa: A002  # as Gymnasium calls it
        angle: str | int | None = None,
        channels: str = "",
        controls: str = "",
        dt: float | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        check_text("robot gymnasium: id", id)
        check_installed("robot 'gymnasium'", self.requires)
        angle = None if angle is None else str(angle)
        self.default_task = f'environment(id="{id}")'
        super().__init__(
            GymnasiumSimulator.describe(
                id, angle=angle, channels=channels, controls=controls, dt=dt, settings=dict(settings or {})
            )
        )


@dataclass(frozen=True)
class GymnasiumSimulator(ExternalSimulator):
    """The environment called ``name``, made with ``settings``: states and controls for observations and actions.

    A ``settable`` one can be put into any state, like the classic ones: its attribute ``state`` holds all states.
    """

    name: str
    settings: Mapping[str, Any]
    system: System
    observations: ObservationMap
    actions: ActionMap
    settable: bool

    @classmethod
    def describe(
        cls,
        name: str,
        *,
        angle: str | None,
        channels: str,
        controls: str,
        dt: float | None,
        settings: Mapping[str, Any],
    ) -> GymnasiumSimulator:
        """Make the environment once, read its spaces, and close it. The arguments are those of `GymnasiumRobot`."""
        what, known = f"robot gymnasium({name})", KNOWN.get(name)
        env = make_environment(name, settings)
        try:
            given = known.angle if angle is None and known is not None else angle or ""
            observations, states = observation_map(what, env.observation_space, given)
            actions = control_channels(what, env.action_space)
            if known is not None and given == known.angle:
                states, actions = known.states, known.controls
            if channels:
                states = named_channels(f"{what}: channels", channels, states)
            if controls:
                actions = named_channels(f"{what}: controls", controls, actions)
            step = _dt(what, env) if dt is None else check_number(f"{what}: dt", dt, above=0.0)
            system = System(states, actions, step, name=name)
            settable = known is not None or _keeps_its_states(env, observations)
            return cls(name, settings, system, observations, ActionMap(env.action_space, actions), settable)
        finally:
            env.close()

    def open(self) -> GymnasiumSession:
        return GymnasiumSession(self)


class GymnasiumSession(SimulatorSession):
    """Episodes of one environment, one after the other."""

    def __init__(self, environment: GymnasiumSimulator) -> None:
        self._environment = environment
        self._env = make_environment(environment.name, environment.settings)

    def reset(self, seed: int, at: Array | None = None) -> Array:
        observation, _ = self._env.reset(seed=int(seed) % LONGEST_SEED)
        if at is None:
            return self._environment.observations.state(observation)
        inner: Any = self._env.unwrapped
        inner.state = np.array(at, dtype=np.float64)
        return np.array(at, dtype=np.float64)

    def step(self, control: Array) -> tuple[Array, float, bool, bool]:
        action = self._environment.actions.action(control)
        observation, reward, ended, late, _ = self._env.step(action)
        return self._environment.observations.state(observation), float(reward), bool(ended), bool(late)

    def close(self) -> None:
        self._env.close()


def make_environment(name: str, settings: Mapping[str, Any]) -> gymnasium.Env[Any, Any]:
    """Return the environment called ``name``. Raises `InvalidArgument` with the reason if there is none."""
    import gymnasium

    try:
        return gymnasium.make(name, disable_env_checker=True, **settings)
    except (gymnasium.error.Error, ImportError, TypeError, ValueError) as error:
        raise InvalidArgument(f"robot gymnasium: cannot make the environment {name!r}: {error}") from error


def _keeps_its_states(env: gymnasium.Env[Any, Any], observations: ObservationMap) -> bool:
    """Whether its attribute ``state`` holds its states, so that it can be put into any."""
    observation, _ = env.reset(seed=0)
    kept: Any = getattr(env.unwrapped, "state", None)
    shown = observations.state(observation)
    if kept is None or np.shape(kept) != shown.shape:
        return False
    off = np.asarray(kept, dtype=np.float64) - shown
    for place in observations.wrapped:
        off[place] = wrap(off[place], TURN)
    return bool(np.allclose(off, 0.0, atol=1e-5))


def _dt(what: str, env: gymnasium.Env[Any, Any]) -> float:
    """Return the time of a step from the environment: ``dt``, ``tau``, or one frame of its rendering."""
    inner = env.unwrapped
    rate = (inner.metadata or {}).get("render_fps")
    for value in (getattr(inner, "dt", None), getattr(inner, "tau", None), 1.0 / rate if rate else None):
        if isinstance(value, int | float) and math.isfinite(value) and value > 0.0:
            return float(value)
    raise InvalidArgument(f"{what}: the environment does not define the time of a step; give dt=..., in s")


@dataclass(frozen=True)
class KnownEnvironment:
    """Properties that the spaces of an environment do not contain.

    ``states`` and ``controls`` are its channels, ``scale`` is the range of the states; ``angle`` names the observations
    that are angles, see `parse_angles`. ``env.unwrapped.state`` has the same numbers in the same order, so that a trial
    can begin anywhere.
    """

    states: tuple[Channel, ...]
    controls: tuple[Channel, ...]
    scale: tuple[float, ...]
    angle: str = ""


CART = KnownEnvironment(
    states=(
        Channel("position", "m", -4.8, 4.8),
        Channel("speed", "m/s"),
        Channel("angle", "rad", -0.42, 0.42, description="0 upright, positive leans towards larger positions"),
        Channel("angular_speed", "rad/s"),
    ),
    controls=(Channel("force", "N", levels=(-10.0, 10.0)),),
    scale=(2.4, 3.0, 0.21, 3.0),
)
HILL = (
    Channel("position", low=-1.2, high=0.6, neutral=-math.pi / 6.0),
    Channel("speed", low=-0.07, high=0.07),
)
HILL_SCALE = (0.9, 0.07)
PUSHES = (-1.0, 0.0, 1.0)

KNOWN: Mapping[str, KnownEnvironment] = {
    "Pendulum-v1": KnownEnvironment(
        states=(
            Channel("angle", "rad", neutral=math.pi, period=TURN, description="0 upright, positive counter-clockwise"),
            Channel("angular_speed", "rad/s", -8.0, 8.0),
        ),
        controls=(Channel("torque", "N m", -2.0, 2.0),),
        scale=(1.0, 1.0),
        angle="0,1",
    ),
    "CartPole-v0": CART,
    "CartPole-v1": CART,
    "MountainCar-v0": KnownEnvironment(HILL, (Channel("force", levels=PUSHES),), HILL_SCALE),
    "MountainCarContinuous-v0": KnownEnvironment(HILL, (Channel("force", low=-1.0, high=1.0),), HILL_SCALE),
    "Acrobot-v1": KnownEnvironment(
        states=(
            Channel("angle_1", "rad", period=TURN, description="0 hanging"),
            Channel("angle_2", "rad", period=TURN, description="of the second link to the first, 0 in line"),
            Channel("angular_speed_1", "rad/s"),
            Channel("angular_speed_2", "rad/s"),
        ),
        controls=(Channel("torque", "N m", levels=PUSHES),),
        scale=(1.0, 1.0, 4.0 * math.pi, 9.0 * math.pi),
        angle="0,1; 2,3",
    ),
}
"""By the environment's id. The upright pendulum and cart-pole have angle 0; the hanging acrobot has."""

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
        raise IncompatibleSystem(
            f"{what}: expected a Box of at most {MOST} observations in a row, got {space}. "
            "Wrap the environment, for example in gymnasium.wrappers.FlattenObservation, and register that"
        )
    n = int(space.shape[0])
    groups = parse_angles(what, angle, n)
    grouped = {min(group): group for group in groups}
    inside = {number for group in groups for number in group}
    places = tuple(grouped.get(i, (i,)) for i in range(n) if i in grouped or i not in inside)
    wrapped = frozenset(k for k, place in enumerate(places) if place in groups)
    return ObservationMap(places, wrapped), tuple(
        Channel(f"angle_{place[0]}", "rad", period=TURN)
        if k in wrapped
        else _limited(f"observation_{place[0]}", float(space.low[place[0]]), float(space.high[place[0]]))
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
    if isinstance(space, spaces.Box) and np.isfinite(space.low).all() and np.isfinite(space.high).all():
        low, high = space.low.ravel().tolist(), space.high.ravel().tolist()
        names = ["control"] if len(low) == 1 else [f"control_{i}" for i in range(len(low))]
        return tuple(Channel(name, low=a, high=b) for name, a, b in zip(names, low, high, strict=True))
    raise IncompatibleSystem(
        f"{what}: expected discrete actions or a Box of them with finite limits, got {space}. "
        "Wrap the environment, for example in gymnasium.wrappers.RescaleAction, and register that"
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


def _limited(name: str, low: float, high: float) -> Channel:
    """Return a channel with those limits that are finite and not huge."""
    if not low < high:
        return Channel(name)
    return Channel(name, low=low if low > -LARGEST else -np.inf, high=high if high < LARGEST else np.inf)


def _levels(name: str, n: int, first: int) -> Channel:
    if n < 2:
        raise IncompatibleSystem(f"{name}: expected two or more actions to choose from, got {n}")
    levels = tuple(float(first + i) for i in range(n))
    return Channel(name, levels=levels, neutral=levels[0])
