"""Summary of the matrix for each controller: claimed, achieved, gaps, worst case; the recommended one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from evaluation.transfer.forecast import Forecast, best_choice, forecasts
from evaluation.transfer.matrix import TransferMatrix
from sysid_evo.evolution import Champion
from sysid_evo.evolution.aggregates import Aggregate, make_aggregate, mean
from sysid_evo.types import Array
from sysid_evo.validation.acceptance import surely_more
from sysid_evo.validation.estimates import Draws, Estimate, draw_blocks, estimate_of


@dataclass(frozen=True)
class TransferSummary:
    """All controllers, the one chosen without the robot, and correlations of figures with success on the robot.

    ``pick`` is None until one is chosen, see `best_choice`. Controllers evolved on the robot itself, and people, are
    left out of the correlations: the former achieve their claim, the latter have none.
    """

    controllers: tuple[ControllerSummary, ...]
    pick: str | None
    correlations: tuple[RankCorrelation, ...]

    def controller(self, name: str) -> ControllerSummary:
        return next(controller for controller in self.controllers if controller.name == name)


@dataclass(frozen=True)
class ControllerSummary:
    """One controller: fitness where it was evolved, elsewhere, and on the robot; None if unknown.

    ``claimed`` is the fitness on the models it was evolved against, aggregated as in its evolution. ``other_models`` is
    the mean over all other models, ``other_families`` the median over the ``other_family_models``, the models of
    families that it was not evolved against. ``achieved`` is the fitness on the robot. ``exploitation_gap`` is claimed
    minus others, ``reality_gap`` claimed minus achieved. ``kept`` is the share of the claim that is achieved on the
    robot, or else on other models, both measured from controls at rest if those were run, since fitness may be
    negative. ``worst`` is the mean fitness on ``worst_on``, the system where it is lowest among all that it was not
    evolved against.

    ``seed_fitness`` is that of the champion of each evolution run; ``polished`` as in `Champion`. ``rest_fitness`` is
    the fitness of controls at rest on the robot, if those were run.
    """

    name: str
    against: tuple[str, ...]
    aggregate: str
    claimed: Estimate | None
    other_models: Estimate | None
    other_families: Estimate | None
    achieved: Estimate | None
    exploitation_gap: Estimate | None
    reality_gap: Estimate | None
    kept: Estimate | None
    worst: Estimate | None
    worst_on: str
    other_family_models: tuple[str, ...]
    evolved_on_robot: bool
    seed_fitness: tuple[float, ...] = ()
    polished: bool = False
    rest_fitness: float | None = None

    @property
    def elsewhere(self) -> Estimate | None:
        """Fitness on the robot, or on the other models if it was not run on a robot."""
        return self.other_models if self.achieved is None else self.achieved

    @property
    def gap(self) -> Estimate | None:
        """Its claim minus the fitness elsewhere."""
        return self.exploitation_gap if self.achieved is None else self.reality_gap

    @property
    def exploited(self) -> bool | None:
        """Whether its claim is exploited; None if this cannot be decided, or it was evolved on the robot itself."""
        return None if self.evolved_on_robot else is_exploited(self.claimed, self.gap)

    def share_of(self, fitness: float) -> float | None:
        """Return the share of ``fitness`` that is achieved on the robot, both measured from controls at rest."""
        floor = self.rest_fitness or 0.0
        if self.achieved is None or fitness <= floor:
            return None
        return (self.achieved.value - floor) / (fitness - floor)


@dataclass(frozen=True)
class RankCorrelation:
    """Spearman's rank correlation of a figure with achieved fitness over ``controllers`` controllers."""

    figure: str
    value: float | None
    controllers: int


def summary_of(matrix: TransferMatrix) -> TransferSummary:
    """Return the summary of a matrix whose models have the same weight, with a pick by `best_choice`."""
    found = forecasts(matrix, {})
    return chosen_by(summarise(matrix), found, best_choice(matrix, found))


