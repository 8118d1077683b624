"""A nonlinear state space whose states are not measured: the mean of several small networks trained on free runs."""

from __future__ import annotations

from itertools import cycle, islice
from typing import Any, ClassVar, Self

import numpy as np

from model_zoo.hidden.family import StateSpaceModel
from model_zoo.hidden.learning import Lesson
from model_zoo.hidden.shooting import Spaces, Trained
from model_zoo.hidden.units import UNITS
from model_zoo.validation.held_out import best, trials
from sysid_evo import Dataset, register_model
from sysid_evo.arrays import Array
from sysid_evo.hyperparameters import Limit, at_least
from sysid_evo.progress import Counter, Progress

FEWEST_STATES = 2
SPREAD = 0.7
"""Deviation of the weights into the units at the start."""
SHARPNESS = 5.0
"""How fast a member counts less as its criterion, for each sample, is higher."""
ASTRAY = 10.0
"""What the criterion of a member that goes astray is higher."""
NEGLIGIBLE = 0.08
"""Weight, as a share of the largest, below which a member is left out."""


@register_model("nonlinear_state_space")
class NonlinearStateSpace(StateSpaceModel):
    """x' = A x + B u + c + W units(V (x, u, 1)) + K (y - C x - d), y = C x + d: free runs fitted by shooting.

    It begins at the linear state space of the same ``order`` (subspace and output error). Networks of ``hidden``
    units, smooth (tanh), kinked and cubic in turn, are trained side by side by Levenberg-Marquardt with analytic
    gradients on free runs of 100 and at last of ``horizon`` steps, the initial state of each free, with a normal
    prior on W and V; residuals that are alike for long count less. ``order`` None offers three, from 2 or the number
    of outputs on; the one with the network of the lowest Bayesian information criterion (Schwarz 1978) after
    ``trial`` iterations is taken. ``members`` of that order go on for ``iterations``, and half as many on long runs.
    The output is their mean, in which one counts less the higher its criterion is, and one that goes astray under
    the recorded controls in another order not at all; each has its own hidden states and its own gain K.
    """

    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": {"members": 3, "trial": 8, "iterations": 15, "horizon": 300, "most_steps": 3000}
    }
    limits: ClassVar[dict[str, Limit]] = {name: at_least(1) for name in ("members", "hidden", "trial")}

    order: int | None = None
    members: int = 6
    hidden: int = 6
    trial: int = 15
    iterations: int = 40
    horizon: int = 1000
    rest_hold: bool = False
    most_steps: int | None = 30_000

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        least, long = max(FEWEST_STATES, dataset.system.nx), max(1, self.iterations // 2)
        orders = [max(self.order, dataset.system.nx)] if self.order else [least, least + 1, least + 2]
        kinds = list(islice(cycle(UNITS), self.members))
        of_orders = (2 * len(orders) + trials(orders)) * self.trial
        counter = Counter(progress, of_orders + self.trial + self.iterations + long + 1)
        lesson = Lesson.of(dataset, self.horizon)
        linear = {order: lesson.linear_trained(order, self.trial, self.trial, counter.advance) for order in orders}

        def tried(order: int) -> float:
            few = self._networks(lesson, linear[order], list(UNITS), rng)
            trained = lesson.learned(*few, self.trial, counter.advance)
            return float(criterion(trained.error, trained.spaces, lesson).min())

        start = linear[best(orders, tried)]
        networks = self._networks(lesson, start, kinds, rng)
        trained = lesson.learned(*networks, self.trial + self.iterations, counter.advance)
        trained = lesson.lengthened(trained, start.spaces, long, counter.advance)
        observers = lesson.observers(trained)
        errors = [lesson.from_history(trained.spaces[[i]], own) for i, own in enumerate(observers)]
        found = criterion(np.array(errors), trained.spaces, lesson)
        astray = lesson.escapes(trained.spaces, observers)
        found = found + np.where(astray & ~astray.all(), ASTRAY, 0.0)
        weights = np.exp(-SHARPNESS * (found - found.min()))
        kept = np.flatnonzero(weights > NEGLIGIBLE).tolist()
        self.adopt(
            lesson.scales,
            [trained.spaces[[i]] for i in kept],
            [observers[i] for i in kept],
            weights[kept] / weights[kept].sum(),
        )
        counter.advance()
        return self

    def _networks(
        self, lesson: Lesson, linear: Trained, kinds: list[str], rng: np.random.Generator
    ) -> tuple[Spaces, Array]:
        """Return spaces that step as the linear one does, with units that have no weight yet, and initial states."""
        own, count = linear.spaces, len(kinds)
        outer = np.concatenate([own.outer, np.zeros((1, own.n, self.hidden))], axis=2).repeat(count, axis=0)
        inner = SPREAD * rng.standard_normal((count, self.hidden, own.outer.shape[2]))
        starts = lesson.states(linear, lesson.long)[:, lesson.short.begins]
        return Spaces(outer, inner, own.pace, tuple(kinds)), starts.repeat(count, axis=0)


def criterion(errors: Array, spaces: Spaces, lesson: Lesson) -> Array:
    """Return the Bayesian information criterion (S,) for each sample: log ``errors`` (S,) + P log(N) / N."""
    count = sum(part.outputs.size for part in lesson.parts)
    known = np.where(np.isfinite(errors), np.maximum(errors, 1e-12), 1e6)
    return np.asarray(np.log(known) + spaces.flat.shape[1] * np.log(count) / count)
