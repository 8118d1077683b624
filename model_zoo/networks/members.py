"""Networks of lagged states and controls as one model that runs free, member beside member."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from model_zoo.channels.mirror import Mirror
from model_zoo.networks.layers import Single
from model_zoo.networks.multistep import Plan
from model_zoo.networks.network import Network
from model_zoo.networks.standardised import StandardisedModel
from model_zoo.networks.trainings import Trainings
from sysid_evo.arrays import Array
from sysid_evo.cross_validation import time_blocks
from sysid_evo.data import Dataset


class LaggedMembers(StandardisedModel):
    """M networks of (carry, control, flag) that give the change of the state in one step.

    ``flag`` (M, B, 1) is 1 for data as recorded and -1 for mirrored data.
    """

    def __init__(
        self,
        dataset: Dataset,
        lags: tuple[int, int],
        *,
        hidden: Sequence[int],
        members: int,
        mirror: Mirror | None,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(dataset, lags, hidden=hidden, rng=rng, members=members, further=1, mirror=mirror)

    def prepare(self, horizon: int) -> None:
        self.accelerations: Single = np.empty((horizon, *self.states.shape[1:]), dtype=np.float32)

    def advance(self, step: int, state: Single) -> Single:
        acceleration: Single = self.called(step, 0, state)
        self.accelerations[step] = acceleration
        return self.system.integrate(state, acceleration)

    def pull_back(self, step: int, gradient: Single) -> Single:
        state = self.states[self.layout.history + step]
        moved = self.motion.integrated(state, self.accelerations[step], self.system.dt, gradient)
        by_state, by_acceleration = moved
        return by_state + self.pulled_through(step, 0, state, by_acceleration)


def train_members(
    dataset: Dataset,
    lags: tuple[int, int],
    *,
    hidden: tuple[int, ...],
    members: int,
    folds: int,
    plan: Plan,
    mirror: Mirror | None,
    trainings: Trainings,
) -> tuple[Network, Array]:
    """Train ``members`` networks, each on the blocks of time that are left when its own are held out.

    Returns networks of features of (carry, control) that give accelerations, and each member's validation error (M,).
    """
    model = LaggedMembers(dataset, lags, hidden=hidden, members=members, mirror=mirror, rng=trainings.rng)
    splits = [time_blocks(dataset, member, folds) for member in range(members)]
    parameters, errors = model.learn(splits, plan, trainings)
    return model.network(parameters), errors


def train_further(
    network: Network,
    dataset: Dataset,
    lags: tuple[int, int],
    plan: Plan,
    rng: np.random.Generator,
    *,
    mirror: Mirror | None,
) -> Network:
    """Train the members of ``network``, which `train_members` made, on all of ``dataset``."""
    members, hidden = len(network.weights[0]), [weight.shape[2] for weight in network.weights[:-1]]
    model = LaggedMembers(dataset, lags, hidden=hidden, members=members, mirror=mirror, rng=rng)
    model.begin_with(network)
    return model.network(model.learn_further(dataset, plan, Trainings(rng)))
