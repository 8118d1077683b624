"""Sanity check of fitted models: none may be worse than both persistence and a linear model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from sysid_evo.data import Dataset
from sysid_evo.models.base import DynamicsModel, make_model
from sysid_evo.types import Array
from sysid_evo.validation.held_out import NEGLIGIBLE_ERROR
from sysid_evo.validation.simulation_error import (
    FEWEST_STEPS,
    SECOND,
    HeldOutTest,
    Scorer,
    history_of,
    horizons_of,
)

TOLERANCE = 1.1
"""A model fails where its error is over this multiple of both references; set by hand, for noise in the error."""


@dataclass(frozen=True)
class SanityCheck:
    """Errors of persistence and of the family ``linear`` after one step and after a second, on held-out data.

    ``references`` (2, H) are RMSE / standard deviation, averaged over the states, in the tests of ``scorer``. A second
    has at least ten steps; it is left out if it does not fit into the held-out data.
    """

    scorer: Scorer
    references: Array

    @classmethod
    def of(cls, *pairs: tuple[Dataset, Dataset]) -> Self:
        """Return the check on pairs of training and held-out data."""
        system = pairs[0][0].system
        horizons = horizons_of(list(pairs), [1, max(FEWEST_STEPS, round(SECOND / system.dt))])
        tests = [HeldOutTest.of(held, horizons, history_of(list(pairs), horizons)) for _, held in pairs]
        scorer = Scorer.of(pairs[0][0], tests)
        kept = [np.repeat(test.windows.start_states[:, None], len(horizons), axis=1) for test in tests]
        linear = [make_model("linear").fit(training, rng=np.random.default_rng(0)) for training, _ in pairs]
        simulated = [test.run(model) for test, model in zip(tests, linear, strict=True)]
        return cls(scorer, np.stack([scorer.errors(kept).at, scorer.errors(simulated).at]))

    def warning(self, *models: DynamicsModel) -> str:
        """Return a sentence without a subject if the ``models``, one for each pair, fail; else an empty text.

        They fail if their error at every horizon is over `TOLERANCE` times that of both references, and not negligible.
        """
        tests = self.scorer.trials
        with np.errstate(all="ignore"):
            runs = [test.run(model.without_noise()) for test, model in zip(tests, models, strict=True)]
            errors = self.scorer.errors(runs).at
        if (errors <= np.maximum(TOLERANCE * self.references.max(axis=0), NEGLIGIBLE_ERROR)).any():
            return ""
        after = [
            f"{error:.3g} after {step} {'step' if step == 1 else 'steps'} ({kept:.3g} and {linear:.3g})"
            for step, error, kept, linear in zip(tests[0].horizons, errors, *self.references, strict=True)
        ]
        return f"is worse than both no change (persistence) and a linear model on held-out data: N {', '.join(after)}"
