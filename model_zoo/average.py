"""Family average: the mean of named families with equal weights; `auto` also selects and weights them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Self

import numpy as np

from sysid_evo import Dataset, DynamicsModel, make_model, register_model
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.models.adapters import as_spec
from sysid_evo.models.ensemble import MeanModel
from sysid_evo.progress import Counter, Progress
from sysid_evo.registry import Spec, models
from sysid_evo.system import System
from sysid_evo.validation.folds import FOLDS, make_folds

FAMILIES = ("narx", "k_neighbours")

PARTS = 100
"""Progress steps reported for the fit of one family."""


@register_model("average")
class Average(MeanModel):
    """Mean of several named families, each fitted to all data, with equal weights.

    ``families`` gives them with their settings, such as ``[narx, neural_ode(updates=200)]``, in Python also as objects
    that an `Adapter` recognises; `narx` and `k_neighbours` by default. To have families selected and weighted, use
    `auto`. The mean of next states equals the mean of accelerations, because the next state is affine in the
    acceleration. Every member starts each step from the mean state and keeps its own earlier samples.

    With ``stochastic``, every step adds normal noise: the members' disagreement and the one-step residual, scaled as in
    `StochasticModel` on up to three held-out conditions, recordings or blocks of time.
    """

    knowledge = "grey"
    periodic = True
    presets: ClassVar[dict[str, dict[str, Any]]] = {}

    families: list[Any] | None = None
    max_steps: int | None = 100_000

    def check_parameters(self) -> None:
        super().check_parameters()
        if not self._named():
            raise InvalidArgument("families: expected at least one family, got none")
        for spec in self._named():
            if spec.name == "average":
                raise InvalidArgument("families: expected other families, got average, which would contain itself")
            models.check(spec)

    def check_system(self, system: System) -> None:
        for spec, model in zip(self._named(), self._unfitted(), strict=True):
            model.check_system(system)
            if system.periods and not model.periodic:
                turning = ", ".join(channel.name for channel in system.states if channel.period)
                raise IncompatibleSystem(f"families: {spec.text} does not support periodic states ({turning})")

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        pairs = make_folds(dataset, FOLDS) if self.stochastic else []
        counter = Counter(progress, PARTS * len(self._named()) * (1 + len(pairs)) + 1)

        def fitted(data: Dataset) -> list[DynamicsModel]:
            return [model.fit(data, rng=rng, progress=_share(counter)) for model in self._unfitted()]

        members = fitted(dataset)
        self.become(members, np.full(len(members), 1.0 / len(members)))
        if self.stochastic:
            means = [(self.of(parts, self.weights_), held) for parts, held in ((fitted(a), b) for a, b in pairs)]
            self._spread_on(means, rng, lambda: counter.advance(0))
        return self

    @classmethod
    def made_of(cls, fitted: Sequence[DynamicsModel]) -> Self:
        """Return the mean of ``fitted`` models of one system as a fitted model."""
        mean = cls()
        mean.become(fitted, np.full(len(fitted), 1.0 / len(fitted)))
        bounds = np.array([model.state_bounds_ for model in fitted])
        mean.system_, mean.training_sample_ = fitted[0].system, fitted[0].training_sample_
        mean.state_bounds_ = np.stack([bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)])
        return mean

    def _named(self) -> list[Spec]:
        return [as_spec(one) for one in (FAMILIES if self.families is None else self.families)]

    def _unfitted(self) -> list[DynamicsModel]:
        return [make_model(spec) for spec in self._named()]

    def families_used(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(spec.name for spec in self._named()))


def _share(counter: Counter) -> Progress:
    """Return a callback that reports the progress of one fit to ``counter``, in `PARTS` steps."""
    before = counter.done

    def progress(done: int, total: int, note: str = "") -> None:  # noqa: ARG001  # the note of a fit is not shown
        counter.advance(max(0, before + PARTS * min(done, total) // max(1, total) - counter.done))

    return progress
