"""Which candidates of `auto` are tried and kept, and their weights."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from model_zoo.auto.candidates import Candidate
from model_zoo.auto.fitting import FitOutcome, FitTask, FitWork
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidData
from sysid_evo.models import DynamicsModel
from sysid_evo.models.ensemble import MeanModel
from sysid_evo.models.sanity import SanityCheck
from sysid_evo.types import Array, IntArray
from sysid_evo.validation.acceptance import MIN_ERROR, inside
from sysid_evo.validation.simulation_error import Errors, Scorer, long_test

MAX_DIVERGED = 0.05
"""Largest share of a candidate's simulations that may end at its state bounds."""
DROP_FACTOR = 1.25
"""A candidate whose error in the first fold exceeds this multiple of the cutoff is dropped before the other folds."""

REFINE_FACTOR = 2.0
"""A candidate may be refined if its error in the first fold is at most this multiple of the lowest."""

ASTRAY_FACTOR = 2.0
"""A candidate near the best is dropped if its error in long simulations exceeds this multiple of the lowest."""

UNTRIED = "skipped: the budget was used for other candidates"
BASE_BEHIND = "skipped: the shorter version of it was not close to the best"
REPLACED = "replaced by its longer version, which is not significantly worse"


@dataclass(frozen=True)
class CandidateChoice:
    """Outcome for all candidates: by number, `Errors` (None if a fit failed) and the reason against it, if any.

    For a candidate dropped after the first fold the errors are those of this fold. ``kept`` lists the numbers of those
    within the cutoff ``passed``, ``models`` their fits to all data (followed by fold models, if these are kept),
    ``rough`` their fits without each fold.
    """

    errors: list[Errors | None]
    reasons: list[str]
    kept: list[int]
    passed: CutoffComparison
    models: list[list[DynamicsModel]]
    rough: list[list[DynamicsModel]]


