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
from sysid_evo.models.parameters import Limit, SearchRange, Within, above, at_least
from sysid_evo.progress import Progress
from sysid_evo.types import Array
from sysid_evo.validation.folds import make_folds
from sysid_evo.validation.simulation_error import HeldOutTest, Scorer, history_of, horizons_of

HORIZONS = [10, 20, 60]
PROCESSORS = 2
"""Of the machine whose seconds a budget is counted in."""
SHARE = 0.85
"""Of its time that is spent in fits: the rest is starting processes, waiting for the last one, and the mean."""


@register_model("auto")
class Auto(MeanModel):
    """The mean of the next states of the candidates that run free best on what was held out.

    Every candidate (a family with lags and parameters) learns from what is left of the recordings when a group of them
    is held out, ``folds`` times (blocks of time where there is one recording), and runs free there. Its error is that
    after ``horizons`` steps (10, 20, 60): RMSE / standard deviation, the mean over states and horizons. What is far
    behind the first time (1.25 times the gate, and significantly) is not tried again. What fails or diverges is dropped
    with its reason, and so is what is more than ``cutoff`` times as far off as the best; the gate is narrowed where the
    mean of all inside is worse on what was held out than the mean of fewer, but what is not significantly worse than
    the best stays (paired bootstrap). A state space that stands well is trained fully, of a Gaussian process that does
    three are averaged, and each takes the place of the first one if it is better. Those kept learn again from all data;
    what a fully trained state space has learned without each fold stays beside that, unless it is far worse. Each
    class of structure (networks that see earlier samples, networks that do not, polynomials, neighbours, physics)
    weighs as the root of how many of it are kept, and these weigh alike. For a given state the next one is affine in
    the acceleration, so that the mean of next states is that of accelerations. Every member starts each step from the
    mean, and keeps its own memory beside it.

    ``budget`` is in seconds of two processors of today. It decides how many candidates are tried, by how long they are
    *expected* to take and by no clock; what is saved with those that fall behind is spent on more. The same data, seed
    and installed families give the same model on any machine and number of processors, and a slow machine takes longer.
    ``candidates`` names others, such as ``[narx, neural_ode(updates=200)]``, which are all tried; a family alone stands
    for its usual settings. Work that takes long is spread over the processors that this process may use.

    With ``stochastic`` every step adds normal noise: the members' disagreement and the one-step residual on what was
    held out, scaled so that 90 % intervals hold 90 % of free runs of one second there. Such a model has no compiled
    form.
    """

    knowledge = "grey"
    periodic = True
    chooses_families = True
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"budget": 60.0}, "paper": {"budget": 900.0}}
    search_ranges: ClassVar[dict[str, SearchRange]] = {"cutoff": Within(1.0, 2.0)}
    limits: ClassVar[dict[str, Limit]] = {
        "budget": above(0),
        "cutoff": at_least(1),
        "horizons": at_least(1),
        "folds": at_least(1),
    }

    budget: float = 300.0
    candidates: list[str] | None = None
    cutoff: float = 1.25
    horizons: list[int] | None = None
    folds: int = 3
    stochastic: bool = False
    dead_band: bool = False
    max_steps: int | None = 100_000

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        pairs = make_folds(dataset, self.folds)
        tried, left_out = self._tried(dataset)
        if not tried:
            raise IncompatibleSystem(f"auto: expected a candidate for this system, got none: {'; '.join(left_out)}")
        horizons = horizons_of(pairs, self.horizons or HORIZONS)
        history = history_of(pairs, horizons)
        judge = Scorer.of(dataset, [HeldOutTest.of(held, horizons, history) for _, held in pairs])
        seeds = rng.integers(2**32, size=(len(tried), len(pairs) + 1))
        budget = PROCESSORS * SHARE * self.budget if self.candidates is None else math.inf
        costs = sum(one.cost(dataset.system, dataset.n_steps, len(pairs)) for one in tried)
        work = FitWork(progress, min(budget, costs))
        choice = CandidateSelection(dataset, pairs, judge, tried, seeds, budget, work).choice(self.cutoff, self._mean)
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
            self.calibrate(cases, rng, work.still)
        return self

    def _tried(self, dataset: Dataset) -> tuple[list[Candidate], list[str]]:
        """Return the candidates, and why others are not among them. Raises what the registry says of wrong names."""
        if self.candidates is None:
            return candidates_for(dataset.system)
        reasons = [(one, unusable(one, dataset.system)) for one in candidates_named(self.candidates)]
        return [one for one, reason in reasons if not reason], [
            f"{o.name}: {reason}" for o, reason in reasons if reason
        ]

    def _mean(self, models: list[DynamicsModel]) -> Self:
        """Return the mean of models that learned from the same part of the data."""
        return self.of(models, weights_of([structure_of(model) for model in models]))

    def families_used(self) -> tuple[str, ...]:
        tried = plugins() if self.candidates is None else candidates_named(self.candidates)
        return tuple(dict.fromkeys(one.spec.name for one in tried))

    def learned_arrays(self) -> Mapping[str, Declared]:
        return {
            "errors_": Numbers("candidates", "horizons", infinite=True, optional=True),
            "shares_": Numbers("candidates", optional=True),
            "means_": Numbers("gates", 2, infinite=True, optional=True),
        }

    def candidate_ranking(self) -> list[dict[str, str]]:
        """Return a row for every candidate, the best first: its held-out error, its weight, and what it is."""
        found = CandidateRanking.known_to(self)
        return [] if found is None else found.rows()

    @property
    def fit_note(self) -> str:
        found = CandidateRanking.known_to(self)
        return "; ".join(filter(None, (super().fit_note, "" if found is None else found.sentence())))


