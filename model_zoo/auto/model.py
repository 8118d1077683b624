"""Family auto: the mean of the candidates that simulate held-out data best, and the ranking of all."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from model_zoo.auto.candidates import Candidate, candidates_for, candidates_named, plugins, unusable
from model_zoo.auto.fitting import FitWork
from model_zoo.auto.selection import CandidateChoice, CandidateSelection, structure_of, weights_of
from sysid_evo import Dataset, DynamicsModel, register_model
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.models.adaptation import held_out_error
from sysid_evo.models.ensemble import MeanModel
from sysid_evo.models.learned import Declared, Numbers
from sysid_evo.models.parameters import Limit, above, at_least
from sysid_evo.progress import Progress
from sysid_evo.types import Array
from sysid_evo.validation.folds import make_folds
from sysid_evo.validation.simulation_error import Scorer, held_out_tests, horizons_of, selection_horizons

PROCESSORS = 2
"""Number of processors for which a budget is given in seconds."""
SHARE = 0.85
"""Share of that time spent in fits; the rest starts processes, waits for the last one and computes the mean."""


@register_model("auto")
class Auto(MeanModel):
    """Average of the model families that simulate the held-out data best; the default family.

    Each candidate (a family with lags and parameters) is fitted ``folds`` times without one group of recordings (blocks
    of time if there is only one recording) and simulated on that group. Its error is RMSE / standard deviation after
    ``horizons`` steps, averaged over states and horizons; by default these follow the slowest response and the length
    of the recordings (`selection_horizons`). A candidate that is far worse in the first fold (1.25 times the cutoff,
    and significantly) skips the others. Candidates that fail, diverge or do not pass the `SanityCheck` are dropped.
    So are those that have twice the lowest error in simulations of up to 1000 steps through all of a long recording.

    Others are kept within ``cutoff`` times the lowest error; the cutoff is reduced if the mean of fewer candidates has
    a lower held-out error, but candidates that are not significantly worse than the best stay (paired bootstrap). The
    best candidate of each model class stays within ``class_cutoff`` times the lowest error, over all folds and in the
    geometric mean of the folds, since models of another structure fail elsewhere, unless the error of the mean is 5 %
    higher with them. A good state space is replaced by a version with longer training and a good Gaussian process by
    the average of three, unless that is significantly worse; that of a leading candidate is tried before the others.
    The candidates that are kept are refitted to all data; state spaces are averaged with those fitted without each
    fold, except much worse ones.

    The weight of a model class (networks with lags, networks without, polynomials, neighbours, physics, state spaces)
    is the square root of the number of its members, which share it equally. Every member starts each step from the mean
    state and keeps its own earlier samples.

    ``budget`` (s, on two processors) limits how many candidates are tried, by their *expected* fit time and not by a
    clock: the same data, seed and installed families give the same model on any machine. ``candidates`` names others,
    such as ``[narx, neural_ode(updates=200)]``, which are all tried, in Python also objects that an `Adapter`
    recognises; a name without settings selects the default candidates of that family. Long fits use all available
    processors.

    With ``stochastic``, every step adds normal noise: the members' disagreement and the held-out one-step residual,
    scaled as in `StochasticModel`. Such a model has no compiled form.
    """

    knowledge = "grey"
    periodic = True
    chooses_families = True
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"budget": 60.0}, "paper": {"budget": 900.0}}
    limits: ClassVar[dict[str, Limit]] = {
        "budget": above(0),
        "cutoff": at_least(1),
        "class_cutoff": at_least(1),
        "horizons": at_least(1),
        "folds": at_least(1),
    }

    budget: float = 120.0
    candidates: list[Any] | None = None
    cutoff: float = 1.25
    class_cutoff: float = 1.4
    horizons: list[int] | None = None
    folds: int = 3
    max_steps: int | None = 100_000

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        pairs = make_folds(dataset, self.folds)
        tried, left_out = self._tried(dataset)
        if not tried:
            raise IncompatibleSystem(f"auto: expected a candidate for this system, got none: {'; '.join(left_out)}")
        horizons = horizons_of(pairs, self.horizons) if self.horizons else selection_horizons(dataset, pairs)
        scorer = Scorer.of(dataset, held_out_tests(pairs, horizons))
        seeds = rng.integers(2**32, size=(len(tried), len(pairs) + 1))
        budget = PROCESSORS * SHARE * self.budget if self.candidates is None else math.inf
        costs = sum(one.cost(dataset.system, dataset.n_steps, len(pairs)) for one in tried)
        work = FitWork(progress, min(budget, costs))
        choice = CandidateSelection(dataset, pairs, scorer, tried, seeds, budget, work).choice(
            self.cutoff, self.class_cutoff, self._mean
        )
        shares = weights_of([structure_of(own[0]) for own in choice.models])
        each = [np.full(len(own), share / len(own)) for own, share in zip(choice.models, shares, strict=True)]
        self.become([model for own in choice.models for model in own], np.concatenate(each))
        ranking = CandidateRanking.of(choice, tried, shares, left_out=left_out, horizons=horizons, pairs=pairs)
        for name, value in ranking.learned().items():
            setattr(self, name, value)
        means = [self._mean(list(models)) for models in zip(*choice.rough, strict=True)]
        cases = [(mean, held) for mean, (_, held) in zip(means, pairs, strict=True)]
        nothing_held_out = any(seen is held for seen, held in pairs)
        self.held_out_error_ = None if nothing_held_out else held_out_error(cases)
        if self.stochastic:
            self._spread_on(cases, rng, work.report_alive)
        return self

    def _tried(self, dataset: Dataset) -> tuple[list[Candidate], list[str]]:
        """Return the candidates, and why others are not used. Raises the errors of the registry for wrong names."""
        if self.candidates is None:
            return candidates_for(dataset.system)
        reasons = [(one, unusable(one, dataset.system)) for one in candidates_named(self.candidates)]
        return [one for one, reason in reasons if not reason], [
            f"{o.name}: {reason}" for o, reason in reasons if reason
        ]

    def _mean(self, models: list[DynamicsModel]) -> Self:
        """Return the mean of models fitted to the same part of the data."""
        return self.of(models, weights_of([structure_of(model) for model in models]))

    def families_used(self) -> tuple[str, ...]:
        tried = plugins() if self.candidates is None else candidates_named(self.candidates)
        return tuple(dict.fromkeys(one.spec.name for one in tried))

    def learned_arrays(self) -> Mapping[str, Declared]:
        return {
            "errors_": Numbers("candidates", "horizons", infinite=True, optional=True),
            "shares_": Numbers("candidates", optional=True),
            "means_": Numbers("cutoffs", 2, infinite=True, optional=True),
        }

    def candidate_ranking(self) -> list[dict[str, str]]:
        """Return a row for every candidate, the best first: held-out error, weight, remark."""
        found = CandidateRanking.stored_in(self)
        return [] if found is None else found.rows()

    @property
    def fit_note(self) -> str:
        found = CandidateRanking.stored_in(self)
        return "; ".join(filter(None, (super().fit_note, "" if found is None else found.sentence(self.class_cutoff))))


@dataclass(frozen=True)
class CandidateRanking:
    """The candidates that were scored, the best first, in a form that a stored model can hold.

    ``errors`` (n, H) at each of the ``horizons``, ``shares`` (n,) of the mean (0 if not kept), and a remark each.
    ``failed`` lists the others with the reason. ``cutoff`` was chosen from those in ``means`` (g, 2), each with
    the error of the mean within it. ``ahead`` is the 95 % interval by which the second best is worse than the best
    (empty with one candidate).
    """

    candidates: list[str]
    errors: Array
    shares: Array
    remarks: list[str]
    failed: list[str]
    horizons: list[int]
    cutoff: float
    means: Array
    ahead: list[float]
    evaluated_on: str

    @classmethod
    def of(
        cls,
        choice: CandidateChoice,
        candidates: Sequence[Candidate],
        weights: Array,
        *,
        left_out: Sequence[str],
        horizons: Sequence[int],
        pairs: Sequence[tuple[Dataset, Dataset]],
    ) -> Self:
        """Summarise a ``choice`` among ``candidates``; those that are kept have these ``weights``."""
        known = {number: error for number, error in enumerate(choice.errors) if error is not None}
        order = sorted(known, key=lambda number: known[number].mean)
        share = dict(zip(choice.kept, weights.tolist(), strict=True))
        kind = {n: structure_of(own[0]) for n, own in zip(choice.kept, choice.models, strict=True)}
        above = f"above {choice.passed.cutoff:.2f} x the lowest error"
        usable = [number for number in order if not choice.reasons[number]]
        ahead = known[usable[1]].above(known[usable[0]]).interval if len(usable) > 1 else ()
        failed = [
            f"{one.name}: {choice.reasons[number]}" for number, one in enumerate(candidates) if number not in known
        ]
        return cls(
            candidates=[candidates[number].name for number in order],
            errors=np.stack([known[number].at for number in order]),
            shares=np.array([share.get(number, 0.0) for number in order]),
            remarks=[choice.reasons[number] or kind.get(number, above) for number in order],
            failed=[*failed, *left_out],
            horizons=list(horizons),
            cutoff=choice.passed.cutoff,
            means=np.array(choice.passed.compared),
            ahead=[float(value) for value in ahead],
            evaluated_on=held_out_in_words(pairs),
        )

    def learned(self) -> dict[str, Any]:
        """Return the attributes that a model stores, by name."""
        return {f"{name}_": value for name, value in vars(self).items()}

    @classmethod
    def stored_in(cls, model: Any) -> Self | None:
        """Undo `learned`: return the ranking stored in a fitted ``model``; None before its fit."""
        if not hasattr(model, "evaluated_on_"):
            return None
        return cls(**{name: getattr(model, f"{name}_") for name in cls.__dataclass_fields__})

    def rows(self) -> list[dict[str, str]]:
        """Return the table of candidates, the best first."""
        after = f"after {', '.join(map(str, self.horizons))} steps"
        rows = []
        for name, at, weight, remark in zip(self.candidates, self.errors, self.shares, self.remarks, strict=True):
            numbers = {"error": f"{at.mean():.3f}", after: ", ".join(f"{one:.3f}" for one in at)}
            rows.append({"candidate": name, **numbers, "weight": f"{weight:.2f}" if weight else "", "remark": remark})
        for text in self.failed:
            name, _, reason = text.partition(": ")
            rows.append({"candidate": name, "error": "", after: "", "weight": "", "remark": reason})
        return rows

    def sentence(self, class_cutoff: float) -> str:
        """Return members and weights, the cutoffs, and whether the best is significantly better than the second best.

        The best of each class was kept within ``class_cutoff``.
        """
        kept = [
            f"{name} ({at.mean():.3f}, weight {weight:.2f})"
            for name, at, weight in zip(self.candidates, self.errors, self.shares, strict=True)
            if weight > 0.0
        ]
        text = (
            f"mean of {len(kept)} of {len(self.candidates)} candidates: {', '.join(kept)}; error of simulations "
            f"over {', '.join(map(str, self.horizons))} steps on {self.evaluated_on}; cutoff "
            f"{self.cutoff:.2f} x the lowest error, for the best of each class {class_cutoff:.2f} x; error of "
            "the mean by cutoff: " + ", ".join(f"{cutoff:.2f} x {error:.3f}" for cutoff, error in self.means)
        )
        if self.ahead:
            low, high = self.ahead
            verb = "differ" if low > 0.0 or high < 0.0 else "do not differ"
            text += (
                f"; the best and the second best candidate {verb} significantly (by {low:+.3f} to "
                f"{high:+.3f}, 95 % interval)"
            )
        elif len(self.candidates) > 1:
            text += "; all other candidates were dropped after the first fold"
        return text


def held_out_in_words(pairs: Sequence[tuple[Dataset, Dataset]]) -> str:
    """Return a description of the held-out data."""
    seen, held = pairs[0]
    if seen is held:
        return "the training data, which are too short to hold anything out"
    shared = {name.split("[")[0] for name in seen.names} & {name.split("[")[0] for name in held.names}
    what = "held-out blocks of time" if shared else "held-out recordings"
    return f"{what} ({len(pairs)} folds)" if len(pairs) > 1 else what