@dataclass(frozen=True)
class CandidateSelection:
    """The candidates, the folds, and the seeds (candidates, folds + 1) of their fits.

    As many are tried as are expected to fit into ``budget`` seconds of one processor. No clock is used, so that the
    choice is the same on every machine.
    """

    dataset: Dataset
    pairs: Sequence[tuple[Dataset, Dataset]]
    scorer: Scorer
    candidates: Sequence[Candidate]
    seeds: IntArray
    budget: float
    work: FitWork

    def choice(
        self, cutoff: float, class_cutoff: float, mean: Callable[[list[DynamicsModel]], DynamicsModel]
    ) -> CandidateChoice:
        """Return the candidates within the ``cutoff`` and the best of each class within the ``class_cutoff``.

        ``mean`` averages models. Raises `InvalidData` if none is left.
        """
        folds = range(len(self.pairs))
        outcomes, errors, reasons = self._first_fold(DROP_FACTOR * cutoff, DROP_FACTOR * class_cutoff)
        remaining = [number for number, reason in enumerate(reasons) if not reason]
        outcomes |= self._fits(remaining, folds[1:])
        rough = {number: [outcomes[number, fold] for fold in folds] for number in remaining}
        for number, error, reason in zip(remaining, *fold_errors(list(rough.values()), self.scorer), strict=True):
            errors[number], reasons[number] = error, reason
        usable = {n: error for n, error in enumerate(errors) if error is not None and not reasons[n]}
        for better, number in self._refined.items():
            if better in usable and number in usable and not usable[better].above(usable[number]).low > 0.0:
                reasons[number] = REPLACED
                del usable[number]
        self._expect(len(usable) > 0, reasons)
        useless = self._useless(rough, usable)
        if len(useless) < len(usable):
            for number, reason in useless.items():
                reasons[number] = reason
                del usable[number]
        for number, reason in self._astray(rough, usable).items():
            reasons[number] = reason
            del usable[number]

        def models(number: int) -> list[DynamicsModel]:
            return [outcome.model for outcome in rough[number] if outcome.model is not None]

        def mean_error(group: list[int]) -> float:
            self.work.report_alive()
            fold_models = [[models(numbers[i])[fold] for i in group] for fold in folds]
            means = [mean(parts) for parts in fold_models]
            return self.scorer.errors([t.run(one) for t, one in zip(self.scorer.trials, means, strict=True)]).mean

        numbers = list(usable)
        best = min(usable.values(), key=lambda error: error.mean)
        ties = [i for i, number in enumerate(numbers) if not usable[number].above(best).low > 0.0]
        means = [usable[number].mean for number in numbers]
        each = np.array([self._in_each_fold(rough[number]) for number in numbers])
        leaders = class_leaders(means, each, [structure_of(models(number)[0]) for number in numbers], class_cutoff)
        group, passed = chosen(means, cutoff, mean_error, ties, leaders)
        final = self.work.outcomes([self._task(numbers[i], len(self.pairs)) for i in group])
        kept: dict[int, list[DynamicsModel]] = {}
        for (number, _), outcome in sorted(final.items()):
            if outcome.model is None:
                reasons[number] = outcome.reason
            else:
                others = models(number) if self.candidates[number].keep_fold_models else []
                kept[number] = self._committee([outcome.model, *others], cutoff) if others else [outcome.model]
        self._expect(len(kept) > 0, reasons)
        return CandidateChoice(
            errors, reasons, list(kept), passed, list(kept.values()), [models(number) for number in kept]
        )

    def _in_each_fold(self, outcomes: Sequence[FitOutcome]) -> list[float]:
        """Return the error in each fold."""
        scorers = [replace(self.scorer, trials=(trial,)) for trial in self.scorer.trials]
        runs = [outcome.simulated for outcome in outcomes if outcome.simulated is not None]
        return [scorer.errors([states]).mean for scorer, states in zip(scorers, runs, strict=True)]

    def _useless(self, rough: Mapping[int, Sequence[FitOutcome]], numbers: Iterable[int]) -> dict[int, str]:
        """Return those of the candidates that fail the sanity check in the folds, each with the reason."""
        check, found = SanityCheck.of(*self.pairs), dict[int, str]()
        for number in numbers:
            self.work.report_alive()
            models = [outcome.model for outcome in rough[number] if outcome.model is not None]
            if reason := check.warning(*models):
                found[number] = reason
        return found

    def _astray(self, rough: Mapping[int, Sequence[FitOutcome]], usable: Mapping[int, Errors]) -> dict[int, str]:
        """Return those of the candidates near the best that are far worse in long simulations, with the reasons.

        The models fitted without each fold are simulated through the whole data, two thirds of which they know.
        """
        horizons = self.scorer.trials[0].horizons
        test = long_test(self.dataset, horizons, self.scorer.trials[0].windows.past_controls.shape[1])
        best = min(error.mean for error in usable.values())
        near = [number for number, error in usable.items() if error.mean <= REFINE_FACTOR * best]
        if test is None or len(near) < 2:
            return {}
        long = replace(self.scorer, trials=(test,) * len(self.pairs))
        found = {}
        for number in near:
            self.work.report_alive()
            found[number] = long.errors([test.run(one.model) for one in rough[number] if one.model is not None]).mean
        lowest = max(min(found.values()), MIN_ERROR)
        return {
            number: f"{error / lowest:.1f} x the lowest error in simulations of up to {max(test.horizons)} steps"
            for number, error in found.items()
            if error > ASTRAY_FACTOR * lowest
        }

    def _fits(self, numbers: Iterable[int], folds: Iterable[int]) -> dict[tuple[int, int], FitOutcome]:
        return self.work.outcomes([self._task(number, fold) for number, fold in product(numbers, folds)])

    def _committee(self, models: Sequence[DynamicsModel], cutoff: float) -> list[DynamicsModel]:
        """Return the first of these models, and those of the others that are within the cutoff over all folds.

        The first was fitted to all folds and each of the others to all but one, so hard folds affect all equally.
        """
        self.work.report_alive()
        errors = [self.scorer.errors([trial.run(one) for trial in self.scorer.trials]).mean for one in models]
        return [models[0], *(models[i] for i in inside(errors, cutoff) if i > 0)]

    def _first_fold(
        self, cutoff: float, class_cutoff: float
    ) -> tuple[dict[tuple[int, int], FitOutcome], list[Errors | None], list[str]]:
        """Try candidates in the first fold, as many as can be fitted in all folds and to all data for the budget.

        The time saved by candidates that are dropped (`_screened`) is spent on the next ones. A refinement waits until
        its shorter version was tried, the last of which ends the first batch. Those of leading candidates, with the
        lowest error so far or one not significantly higher, then go first, with at most half of what is left. Returns
        the outcomes, the errors, and why a candidate is not tried in the other folds; empty if it is.
        """
        size = self.dataset.system, self.dataset.n_steps, len(self.pairs)
        costs = {number: candidate.cost(*size) for number, candidate in enumerate(self.candidates)}
        errors: list[Errors | None] = [None for _ in costs]
        reasons = [BASE_BEHIND if number in self._refined else UNTRIED for number in costs]
        outcomes: dict[tuple[int, int], FitOutcome] = {}
        plain = affordable({n: cost for n, cost in costs.items() if n not in self._refined}, self.budget) or [0]
        end = max((plain.index(n) + 1 for n in self._refined.values() if n in plain), default=len(plain))
        batch, waiting = plain[:end], plain[end:]
        while batch:
            outcomes |= self._fits(batch, [0])
            tried = [number for number, _ in sorted(outcomes)]
            found = self._screened([outcomes[number, 0] for number in tried], cutoff, class_cutoff)
            for number, error, reason in zip(tried, *found, strict=True):
                errors[number], reasons[number] = error, reason
            if waiting:
                left = self.budget - sum(costs[n] for n in tried)
                leading = [n for n, shorter in self._refined.items() if self._leads(shorter, errors)]
                longer = affordable({n: costs[n] for n in leading}, 0.5 * left)
                left -= sum(costs[n] for n in longer)
                batch, waiting = [*longer, *affordable({n: costs[n] for n in waiting}, left)], []
                continue
            spent = sum(self._task(n, 0).cost if reasons[n] else costs[n] for n in tried)
            ready = [n for n in costs if n not in tried and self._may_be_tried(n, errors)]
            ready.sort(key=lambda n: n not in self._refined)  # longer versions of good candidates first
            for n in ready:
                reasons[n] = UNTRIED
            batch = affordable({n: costs[n] for n in ready}, self.budget - spent)
        return outcomes, errors, reasons

    @cached_property
    def _refined(self) -> dict[int, int]:
        """The candidate that each refinement extends, by the numbers of both."""
        every = {one.name: number for number, one in enumerate(self.candidates)}
        return {n: every[one.successor_of] for n, one in enumerate(self.candidates) if one.successor_of in every}

    def _may_be_tried(self, number: int, errors: Sequence[Errors | None]) -> bool:
        """Whether a candidate is no refinement, or the ``errors`` of its shorter version are close to the lowest."""
        if number not in self._refined:
            return True
        found = errors[self._refined[number]]
        return found is not None and found.mean <= REFINE_FACTOR * min(one.mean for one in errors if one is not None)

    def _leads(self, number: int, errors: Sequence[Errors | None]) -> bool:
        """Whether no error in the first fold is significantly lower than that of a candidate."""
        known = [one for one in errors if one is not None and np.isfinite(one.mean)]
        best, own = min(known, key=lambda one: one.mean, default=None), errors[number]
        return own is not None and best is not None and not own.above(best).low > 0.0

    def _screened(
        self, outcomes: Sequence[FitOutcome], cutoff: float, class_cutoff: float
    ) -> tuple[list[Errors | None], list[str]]:
        """Return the errors in the first fold, and why a candidate is dropped; empty if it is not.

        It is dropped if its error is above ``cutoff`` times the lowest and significantly so (paired bootstrap), unless
        it is the best of its class and within ``class_cutoff``.
        """
        errors, reasons = fold_errors([[one] for one in outcomes], replace(self.scorer, trials=self.scorer.trials[:1]))
        usable = [error for error, reason in zip(errors, reasons, strict=True) if error is not None and not reason]
        best = min(usable, key=lambda error: error.mean, default=None)
        known = [n for n, error in enumerate(errors) if error is not None and not reasons[n]]
        structures = [structure_of(model) for n in known if (model := outcomes[n].model) is not None]
        means = [error.mean for error in usable]
        leaders = class_leaders(means, np.array(means)[:, None], structures, class_cutoff) if usable else []
        spared = {known[leader] for leader in leaders}
        for number, error in enumerate(errors):
            if best is None or error is None or len(self.pairs) == 1 or number in spared:
                continue
            if error.mean > cutoff * best.mean and error.above(best).low > 0.0:
                times = f"{error.mean / best.mean:.1f} x the lowest error in the first of {len(self.pairs)} folds"
                reasons[number] = reasons[number] or times
        return errors, reasons

    def _task(self, number: int, fold: int) -> FitTask:
        """Return the fit of one candidate without one fold, or to all data after the last of them."""
        one, selecting = self.candidates[number], fold < len(self.pairs)
        part = self.pairs[fold][0] if selecting else self.dataset
        return FitTask(
            (number, fold),
            one.spec.name,
            {**one.spec.parameters, **(one.selection_settings if selecting else {})},
            part,
            int(self.seeds[number, fold]),
            one.seconds_for(part.system, part.n_steps, rough=selecting),
            self.scorer.trials[fold] if selecting else None,
        )

    def _expect(self, found: bool, reasons: Sequence[str]) -> None:
        if not found:
            pairs = zip(self.candidates, reasons, strict=True)
            raise InvalidData(
                "auto: expected a candidate that can be fitted and simulated, got none: "
                + "; ".join(f"{one.name}: {reason}" for one, reason in pairs if reason)
            )


