"""Gymnasium environments as simulators: spaces to channels, names of the classic ones, the robot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hardware.arguments import check_number, check_text
from hardware.simulators.gymnasium_spaces import (
    ActionMap,
    ObservationMap,
    control_channels,
    found_angles,
    make_environment,
    named_channels,
    observation_map,
)
from hardware.simulators.gymnasium_state import AttributeState, StateSetter, state_setter
from hardware.simulators.simulator import LONGEST_SEED, ExternalSimulator, SimulatorSession
from hardware.simulators.simulator_robot import SimulatorRobot
from sysid_evo.angles import TURN
from sysid_evo.extras import check_installed
from sysid_evo.registry import Spec, register_robot
from sysid_evo.system import Channel, System
from sysid_evo.types import Array

if TYPE_CHECKING:
    import gymnasium


@register_robot("gymnasium")
class GymnasiumRobot(SimulatorRobot):
    """An environment of Gymnasium, by its ``id``.

    The states are its observations: a Box of numbers in a row. ``angle`` names those that are angles, so that they
    become one periodic state: ``"0,1"`` for a cosine and its sine, ``"2"`` for an angle in rad, several separated by
    semicolons. By default pairs of a cosine and a sine are found; ``""`` is for none. ``channels`` names the states and
    ``controls`` the controls, with units in brackets: ``"angle [rad], speed [rad/s]"``, ``"force [N]"``. ``dt`` (s) is
    the time from one step to the next, by default that of the environment, or 0.05 s if it defines none. The classic
    environments have names, units and angles already. ``settings`` is a table of further arguments of `gymnasium.make`.

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
        angle, settings = None if angle is None else str(angle), dict(settings or {})
        further = ({} if angle is None else {"angle": angle}) | ({"settings": settings} if settings else {})
        inside = Spec("", further).text.removeprefix("(").removesuffix(")")
        self.default_task = f'environment(id="{id}"{", " if further else ""}{inside})'
        what, known = f"robot gymnasium({id})", KNOWN.get(id)
        env = make_environment(id, settings)
        try:
            found, seen = found_angles(what, env) if known is None else (known.angle, np.empty(0))
            given = found if angle is None else angle
            observations, states = observation_map(what, env.observation_space, given)
            if known is None:
                states = tuple(_reached(*one) for one in zip(states, observations.state(seen).T, strict=True))
            actions = control_channels(what, env.action_space)
            if known is not None and given == known.angle:
                states, actions = known.states, known.controls
            if channels:
                states = named_channels(f"{what}: channels", channels, states)
            if controls:
                actions = named_channels(f"{what}: controls", controls, actions)
            step = _dt(env) if dt is None else check_number(f"{what}: dt", dt, above=0.0)
            system = System(states, actions, step, name=id)
            way = AttributeState() if known is not None else state_setter(id, settings, observations)
            setter = way if isinstance(way, StateSetter) else None
            taken = ActionMap(env.action_space, actions)
            settable = setter is not None
            super().__init__(GymnasiumSimulator(id, settings, system, observations, taken, setter, settable))
        finally:
            env.close()


@dataclass(frozen=True)
class GymnasiumSimulator(ExternalSimulator):
    """The environment called ``name``, made with ``settings``: states and controls for observations and actions.

    A ``settable`` one can be put into any state by its ``setter``, see `state_setter`.
    """

    name: str
    settings: Mapping[str, Any]
    system: System
    observations: ObservationMap
    actions: ActionMap
    setter: StateSetter | None
    settable: bool
    rewarded: ClassVar[bool] = True

    def open(self) -> GymnasiumSession:
        return GymnasiumSession(self)


class GymnasiumSession(SimulatorSession):
    """Episodes of one environment, one after the other."""

    def __init__(self, environment: GymnasiumSimulator) -> None:
        self._environment = environment
        self._env = make_environment(environment.name, environment.settings)

    def reset(self, seed: int, at: Array | None = None) -> Array:
        observation, _ = self._env.reset(seed=int(seed) % LONGEST_SEED)
        setter = self._environment.setter
        if at is None or setter is None:
            return self._environment.observations.state(observation)
        setter.put(self._env, at)
        return np.array(at, dtype=np.float64)

    def step(self, control: Array) -> tuple[Array, float, bool, bool]:
        action = self._environment.actions.action(control)
        observation, reward, ended, late, _ = self._env.step(action)
        state = self._environment.observations.state(observation)
        return state, float(np.asarray(reward).item()), bool(ended), bool(late)

    def close(self) -> None:
        self._env.close()


def _reached(channel: Channel, values: Array) -> Channel:
    """Return ``channel`` without limits that some of ``values`` exceed; many a space is narrower than it should be."""
    slack = 1e-3 * (channel.high - channel.low)
    inside = not np.any((values < channel.low - slack) | (values > channel.high + slack))
    return channel if inside or channel.period is not None else replace(channel, low=-np.inf, high=np.inf)


USUAL_DT = 0.05
"""Time of a step (s) of an environment that does not define it."""


def _dt(env: gymnasium.Env[Any, Any]) -> float:
    """Return the time of a step: ``dt``, ``tau``, or one frame of its rendering; `USUAL_DT` if it has none of these."""
    inner = env.unwrapped
    rate = (inner.metadata or {}).get("render_fps")
    for value in (getattr(inner, "dt", None), getattr(inner, "tau", None), 1.0 / rate if rate else None):
        if isinstance(value, int | float) and math.isfinite(value) and value > 0.0:
            return float(value)
    return USUAL_DT


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
