"""Many trials of a model, an ensemble or an emulated robot as one vector environment, all stepped at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from sysid_evo.arrays import Array, BoolArray
from sysid_evo.dynamics import Dynamics
from sysid_evo.environments.single import drawn
from sysid_evo.environments.spaces import Actions, action_space, control_of, metadata_of, observation_space
from sysid_evo.environments.trials import Trials
from sysid_evo.errors import InvalidArgument
from sysid_evo.tasks.task import Task


class ModelVectorEnvironment(VectorEnv[Any, Any, Any]):
    """``num_envs`` copies of a `ModelEnvironment` that are stepped in one call of the dynamics.

    Number i behaves as a single one that was reset with the seed of number i. One whose episode has ended begins
    anew at its next step, whose action is not used.
    """

    def __init__(
        self,
        members: Mapping[str, Dynamics],
        task: Task,
        num_envs: int,
        *,
        actions: Actions = "auto",
        seed: int | None = None,
    ) -> None:
        super().__init__()
        self.num_envs = num_envs
        self.trials = Trials(members, task, num_envs)
        self.single_observation_space = observation_space(self.trials.task)
        self.single_action_space = action_space(self.trials.system, actions)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.metadata = {
            **metadata_of(self.trials.task, self.single_action_space),
            "autoreset_mode": AutoresetMode.NEXT_STEP,
        }
        self._first_seed = seed
        self._generators: list[np.random.Generator] = []
        self._ended = np.zeros(num_envs, dtype=bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin all trials; from the number ``seed`` the copies get ``seed``, ``seed`` + 1, and so on."""
        seed, self._first_seed = self._first_seed if seed is None else seed, None
        given = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed
        if given is not None and len(given) != self.num_envs:
            raise InvalidArgument(f"environment: expected {self.num_envs} seeds, got {len(given)}")
        for i, own in enumerate(given or [None] * self.num_envs):
            if i >= len(self._generators):
                self._generators.append(seeding.np_random(own)[0])
            elif own is not None:
                self._generators[i] = seeding.np_random(own)[0]
        self.restart(np.ones(self.num_envs, dtype=bool))
        return self.observations(), self._info()

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        restarting = self._ended
        reward, over, late = self.trials.step(self._controls(actions))
        if restarting.any():
            self.restart(restarting)
            reward, over, late = (np.where(restarting, 0, values) for values in (reward, over, late))
        over, late = over.astype(bool), late.astype(bool)
        self._ended = over | late
        return self.observations(), reward, over, late, self._info()

    def _controls(self, actions: Any) -> Array:
        return control_of(self.trials.system, self.single_action_space, actions, (self.num_envs,))

    def restart(self, which: BoolArray) -> None:
        """Begin a new episode in the copies ``which`` (num_envs,), before they would do so themselves."""
        rows = np.flatnonzero(which)
        picks = [drawn(self._generators[row], len(self.trials.members)) for row in rows]
        self.trials.begin(rows, np.array([seed for _, seed in picks]), np.array([number for number, _ in picks]))
        self._ended = self._ended & ~which

    def observations(self) -> Any:
        """Return what is to be seen in all copies now, (num_envs, n)."""
        return self.trials.observe().astype(np.float32)

    def _info(self) -> dict[str, Any]:
        everyone = np.ones(self.num_envs, dtype=bool)
        return {"fitness": self.trials.fitness.copy(), "_fitness": everyone}