def fold_errors(rough: Sequence[Sequence[FitOutcome]], scorer: Scorer) -> tuple[list[Errors | None], list[str]]:
    """Return the errors of every candidate (None if a fit failed), and why it cannot be used (empty if it can).

    If all diverge, those that could be simulated are used.
    """
    errors: list[Errors | None] = []
    reasons: list[str] = []
    for folds in rough:
        reason = next((outcome.reason for outcome in folds if outcome.simulated is None), "")
        runs = [outcome.simulated for outcome in folds if outcome.simulated is not None]
        found = None if reason else scorer.errors(runs)
        share = max(outcome.diverged for outcome in folds)
        if found is not None and not np.isfinite(found.mean):
            found, reason = None, "its simulations are not finite"
        elif found is not None and share > MAX_DIVERGED:
            reason = f"{100 * share:.0f} % of its simulations diverge"
        errors.append(found)
        reasons.append(reason)
    if all(reasons):
        reasons = [reason if error is None else "" for error, reason in zip(errors, reasons, strict=True)]
    return errors, reasons


NARROWER = (1.0, 0.5, 0.25, 0.0)
"""The cutoffs that are compared, as shares of the distance from the best to the widest."""
AS_GOOD = 0.01
"""Share of the lowest error by which the mean of more candidates may be worse than that of fewer."""


