"""What a model makes of sequences of outputs at a task: trials that are only imagined."""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics, clip_state
from sysid_evo.tasks.task import Task, TaskState


class Imagination:
    """Runs trials of a bound ``task`` in ``dynamics``, from where they stand, without noise."""

    def __init__(self, dynamics: Dynamics, task: Task) -> None:
        self.dynamics, self.task = dynamics, task

    def scores(self, states: Array, controls: Array, sequences: Array, task_state: TaskState) -> Array:
        """Return fitness and promise at the end of every sequence, (K, B).

        ``states`` (B, L + 1, nx) and ``controls`` (B, L, nu) are the history of B trials, of which as much is used
        as the model wants; ``sequences`` (K, B, steps, nu) are outputs in [-1, 1]; ``task_state`` has B trials.
        """
        dynamics, task = self.dynamics, self.task
        count, trials, steps, nu = sequences.shape
        lags, nx = dynamics.n_lags, dynamics.system.nx
        legal = task.system.actuate(sequences.reshape(count * trials, steps, nu))
        draws = np.zeros((trials, dynamics.n_draws))
        started = dynamics.start(states[:, len(states[0]) - lags - 1 :], controls[:, len(controls[0]) - lags :], draws)
        carry, here = np.tile(started, (count, 1)), task_state.tile(count)
        lost = np.zeros(len(carry), dtype=bool)
        with np.errstate(all="ignore"):
            for k in range(steps):
                before = carry[:, :nx]
                stepped = dynamics.step(carry, legal[:, k])
                lost |= ~np.isfinite(stepped).all(axis=1)
                stepped, _ = clip_state(np.where(lost[:, None], 0.0, stepped), dynamics.envelope)
                advanced, after = task.advance(here, before, stepped[:, :nx], control=legal[:, k])
                if after is not stepped[:, :nx]:
                    stepped = np.concatenate([after, stepped[:, nx:]], axis=1)
                going = here.alive
                here = advanced if going.all() else here.keep(advanced, going)
                carry = stepped if going.all() else np.where(going[:, None], stepped, carry)
            scores = task.fitness(here) + task.promise(here, carry[:, :nx])
        return np.where(lost, task.worst - 1.0, scores).reshape(count, trials)
