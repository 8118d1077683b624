"""A state space with an encoder network that finds its initial states, for recordings of thousands of samples."""

from __future__ import annotations

from typing import Any, ClassVar, Self

import numpy as np

from model_zoo.hidden.family import StateSpaceModel
from model_zoo.hidden.gate import LINEAR, linear_instead
from model_zoo.hidden.learning import Lesson
from model_zoo.hidden.observer import observer
from model_zoo.hidden.shooting import Spaces, Trained
from model_zoo.hidden.units import UNITS
from sysid_evo import Dataset, register_model
from sysid_evo.arrays import Array, IntArray
from sysid_evo.cross_validation import time_blocks
from sysid_evo.hyperparameters import Limit, above, at_least
from sysid_evo.progress import Counter, Progress

STATES = 4
BEGUN = 10
"""Iterations of the linear start, on short and on long runs each."""
LONG = 300
RIDGE = 1e-4
SPREAD = 0.7
FOLDS = 5
TRIAL_SHARE = 3
"""One part of the updates in so many is for each fold of the gate."""
BLOCK_SHARE = 36
"""Past and free run take at most one part in so many of the longest episode, for a held-out block is a sixth of it."""


@register_model("subnet")
class Subnet(StateSpaceModel):
    """x' = A x + B u + c + W tanh(V (x, u, 1)), x from an encoder of the last ``past`` samples (SUBNET).

    Beintema, Toth, Schoukens (2021): encoder and state space are trained together by Adam on truncated free runs of
    ``horizon`` steps that begin anywhere in the recordings. The state space begins at the linear one, the encoder at
    the linear map to its states. The weights that run best on held-out blocks of time are kept. After that an
    observer takes the place of the encoder, as in the other families with hidden states. ``order`` None is 4, or one
    more than there are outputs. With a few thousand samples or fewer, `nonlinear_state_space` is better and faster.

    Of a record of less than 600 samples `linear_state_space` is the model unless this one, with a third of the
    ``updates``, is a tenth better in free runs on held-out blocks of time; ``gated=False`` leaves that out.
    """

    requires = ("torch",)
    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": {"hidden": 16, "updates": 150, "horizon": 20, "batch": 64, "most_steps": 5000}
    }
    limits: ClassVar[dict[str, Limit]] = {
        **{name: at_least(1) for name in ("hidden", "past", "updates", "batch")},
        "horizon": at_least(2),
        "learning_rate": above(0),
    }

    order: int | None = None
    hidden: int = 32
    past: int = 20
    horizon: int = 50
    updates: int = 3000
    batch: int = 128
    learning_rate: float = 3e-3
    gated: bool = True
    rest_hold: bool = False
    most_steps: int | None = 100_000

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        from model_zoo.torch_flows.encoder import Encoded, pasts, train_encoded
        from model_zoo.torch_flows.equation import one_thread

        ny = dataset.system.nx
        counter = Counter(progress, 2 * BEGUN + self.updates + 1)
        lesson = Lesson.of(dataset, LONG)
        room = max(2, max(len(episode) for episode in dataset.episodes) // BLOCK_SHARE)
        past, horizon = min(self.past, 2 * room), min(self.horizon, 3 * room)
        order = max(self.order, ny) if self.order else max(STATES, ny + 1)
        linear = lesson.linear_trained(order, BEGUN, BEGUN, counter.advance)
        blocks = [Lesson.of(part, LONG, lesson.scales).parts for part in time_blocks(dataset, 0, FOLDS)]
        with one_thread(int(rng.integers(2**63))):
            module = Encoded(self._bent(linear.spaces, rng), self._encoder(lesson, linear, past), self.hidden)
            train_encoded(
                module,
                pasts(blocks[0], past, horizon),
                pasts(blocks[1], past, horizon),
                updates=self.updates,
                batch=self.batch,
                learning_rate=self.learning_rate,
                rng=rng,
                told=counter.advance,
            )
            seen, _, outputs = pasts(lesson.parts, past, 1)
            runs = module.encoded(seen)
        weights = [value.detach().numpy().copy()[None] for value in (module.outer, module.inner)]
        space = Spaces(weights[0], weights[1], linear.spaces.pace, _smooth(self.hidden))
        self.adopt(lesson.scales, [space], [observer(space, runs, outputs[:, 0], lesson.parts)], np.ones(1))
        if self.gated:
            settings = {"order": self.order, "horizon": LONG, "rest_hold": self.rest_hold}
            trial = self.variant(gated=False, updates=-(-self.updates // TRIAL_SHARE))
            self.replaced_by(linear_instead(trial, dataset, rng, **settings))
        counter.advance()
        return self

    def uses(self) -> tuple[str, ...]:
        return (LINEAR,) if self.gated else ()

    def _bent(self, linear: Spaces, rng: np.random.Generator) -> Spaces:
        """Return the linear space with units that have no weight yet."""
        outer = np.concatenate([linear.outer, np.zeros((1, linear.n, self.hidden))], axis=2)
        inner = SPREAD * rng.standard_normal((1, self.hidden, linear.outer.shape[2]))
        return Spaces(outer, inner, linear.pace, _smooth(self.hidden))

    def _encoder(self, lesson: Lesson, linear: Trained, past: int) -> Array:
        """Return the map (n, p + 1) from the past and 1 to the states of the linear space."""
        from model_zoo.torch_flows.encoder import pasts

        states, begin, targets = lesson.states(linear, lesson.long)[0], 0, []
        for part in lesson.parts:
            if len(part) > past:
                targets.append(states[begin + past : begin + len(part)])
            begin += len(part) + 1
        seen, _, _ = pasts(lesson.parts, past, 1)
        regressors = np.concatenate([seen, np.ones((len(seen), 1))], axis=1)
        square = regressors.T @ regressors + RIDGE * len(regressors) * np.eye(regressors.shape[1])
        return np.linalg.solve(square, regressors.T @ np.concatenate(targets)).T


def _smooth(hidden: int) -> IntArray:
    return np.full((1, hidden), UNITS.index("smooth"))
