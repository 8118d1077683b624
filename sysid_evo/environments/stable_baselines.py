"""Vector environments of models for Stable-Baselines3."""

from __future__ import annotations

from typing import Any

import numpy as np

from sysid_evo.environments.environments import ModelVectorEnvironment
from sysid_evo.extras import missing_extra

try:
    from stable_baselines3.common.vec_env import VecEnv
except ModuleNotFoundError as error:
    raise missing_extra("an environment for Stable-Baselines3", error.name) from error


class StableBaselinesEnv(VecEnv):
    """The environment of `make_vector_env` for Stable-Baselines3; a copy whose episode ended is reset at once.

    ``infos`` holds the last observation of an episode as ``terminal_observation``, its reward and length as
    ``episode``.
    """

    def __init__(self, env: ModelVectorEnvironment) -> None:
        self.env, self.rewards = env, np.zeros(env.num_envs)  # used by the constructor of the base
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.lengths = np.zeros(env.num_envs, dtype=int)

    def reset(self) -> Any:
        given, self._seeds = self._seeds, [None] * self.num_envs  # set by `seed`
        self.rewards[:], self.lengths[:] = 0.0, 0
        return self.env.reset(seed=None if None in given else given)[0]

    def step_async(self, actions: Any) -> None:
        self.actions = actions

    def step_wait(self) -> Any:
        observation, reward, terminated, truncated, _ = self.env.step(self.actions)
        ended = terminated | truncated
        self.rewards, self.lengths = self.rewards + reward, self.lengths + 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if ended.any():
            for i in np.flatnonzero(ended):
                infos[i] = {
                    "terminal_observation": observation[i].copy(),
                    "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                    "episode": {"r": self.rewards[i], "l": self.lengths[i], "t": 0.0},
                }
            self.rewards[ended], self.lengths[ended] = 0.0, 0
            self.env.restart(ended)
            observation = np.where(ended[:, None], self.env.observations(), observation)
        return observation, reward.astype(np.float32), ended, infos

    def close(self) -> None:
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self.env, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *arguments: Any, indices: Any = None, **named: Any) -> list[Any]:
        return [getattr(self.env, method_name)(*arguments, **named)]

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs
