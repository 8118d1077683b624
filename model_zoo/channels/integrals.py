"""States that only add up what others do: positions, and whatever else no value of its own pulls back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from model_zoo.channels.standard import deviation
from sysid_evo.arrays import Array, BoolArray
from sysid_evo.data import Dataset

if TYPE_CHECKING:
    from sysid_evo.engine.kernels import Predictor

OWN = 0.005
"""Share of the deviation of a state's change up to which its own value does not count in it."""


@dataclass(frozen=True)
class Integrals:
    """Which states a prediction is added to (nx,), because it is their change, and their ``reach`` (2, nx).

    A prediction of the next state from inputs clipped to the training range is a wall at the end of that range. For a
    speed that drag holds back that is a good guess. A position runs on: nothing in the data says that it would not,
    and a controller that is evolved in the model leans on the wall. So the change is predicted of an *integral*:
    a state of whose change its own value explains nothing (linear and quadratic, beside all other states and
    controls). It goes on as far as the limits of its channel. Of a periodic state the change is predicted, too.
    """

    added: BoolArray
    reach: Array

    @classmethod
    def of(cls, dataset: Dataset) -> Integrals:
        """Find the integrals among the states of ``dataset``."""
        system = dataset.system
        data = dataset.transitions(moving=True)
        seen = np.concatenate([system.regressors(data.state), data.control], axis=1)
        standard = (seen - seen.mean(axis=0)) / deviation(seen)
        change = system.difference(data.after, data.state)
        columns = np.concatenate([np.ones((len(seen), 1)), standard, standard**2], axis=1)
        effects, *_ = np.linalg.lstsq(columns, change / deviation(change), rcond=None)
        own = np.flatnonzero([name in system.state_names for name in system.regressor_names])
        added = np.zeros(system.nx, dtype=bool)
        reach = np.tile([[-np.inf], [np.inf]], (1, system.nx))
        plain = [i for i in range(system.nx) if i not in system.periods]
        for i, place in zip(plain, own, strict=True):
            effect = np.abs(effects[[1 + place, 1 + seen.shape[1] + place], i]).max()
            added[i] = effect < OWN and np.ptp(data.state[:, i]) > 0.0
            channel, values = system.states[i], data.state[:, i]
            reach[:, i] = min(channel.low, values.min()), max(channel.high, values.max())
        added[list(system.periods)] = True
        return cls(added, reach)

    def next_state(self, state: Array, predicted: Array) -> Array:
        """Return ``predicted`` (B, nx), added to ``state`` (B, nx) where it is a change."""
        return np.where(self.added, np.clip(state + predicted, *self.reach), predicted)

    def predictor(self, inner: Predictor) -> Predictor:
        """Return the compiled form of `next_state` around what predicts."""
        from sysid_evo.engine.kernels import on_top

        return on_top(inner, self.added, *self.reach) if self.added.any() else inner