LEADER_COST = 0.05
"""Share by which the best of other classes, which help in other conditions, may increase the error of the mean."""


@dataclass(frozen=True)
class CutoffComparison:
    """The ``cutoff`` that was chosen, and the error of the mean of all candidates within each one compared."""

    cutoff: float
    compared: tuple[tuple[float, float], ...]


def weights_of(structures: Sequence[str]) -> Array:
    """Return the weights (M,) of members of these classes; a class has the square root of its number of members.

    Within a class they are equal; their sum is 1. Models of different structure have different errors, while seeds and
    settings of one structure have similar ones: a class of many counts more than a class of one, but less than as many
    classes.
    """
    count = Counter(structures)
    found = np.array([1.0 / np.sqrt(count[structure]) for structure in structures])
    return np.asarray(found / found.sum())


def class_leaders(errors: Sequence[float], each: Array, structures: Sequence[str], cutoff: float) -> list[int]:
    """Return the numbers of the candidates with the lowest error of their class, if that is within the ``cutoff``.

    So must be the geometric mean over the folds of their error in ``each`` (candidates, folds) divided by that of the
    best: where the best fails in one fold only, candidates far worse in all others are near it over all folds.
    """
    best = {structures[number]: number for number in sorted(range(len(errors)), key=lambda n: -errors[n])}
    typical = np.exp(np.log(np.maximum(each, MIN_ERROR)).mean(axis=1))
    near = typical <= cutoff * typical[int(np.argmin(errors))]
    return sorted(number for number in set(best.values()) & set(inside(errors, cutoff)) if near[number])


