"""One environment in the words of this library: states and controls instead of observations and actions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hardware.arguments import number
from hardware.environments.known import KNOWN
from hardware.environments.spaces import ActionMap, ObservationMap, control_channels, named, observation_map
from hardware.session import Session
from sysid_evo.angles import TURN, wrap
from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidArgument
from sysid_evo.system import System

if TYPE_CHECKING:
    import gymnasium

LONGEST_SEED = 2**31


@dataclass(frozen=True)
class Environment:
    """The environment called ``id``, made with ``settings``, and what its numbers are.

    One that is ``settable`` can be put into any state, as the classic ones can: its attribute ``state`` holds them.
    """

    id: str
    settings: Mapping[str, Any]
    system: System
    observations: ObservationMap
    actions: ActionMap
    settable: bool

    @classmethod
    def describe(
        cls, name: str, *, angle: str | None, channels: str, dt: float | None, settings: Mapping[str, Any]
    ) -> Environment:
        """Make the environment once, look at its spaces, and close it. The arguments are those of `GymnasiumRobot`."""
        what, known = f"robot gymnasium({name})", KNOWN.get(name)
        env = make(name, settings)
        try:
            given = known.angle if angle is None and known is not None else angle or ""
            observations, states = observation_map(what, env.observation_space, given)
            controls = control_channels(what, env.action_space)
            if known is not None and given == known.angle:
                states, controls = known.states, known.controls
            if channels:
                states = named(what, channels, states)
            step = _dt(what, env) if dt is None else number(f"{what}: dt", dt, above=0.0)
            system = System(states, controls, step, name=name)
            settable = known is not None or _keeps_its_states(env, observations)
            return cls(name, settings, system, observations, ActionMap(env.action_space, controls), settable)
        finally:
            env.close()

    def open(self) -> EnvironmentSession:
        """Return a session; use it in a ``with`` statement."""
        return EnvironmentSession(self)


class EnvironmentSession(Session):
    """Episodes of one environment, one after the other."""

    def __init__(self, environment: Environment) -> None:
        self._environment = environment
        self._env = make(environment.id, environment.settings)

    def reset(self, seed: int, at: Array | None = None) -> Array:
        """Begin an episode and return its first state (nx,); ``at`` puts one that is settable into that state."""
        observation, _ = self._env.reset(seed=int(seed) % LONGEST_SEED)
        if at is None:
            return self._environment.observations.state(observation)
        inner: Any = self._env.unwrapped
        inner.state = np.array(at, dtype=np.float64)
        return np.array(at, dtype=np.float64)

    def step(self, control: Array) -> tuple[Array, float, bool, bool]:
        """Return the next state (nx,), the reward, whether the episode ended there, and whether its time is up."""
        action = self._environment.actions.action(control)
        observation, reward, ended, late, _ = self._env.step(action)
        return self._environment.observations.state(observation), float(reward), bool(ended), bool(late)

    def close(self) -> None:
        self._env.close()


def make(name: str, settings: Mapping[str, Any]) -> gymnasium.Env[Any, Any]:
    """Return the environment called ``name``. Raises `InvalidArgument` that says why there is none."""
    import gymnasium

    try:
        return gymnasium.make(name, disable_env_checker=True, **settings)
    except (gymnasium.error.Error, ImportError, TypeError, ValueError) as error:
        raise InvalidArgument(f"robot gymnasium: no environment can be made of {name!r}: {error}") from error


def _keeps_its_states(env: gymnasium.Env[Any, Any], observations: ObservationMap) -> bool:
    """Whether its attribute ``state`` holds the states that it shows, so that it can be put into any."""
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
    """Return the time of a step as the environment says it: ``dt``, ``tau``, or one picture of its drawing."""
    inner = env.unwrapped
    rate = (inner.metadata or {}).get("render_fps")
    for value in (getattr(inner, "dt", None), getattr(inner, "tau", None), 1.0 / rate if rate else None):
        if isinstance(value, int | float) and math.isfinite(value) and value > 0.0:
            return float(value)
    raise InvalidArgument(f"{what}: the environment does not say how long a step is; give dt=..., in s")