@dataclass(frozen=True)
class CandidateRanking:
    """The candidates that were judged, the best first, in what a stored model can hold.

    ``errors`` (n, H) at each of the ``horizons``, ``shares`` (n,) of the mean, 0 for those not kept, and a remark each.
    ``failed`` are those that could not be judged, with the reason. ``gate`` was taken of those in ``means`` (g, 2),
    each with the error of the mean of all inside. ``ahead`` is the 95 % interval by which the second best is worse than
    the best (nothing with one candidate).
    """

    candidates: list[str]
    errors: Array
    shares: Array
    remarks: list[str]
    failed: list[str]
    horizons: list[int]
    gate: float
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
        """Sum up a ``choice`` among ``candidates``, the kept of which have these ``weights``."""
        known = {number: error for number, error in enumerate(choice.errors) if error is not None}
        order = sorted(known, key=lambda number: known[number].mean)
        share = dict(zip(choice.kept, weights.tolist(), strict=True))
        kind = {n: structure_of(own[0]) for n, own in zip(choice.kept, choice.models, strict=True)}
        above = f"above {choice.passed.gate:.2f} x the best"
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
            gate=choice.passed.gate,
            means=np.array(choice.passed.compared),
            ahead=[float(value) for value in ahead],
            evaluated_on=held_out_in_words(pairs),
        )

    def learned(self) -> dict[str, Any]:
        """Return it as what a model learns, by name."""
        return {f"{name}_": value for name, value in vars(self).items()}

    @classmethod
    def known_to(cls, model: Any) -> Self | None:
        """Undo `learned`: return how the candidates stood when ``model`` was fitted; None before that."""
        if not hasattr(model, "evaluated_on_"):
            return None
        return cls(**{name: getattr(model, f"{name}_") for name in cls.__dataclass_fields__})

    def rows(self) -> list[dict[str, str]]:
        """Return what to tell of each candidate, the best first."""
        after = f"after {', '.join(map(str, self.horizons))} steps"
        rows = []
        for name, at, weight, remark in zip(self.candidates, self.errors, self.shares, self.remarks, strict=True):
            numbers = {"error": f"{at.mean():.3f}", after: ", ".join(f"{one:.3f}" for one in at)}
            rows.append({"candidate": name, **numbers, "weight": f"{weight:.2f}" if weight else "", "remark": remark})
        for text in self.failed:
            name, _, reason = text.partition(": ")
            rows.append({"candidate": name, "error": "", after: "", "weight": "", "remark": reason})
        return rows

    def sentence(self) -> str:
        """Return what was chosen, by how much, and whether the best is surely better than the second."""
        kept = [
            f"{name} ({at.mean():.3f}, weight {weight:.2f})"
            for name, at, weight in zip(self.candidates, self.errors, self.shares, strict=True)
            if weight > 0.0
        ]
        text = (
            f"kept {len(kept)} of {len(self.candidates)} candidates and is their mean: {', '.join(kept)}; judged by "
            f"free runs of {', '.join(map(str, self.horizons))} steps on {self.evaluated_on}, kept up to "
            f"{self.gate:.2f} x the lowest error; the mean of those within "
            + ", ".join(f"{gate:.2f} x has {error:.3f}" for gate, error in self.means)
        )
        if self.ahead:
            low, high = self.ahead
            surely = "" if low > 0.0 or high < 0.0 else " not"
            text += (
                f"; the best and the second best candidate do{surely} differ significantly (by {low:+.3f} to "
                f"{high:+.3f}, 95 % interval)"
            )
        elif len(self.candidates) > 1:
            text += "; every other candidate fell out in the first turn"
        return text


def held_out_in_words(pairs: Sequence[tuple[Dataset, Dataset]]) -> str:
    """Return what was held out."""
    seen, held = pairs[0]
    if seen is held:
        return "what they had learned from, which is too short to hold anything back"
    pieces = {name.split("[")[0] for name in seen.names} & {name.split("[")[0] for name in held.names}
    what = "blocks of time" if pieces else "whole recordings"
    return f"{what}, held out in {len(pairs)} turns" if len(pairs) > 1 else f"{what} that were held out"