def chosen(
    errors: Sequence[float],
    cutoff: float,
    mean_error: Callable[[list[int]], float],
    ties: Collection[int] = (),
    leaders: Collection[int] = (),
) -> tuple[list[int], CutoffComparison]:
    """Return the numbers of the candidates that are kept, and the comparison of the cutoffs.

    The cutoff is the widest whose mean has an error (``mean_error``) within 1 % of the lowest. ``ties``, candidates not
    significantly worse than the best, are kept within the widest cutoff, and ``leaders`` (`class_leaders`) if the error
    of the mean is at most `LEADER_COST` higher with them.
    """
    widest = inside(errors, cutoff)
    found: dict[tuple[int, ...], float] = {}

    def narrowed(always: Collection[int]) -> tuple[list[int], CutoffComparison]:
        groups = {}
        for one in (1.0 + share * (cutoff - 1.0) for share in NARROWER):
            within = inside(errors, one)
            group = groups[one] = tuple(sorted({*always, *(n for n in widest if n in ties or n in within)}))
            if group not in found:
                found[group] = errors[group[0]] if len(group) == 1 else mean_error(list(group))
        compared = {one: found[group] for one, group in groups.items()}
        lowest = min(compared.values())
        taken = next(one for one, error in compared.items() if error <= (1.0 + AS_GOOD) * lowest)
        return list(groups[taken]), CutoffComparison(taken, tuple(compared.items()))

    group, passed = narrowed(leaders)
    others, passed_others = narrowed(())
    kept = found[tuple(group)] <= (1.0 + LEADER_COST) * found[tuple(others)]
    return (group, passed) if kept else (others, passed_others)


def affordable(costs: Mapping[int, float], left: float) -> list[int]:
    """Return the candidates that fit into what is ``left`` of the budget, in the order of ``costs``."""
    taken: list[int] = []
    for number, cost in costs.items():
        if cost <= left:
            taken.append(number)
            left -= cost
    return taken


def structure_of(model: DynamicsModel) -> str:
    """Return the class of a fitted ``model`` for its weight.

    That is the ``model_class`` of its family, for networks with or without lags; for a mean that of its members, if
    they have only one. A family without one counts as physics if its ``knowledge`` is grey or white, else as other.
    """
    if isinstance(model, MeanModel):
        inside = {structure_of(member) for member in model.members_}
        return inside.pop() if len(inside) == 1 else "several structures"
    declared = type(model).model_class or ("physics" if model.knowledge in ("grey", "white") else "other")
    if declared != "network":
        return declared
    return "network with lags" if model.n_carry > model.system.nx else "network without lags"
