"""Putting a Gymnasium environment into a state: the ways that it offers, found by trying, checked by stepping."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from hardware.simulators.gymnasium_spaces import ObservationMap, make_environment
from sysid_evo.angles import TURN, wrap
from sysid_evo.types import Array

if TYPE_CHECKING:
    import gymnasium


class StateSetter(ABC):
    """A way to put an environment into a state."""

    @abstractmethod
    def put(self, env: gymnasium.Env[Any, Any], state: Array) -> None:
        """Put ``env``, which has been reset, into ``state`` (nx,)."""


@dataclass(frozen=True)
class AttributeState(StateSetter):
    """The attribute ``state`` holds the states."""

    def put(self, env: gymnasium.Env[Any, Any], state: Array) -> None:
        inner: Any = env.unwrapped
        inner.state = np.array(state, dtype=np.float64)


@dataclass(frozen=True)
class MethodState(StateSetter):
    """The method ``set_state`` takes the states, which ``get_state`` returns."""

    def put(self, env: gymnasium.Env[Any, Any], state: Array) -> None:
        inner: Any = env.unwrapped
        inner.set_state(np.array(state, dtype=np.float64))


@dataclass(frozen=True)
class Coordinate:
    """One coordinate of a simulation: a state plus ``value``, the angle of a sine and a cosine, or ``value`` alone."""

    places: tuple[int, ...]
    value: float = 0.0

    def of(self, state: Array) -> float:
        """Return its value in ``state`` (nx,)."""
        if len(self.places) == 2:
            return float(np.arctan2(state[self.places[0]], state[self.places[1]]))
        return self.value + (float(state[self.places[0]]) if self.places else 0.0)


@dataclass(frozen=True)
class MujocoState(StateSetter):
    """Positions and velocities of a MuJoCo simulation, each computed from the states."""

    positions: tuple[Coordinate, ...]
    velocities: tuple[Coordinate, ...]

    def put(self, env: gymnasium.Env[Any, Any], state: Array) -> None:
        inner: Any = env.unwrapped
        inner.set_state(*(np.array([one.of(state) for one in part]) for part in (self.positions, self.velocities)))


STEPS, EPISODE = 100, 20
"""Number of random steps on which a way is tried, and of those after which another episode begins.

