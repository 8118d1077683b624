"""What an environment itself rewards in any state: it is put there, and asked to step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hardware.environments.environment import make
from hardware.environments.spaces import ActionMap, control_channels
from sysid_evo.arrays import Array, BoolArray
from sysid_evo.errors import IncompatibleTask

if TYPE_CHECKING:
    import gymnasium

    from sysid_evo.system import Channel

TRIED = 400
"""Random steps from which the lowest reward and the size of the states are taken."""
LONGEST = 500
"""Steps of a trial where the environment has no end of its time."""


@dataclass(frozen=True)
class Asked:
    """The environment called ``id``, whose attribute ``state`` (n,) holds all that its steps depend on.

    ``least`` is the lowest reward of some hundred random steps, and a tenth of their range less; ``scale`` (n,) how
    far its states went; ``horizon`` the steps after which its time is up.
    """

    id: str
    least: float
    scale: tuple[float, ...]
    horizon: int
    environment: gymnasium.Env[Any, Any]

    @classmethod
    def of(cls, name: str) -> Asked:
        """Try the environment called ``name``. Raises `IncompatibleTask` if its reward cannot be asked for."""
        env = make(name, {})
        inner: Any = env.unwrapped
        rng = np.random.default_rng(0)
        env.action_space.seed(0)
        env.reset(seed=0)
        kept: Any = getattr(inner, "state", None)
        if kept is None or np.ndim(kept) != 1:
            raise IncompatibleTask(
                f"task environment: {name} has no attribute state, a row of numbers into which it could be put, so "
                "that its reward cannot be computed. Write it as a function: register_reward"
            )
        rewards, seen = [], []
        for _ in range(TRIED):
            before, action = np.array(inner.state, dtype=np.float64), env.action_space.sample()
            seen.append(before)
            first, again = (_stepped(inner, before, action) for _ in range(2))
            if not np.array_equal(first, again):
                raise IncompatibleTask(
                    f"task environment: {name}, put twice into one state, went on in two ways: its state is not all "
                    "that it depends on, so that its reward cannot be computed. Write it as a function: register_reward"
                )
            rewards.append(float(first[-2]))
            if first[-1]:
                env.reset(seed=int(rng.integers(2**31)))
        spread = np.ptp(np.array(seen), axis=0)
        spec = env.spec
        horizon = LONGEST if spec is None or spec.max_episode_steps is None else spec.max_episode_steps
        least = min(rewards) - 0.1 * (max(rewards) - min(rewards))
        return cls(name, least, tuple(np.where(spread > 0.0, spread, 1.0).tolist()), horizon, env)

    def judge(self, before: Array, control: Array, controls: tuple[Channel, ...]) -> tuple[Array, BoolArray]:
        """Return the rewards (B,) of steps from states (B, n) under controls (B, nu), and which were the last."""
        actions = ActionMap(self.environment.action_space, controls)
        inner: Any = self.environment.unwrapped
        told = [_stepped(inner, x, actions.action(u))[-2:] for x, u in zip(before, control, strict=True)]
        rewards, over = np.array(told, dtype=np.float64).reshape(-1, 2).T
        return np.where(rewards >= self.least, rewards, self.least), over > 0.0

    @property
    def controls(self) -> tuple[Channel, ...]:
        """Its actions as channels, by whatever names."""
        return control_channels(f"task environment: {self.id}", self.environment.action_space)


def _stepped(inner: Any, state: Array, action: Any) -> Array:
    """Return the next state, the reward, and whether it was the last step, of an environment put into ``state``."""
    inner.state = np.array(state, dtype=np.float64)
    _, reward, ended, _, _ = inner.step(action)
    return np.array([*np.ravel(inner.state), float(reward), float(ended)], dtype=np.float64)