def chosen_by(summary: TransferSummary, found: Mapping[str, Forecast], pick: str | None) -> TransferSummary:
    """Return ``summary`` with this ``pick``, see `best_choice`, and the rank correlation of the forecast."""
    evolved = [one for one in summary.controllers if one.name in found and one.against and not one.evolved_on_robot]
    if pick is None:
        return replace(summary, pick=None)
    pairs = [(found[one.name].value, one.achieved.value) for one in evolved if one.achieved is not None]
    ranked = (RankCorrelation("forecast", rank_correlation(pairs), len(pairs)),) if summary.correlations else ()
    return replace(summary, pick=pick, correlations=(*summary.correlations, *ranked))


def summarise(matrix: TransferMatrix) -> TransferSummary:
    """Summarise the matrix, without a pick."""
    figures = MatrixEstimates(matrix)
    controllers = tuple(figures.summary(champion) for champion in matrix.champions)
    elsewhere = [c for c in controllers if c.against and not c.evolved_on_robot]
    correlations = []
    for figure, name in (("claimed", "claimed"), ("median on other families", "other_families")):
        both = [(getattr(one, name), one.achieved) for one in elsewhere]
        pairs = [(a.value, b.value) for a, b in both if a is not None and b is not None]
        correlations.append(RankCorrelation(figure, rank_correlation(pairs), len(pairs)))
    return TransferSummary(
        controllers=controllers,
        pick=None,
        correlations=tuple(correlations) if matrix.robot is not None else (),
    )


LEAST_GAP = 0.1
"""A claim is exploited only if the gap is more than this share of it."""


def is_exploited(claimed: Estimate | None, gap: Estimate | None) -> bool | None:
    """Return whether a claim exceeds the fitness elsewhere by a tenth of it, and by two standard errors.

    None without a claim or another system, or if a single trial leaves the error unknown.
    """
    if claimed is None or gap is None or not np.isfinite(gap.standard_error):
        return None
    return surely_more(gap, LEAST_GAP * abs(claimed.value))


FEWEST = 3
"""Minimum number of pairs; two are always in order."""


def rank_correlation(pairs: Sequence[tuple[float, float]]) -> float | None:
    """Return Spearman's correlation, None for fewer than three pairs or if one side is constant."""
    first, second = [a for a, _ in pairs], [b for _, b in pairs]
    if len(pairs) < FEWEST or len(set(first)) < 2 or len(set(second)) < 2:
        return None
    return float(np.corrcoef(mean_ranks(first), mean_ranks(second))[0, 1])


def mean_ranks(values: Sequence[float]) -> Array:
    """Return the rank (n,) of each of ``values``, from 1; equal ones share the mean of theirs."""
    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    ranks: Array = np.cumsum(count) - 0.5 * (count - 1.0)
    return ranks[place]


_draws_of = lru_cache(maxsize=4)(draw_blocks)
"""The draws that all figures over that many trials share; making them takes longer than using them."""


