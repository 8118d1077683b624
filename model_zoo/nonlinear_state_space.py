"""A nonlinear state space whose states are not measured: the mean of several small networks trained on free runs."""

from __future__ import annotations

from itertools import cycle, islice
from typing import Any, ClassVar, Self

import numpy as np

from model_zoo.hidden.family import StateSpaceModel
from model_zoo.hidden.learning import Lesson
from model_zoo.hidden.shooting import Spaces, Trained
from model_zoo.hidden.units import UNITS
from sysid_evo import Dataset, register_model
from sysid_evo.arrays import Array, IntArray
from sysid_evo.hyperparameters import Limit, at_least
from sysid_evo.progress import Counter, Progress

FEWEST_STATES = 2
SPREAD = 0.7
"""Deviation of the weights into the units at the start."""
SHARPNESS = 8.0
"""Power of the error by which a member counts less than the best."""
NEGLIGIBLE = 0.05
"""Weight, as a share of the largest, below which a member is left out."""


@register_model("nonlinear_state_space")
class NonlinearStateSpace(StateSpaceModel):
    """x' = A x + B u + c + W units(V (x, u, 1)) + K (y - C x - d), y = C x + d: free runs fitted by shooting.

    It begins at the linear state space of the same ``order`` (subspace and output error). Networks of ``hidden``
    units, smooth (tanh), kinked and cubic in turn, are trained side by side by Levenberg-Marquardt with analytic
    gradients on free runs of 100 and at last of ``horizon`` steps, the initial state of each free, with a normal prior
    on W and V; residuals that are alike for long count less. ``order`` None offers three orders, from 2 or the number
    of outputs on. After ``trial`` iterations the ``members`` with the lowest final prediction error (Akaike 1970) go
    on, for ``iterations`` each on short and on long runs. The output is their mean, weighted by that error to the
    power of -8 in variance; each has its own hidden states and its own gain K.
    """

    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": {"members": 3, "trial": 8, "iterations": 15, "hidden": 6, "horizon": 300, "most_steps": 3000}
    }
    limits: ClassVar[dict[str, Limit]] = {name: at_least(1) for name in ("members", "hidden", "trial")}

    order: int | None = None
    members: int = 6
    hidden: int = 8
    trial: int = 15
    iterations: int = 40
    horizon: int = 1000
    rest_hold: bool = False
    most_steps: int | None = 10_000

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        least = max(FEWEST_STATES, dataset.system.nx)
        orders = [max(self.order, dataset.system.nx)] if self.order else [least, least + 1, least + 2]
        kinds = list(islice(cycle(UNITS), max(len(UNITS), self.members) if len(orders) == 1 else len(UNITS)))
        counter = Counter(progress, len(orders) * (3 * self.trial + 2 * self.iterations) + 1)
        lesson = Lesson.of(dataset, self.horizon)
        linear = {order: self._linear(lesson, order, counter) for order in orders}
        tried = []
        for order in orders:
            starts = np.repeat(lesson.states(linear[order], lesson.at_last)[:, lesson.short.begins], len(kinds), axis=0)
            spaces = self._networks(linear[order].spaces, kinds, rng)
            tried.append(lesson.learned(spaces, self.trial, counter.advance, starts=starts))
        errors = np.concatenate([final_prediction_error(one, lesson) for one in tried])
        kept = np.sort(np.argsort(errors, kind="stable")[: self.members])
        members, found, observers = [], [], []
        for number, order in enumerate(orders):
            rows = kept[kept // len(kinds) == number] % len(kinds)
            if not len(rows):
                counter.advance(2 * self.iterations)
                continue
            trained = self._trained(lesson, tried[number], rows, linear[order].spaces, counter)
            own = final_prediction_error(trained, lesson)
            members += [trained.spaces[[s]] for s in range(len(own))]
            found += own.tolist()
            observers += lesson.observers(trained)
        weights = (np.array(found) / min(found)) ** -SHARPNESS
        best = np.flatnonzero(weights > NEGLIGIBLE)
        self.adopt(
            lesson.scales,
            [members[i] for i in best],
            [observers[i] for i in best],
            weights[best] / weights[best].sum(),
        )
        counter.advance()
        return self

    def _linear(self, lesson: Lesson, order: int, counter: Counter) -> Trained:
        start = lesson.linear(order)
        trained = lesson.learned(start, self.trial, counter.advance)
        return lesson.lengthened(trained, start, self.trial, counter.advance)

    def _networks(self, linear: Spaces, kinds: list[str], rng: np.random.Generator) -> Spaces:
        """Return spaces that step as the linear one does, with units that have no weight yet."""
        outer = np.repeat(linear.outer, len(kinds), axis=0)
        outer = np.concatenate([outer, np.zeros((*outer.shape[:2], self.hidden))], axis=2)
        inner = SPREAD * rng.standard_normal((len(kinds), self.hidden, linear.outer.shape[2]))
        return Spaces(outer, inner, linear.pace, tuple(kinds))

    def _trained(self, lesson: Lesson, tried: Trained, rows: IntArray, fallback: Spaces, counter: Counter) -> Trained:
        """Return some of the tried spaces after all their training."""
        trained = lesson.learned(tried.spaces[rows], self.iterations, counter.advance, starts=tried.starts[rows])
        return lesson.lengthened(trained, fallback, self.iterations, counter.advance)


def final_prediction_error(trained: Trained, lesson: Lesson) -> Array:
    """Return the mean square residual (S,) times (1 + P / N) / (1 - P / N) for P parameters and N samples."""
    count = sum(part.outputs.size for part in lesson.parts)
    share = min(trained.spaces.flat.shape[1] / count, 0.9)
    return np.where(np.isfinite(trained.error), trained.error, 1e6) * (1.0 + share) / (1.0 - share)
