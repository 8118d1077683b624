"""A small environment that no table knows: a rotor whose angle comes round, and which breaks when it turns too fast."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces

NAME = "Rotor-v0"
BREAKS = 2.95


class Rotor(gymnasium.Env[Any, Any]):
    """Observes speed (rad/s), cosine and sine of the angle; the action is its acceleration."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": [], "render_fps": 10}

    def __init__(self, actions: str = "box", limit: float = 1.0, bad: bool = False) -> None:
        high = np.array([np.inf, 1.0, 1.0], dtype=np.float32)
        self.observation_space = spaces.Box(-high, high)
        self.actions, self.bad = actions, bad
        self.action_space: spaces.Space[Any] = {
            "box": spaces.Box(-limit, limit, (1,)),
            "discrete": spaces.Discrete(3, start=-1),
            "several": spaces.MultiDiscrete([3, 2]),
            "binary": spaces.MultiBinary(2),
        }[actions]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.angle, self.speed = self.np_random.uniform(-3.0, 3.0), 0.0
        return self._observed(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.given = action
        self.speed += 0.1 * float(np.ravel(action)[0])
        self.angle += 0.1 * self.speed
        return self._observed(), -(self.speed**2), abs(self.speed) > BREAKS, False, {}

    def _observed(self) -> Any:
        value = np.nan if self.bad and self.speed > 0.5 else self.speed
        return np.array([value, np.cos(self.angle), np.sin(self.angle)], dtype=np.float32)


def register() -> None:
    """Make it known to Gymnasium, once."""
    if NAME not in gymnasium.registry:
        gymnasium.register(NAME, entry_point=Rotor, max_episode_steps=50)
