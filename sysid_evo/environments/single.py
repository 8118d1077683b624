"""A model, an ensemble or an emulated robot as one environment of Gymnasium."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np

from sysid_evo.dynamics import Dynamics
from sysid_evo.environments.spaces import Actions, action_space, control_of, metadata_of, observation_space
from sysid_evo.environments.trials import Trials
from sysid_evo.errors import InvalidArgument
from sysid_evo.tasks.task import Task

SEEDS = 2**63


class ModelEnvironment(gymnasium.Env[Any, Any]):
    """An episode is one trial of ``task`` on one of ``members``, drawn anew for each episode.

    The observation is what the task shows a controller, the reward by how much its fitness grows, so that the rewards
    of an episode and the fitness it begins with add up to the fitness. Where the task or a divergence ends the trial it
    is terminated; at the task's horizon it is truncated. ``metadata`` holds names and units; ``info`` the fitness, the
    state, and the member by name. ``seed`` is that of the first reset which is given none.
    """

    def __init__(
        self, members: Mapping[str, Dynamics], task: Task, *, actions: Actions = "auto", seed: int | None = None
    ) -> None:
        self.trials = Trials(members, task, 1)
        self.observation_space = observation_space(self.trials.task)
        self.action_space = action_space(self.trials.system, actions)
        self.metadata = metadata_of(self.trials.task, self.action_space)
        self._first_seed = seed

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin a trial; ``options`` may name the ``member`` that it is on."""
        seed, self._first_seed = self._first_seed if seed is None else seed, None
        super().reset(seed=seed)
        number, trial = drawn(self.np_random, len(self.trials.members))
        if options and "member" in options:
            number = self._number(options["member"])
        self.trials.begin(np.array([0]), np.array([trial]), np.array([number]))
        return self._observation(), self._info()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        control = control_of(self.trials.system, self.action_space, action)
        reward, over, late = self.trials.step(control[None])
        return self._observation(), float(reward[0]), bool(over[0]), bool(late[0]), self._info()

    def _observation(self) -> Any:
        return self.trials.observe()[0].astype(np.float32)

    def _info(self) -> dict[str, Any]:
        trials = self.trials
        return {
            "fitness": float(trials.fitness[0]),
            "member": trials.names[trials.member[0]],
            "state": trials.state[0].copy(),
        }

    def _number(self, member: str) -> int:
        if member not in self.trials.names:
            raise InvalidArgument(f"environment: no member is called {member!r}: {', '.join(self.trials.names)}")
        return self.trials.names.index(member)


def drawn(rng: np.random.Generator, members: int) -> tuple[int, np.uint64]:
    """Return the member of an episode and the seed of its trial."""
    return int(rng.integers(members)), np.uint64(rng.integers(SEEDS))