@dataclass(frozen=True)
class MatrixEstimates:
    """Figures of the controllers of a matrix, with their draws of trials.

    All systems are run in the same trials, so that figures over equal numbers of them are paired. On a robot trials may
    be missing, which changes those after them: for other numbers of trials the draws are independent.
    """

    matrix: TransferMatrix

    def on(self, champion: Champion, columns: Sequence[str], rule: Aggregate | None = None) -> Draws | None:
        """Return the fitness on ``columns``, over the trials that were run on all; None if one was not run.

        ``rule`` aggregates several systems, by default the rule of the controller's evolution: on the systems it was
        evolved against this is its claim. A single system is aggregated in the same way, so that both are comparable.
        """
        cells = [self.matrix.cell(champion.name, column) for column in columns if column in self.matrix.columns]
        if not cells or len(cells) < len(columns) or any(cell.failed for cell in cells):
            return None
        trials = min(cell.trials for cell in cells)
        fitness = np.stack([cell.fitness[:trials] for cell in cells])
        rule = make_aggregate(champion.aggregate) if rule is None else rule
        return Draws(np.concatenate([rule(fitness[:, None]), rule(fitness[:, _draws_of(trials)])]), trials)

    def on_each(self, champion: Champion, columns: Sequence[str]) -> list[Draws]:
        """Return the fitness on each of ``columns`` that it was run on, by the rule of its evolution."""
        return [found for column in columns if (found := self.on(champion, [column])) is not None]

    def elsewhere(self, champion: Champion) -> Draws | None:
        """Return the fitness on the robot, without one the mean over the models that it was not evolved against."""
        return self.others(champion) if self.matrix.robot is None else self.on(champion, [self.matrix.robot])

    def others(self, champion: Champion) -> Draws | None:
        """Return the mean fitness over the models that it was run on and not evolved against."""
        others = [column for column in self.matrix.models if column not in champion.against]
        return Draws.joined(self.on_each(champion, others))

    def summary(self, champion: Champion) -> ControllerSummary:
        """Return the summary of one controller."""
        robot = self.matrix.robot
        claimed, others = self.on(champion, champion.against), self.others(champion)
        achieved = None if robot is None else self.on(champion, [robot])
        worst, worst_on = self.worst(champion)
        rest = None if self._rest is None or robot is None else self.on(self._rest, [robot])
        return ControllerSummary(
            name=champion.name,
            against=champion.against,
            aggregate=champion.aggregate,
            claimed=estimate_of(claimed),
            other_models=estimate_of(others),
            other_families=estimate_of(self.other_families(champion)),
            achieved=estimate_of(achieved),
            exploitation_gap=_gap(claimed, others),
            reality_gap=_gap(claimed, achieved),
            kept=self._kept(claimed, self.elsewhere(champion)),
            worst=estimate_of(worst),
            worst_on=worst_on,
            other_family_models=other_family_models(champion, self.matrix),
            evolved_on_robot=robot is not None and robot in champion.against,
            seed_fitness=tuple(champion.seed_fitness),
            polished=champion.polished,
            rest_fitness=None if rest is None else rest.value,
        )

    @cached_property
    def _rest(self) -> Champion | None:
        return next((one for one in self.matrix.champions if one.name in self.matrix.at_rest), None)

    def _kept(self, claimed: Draws | None, achieved: Draws | None) -> Estimate | None:
        """Return the share of a positive claim that is achieved, both measured from controls at rest."""
        if claimed is None or achieved is None:
            return None
        floor = None if self._rest is None else self.elsewhere(self._rest)
        if floor is not None:
            claimed, achieved = claimed - floor, achieved - floor
        return (achieved / claimed).estimate if claimed.value > 0.0 else None

    def other_families(self, champion: Champion) -> Draws | None:
        """Return the median over the models of families that it was not evolved in."""
        return Draws.joined(self.on_each(champion, other_family_models(champion, self.matrix)), np.median)

    def worst(self, champion: Champion) -> tuple[Draws | None, str]:
        """Return the fitness on the system where it is lowest, and that system, of those it was not evolved against."""
        others = [column for column in self.matrix.columns if column not in champion.against]
        found = {column: one for column in others if (one := self.on(champion, [column], mean)) is not None}
        lowest = min(found, key=lambda column: found[column].value, default="")
        return found.get(lowest), lowest


def other_family_models(champion: Champion, matrix: TransferMatrix) -> tuple[str, ...]:
    """Return the models of families that a controller was not evolved in, on which it was run."""
    families = {matrix.families.get(column, column) for column in champion.against}
    others = [column for column in matrix.models if matrix.families[column] not in families]
    return tuple(column for column in others if not matrix.cell(champion.name, column).failed)


def _gap(claimed: Draws | None, achieved: Draws | None) -> Estimate | None:
    return None if claimed is None or achieved is None else (claimed - achieved).estimate