Of several, since what is drawn when an episode begins is constant in it.
"""
CLOSE = 1e-3
"""Largest error of a state and of a reward, as a share of their ranges in the trial."""


def state_setter(name: str, settings: Mapping[str, Any], observations: ObservationMap) -> StateSetter | str:
    """Return the way to put the environment ``name`` into a state, or the reason why there is none, as a sentence.

    A way counts if the environment, put into the state of each of some random steps, makes the same step: the same
    next state, reward and end.
    """
    return _found(name, observations, KeptSettings.of(settings))


@dataclass(frozen=True)
class KeptSettings:
    """Settings of an environment with a ``key``, by which results of trying it are kept."""

    key: str
    values: Mapping[str, Any] = field(compare=False)

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> KeptSettings:
        """Return ``settings`` with their text as the key."""
        return cls(json.dumps(dict(settings), sort_keys=True, default=str), dict(settings))


@dataclass(frozen=True)
class RandomStep:
    """A step of an environment under a random action; ``inside`` are values of its simulation before it."""

    before: Array
    action: Any
    after: Array
    reward: float
    ended: bool
    late: bool
    inside: Array


def random_steps(
    env: gymnasium.Env[Any, Any], observations: ObservationMap, count: int, longest: int | None = None
) -> Iterator[RandomStep]:
    """Yield ``count`` steps under random actions, over as many episodes as needed, of at most ``longest`` steps."""
    env.action_space.seed(0)
    rng = np.random.default_rng(0)
    observation, _ = env.reset(seed=0)
    for step in range(1, count + 1):
        before, inside, action = observations.state(observation), _inside(env), env.action_space.sample()
        observation, reward, ended, late, _ = env.step(action)
        yield RandomStep(
            before,
            action,
            observations.state(observation),
            float(np.asarray(reward).item()),
            bool(ended),
            bool(late),
            inside,
        )
        if ended or late or (longest is not None and step % longest == 0):
            observation, _ = env.reset(seed=int(rng.integers(2**31)))


def _inside(env: gymnasium.Env[Any, Any]) -> Array:
    """Return positions and velocities of a MuJoCo simulation; nothing for another one."""
    data: Any = getattr(env.unwrapped, "data", None)
    if data is None or not (hasattr(data, "qpos") and hasattr(data, "qvel")):
        return np.zeros(0)
    return np.concatenate([data.qpos, data.qvel]).astype(np.float64)


@lru_cache(maxsize=64)
def _found(name: str, observations: ObservationMap, settings: KeptSettings) -> StateSetter | str:
    env, twin = (make_environment(name, settings.values) for _ in range(2))
    try:
        steps = list(random_steps(env, observations, STEPS, EPISODE))
        ways = _ways(env, steps, observations)
        if not ways:
            return f"{name} has no attribute state with its states, no get_state and set_state, and no MuJoCo data"
        twin.reset(seed=1)
        for way in ways:
            if _makes_the_same_steps(way, twin, steps, observations):
                return way
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:  # of the environment
        return f"{name} cannot be put into a state: {type(error).__name__}: {error}"
    finally:
        env.close()
        twin.close()
    return f"{name}, put into the same state, continued differently: it depends on more than its observations"


def _ways(env: gymnasium.Env[Any, Any], steps: Sequence[RandomStep], observations: ObservationMap) -> list[StateSetter]:
    """Return the ways that ``env`` seems to offer."""
    inner: Any = env.unwrapped
    nx, found = len(steps[0].before), list[StateSetter]()
    kept: Any = getattr(inner, "state", None)
    if np.shape(kept) == (nx,):
        found.append(AttributeState())
    get, put = (getattr(inner, name, None) for name in ("get_state", "set_state"))
    if callable(get) and callable(put) and np.shape(get()) == (nx,):
        found.append(MethodState())
    if callable(put) and len(steps[0].inside):
        size = len(inner.data.qpos)
        values, states = np.array([one.inside for one in steps]), np.array([one.before for one in steps])
        coordinates = tuple(_coordinate(column, states, observations.wrapped) for column in values.T)
        found.append(MujocoState(coordinates[:size], coordinates[size:]))
    return found


EXACT = 1e-5
MATCHING = 0.9
"""Share of the steps in which a state must give the coordinate; an observation may be clipped in others."""


def _coordinate(values: Array, states: Array, wrapped: frozenset[int]) -> Coordinate:
    """Return how ``values`` (N,) of a coordinate follow from ``states`` (N, nx); the first value if they do not."""
    if np.ptp(values) == 0.0:
        return Coordinate((), float(values[0]))
    for place, column in enumerate(states.T):
        if place in wrapped:
            off, between = wrap(column - values, TURN), 0.0
        else:
            between = float(np.median(values - column))  # as of a body whose joint has its zero elsewhere
            off = column + between - values
        if np.mean(np.abs(off) < EXACT) >= MATCHING:
            return Coordinate((place,), between if abs(between) >= EXACT else 0.0)
    for sine, one in enumerate(states.T):
        for cosine, other in enumerate(states.T):
            if sine != cosine and np.mean(np.abs(wrap(np.arctan2(one, other) - values, TURN)) < EXACT) >= MATCHING:
                return Coordinate((sine, cosine))
    return Coordinate((), float(values[0]))


def _makes_the_same_steps(
    way: StateSetter, env: gymnasium.Env[Any, Any], steps: Sequence[RandomStep], observations: ObservationMap
) -> bool:
    after, rewards = np.array([one.after for one in steps]), np.array([one.reward for one in steps])
    allowed, of_reward = CLOSE * (np.ptp(after, axis=0) + EXACT), CLOSE * (np.ptp(rewards) + EXACT)
    for one in reversed(steps):  # in another order, so that hidden memory would show
        way.put(env, one.before)
        observation, reward, ended, late, _ = env.step(one.action)
        off = observations.state(observation) - one.after
        for place in observations.wrapped:
            off[place] = wrap(off[place], TURN)
        if (np.abs(off) > allowed).any() or abs(float(reward) - one.reward) > of_reward or bool(ended) != one.ended:
            return False
        if ended or late:
            env.reset(seed=1)
    return True
