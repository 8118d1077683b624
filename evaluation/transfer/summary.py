"""What the matrix says of each controller: claimed, achieved, gaps, worst case, regret; and which one to drive."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from evaluation.transfer.forecast import Forecast, forecasts, highest
from evaluation.transfer.matrix import TransferMatrix
from evaluation.transfer.uncertainty import Estimate, PairedEstimate
from sysid_evo.evolution import Champion
from sysid_evo.evolution.aggregates import Aggregate, make_aggregate, mean, median
from sysid_evo.types import Array


@dataclass(frozen=True)
class TransferSummary:
    """All controllers, the one to pick without the robot, and what would have predicted success.

    ``pick`` is None until one is chosen, by its forecast: see `chosen_by`. Controllers evolved on the robot itself,
    and people, are left out of the correlations: what the first claim is what they achieve, and people claim nothing.
    """

    controllers: tuple[ControllerSummary, ...]
    pick: str | None
    best_on: Mapping[str, str | None]
    correlations: tuple[RankCorrelation, ...]

    def controller(self, name: str) -> ControllerSummary:
        return next(controller for controller in self.controllers if controller.name == name)


@dataclass(frozen=True)
class ControllerScores:
    """What a controller does in the matrix; None where nothing is known.

    ``claimed`` is the fitness on the models it was evolved against, made one as in its evolution; ``achieved`` that on
    the robot, without one the mean over the other models, and ``gap`` the first less the second. ``kept`` is the share
    of the claim that is achieved, both measured from controls at rest where those were run. ``worst`` is the fitness
    on ``worst_on``, the system where it is lowest, of all that it was not evolved against. ``regret`` is what the best
    other controller achieves more, at least 0; without a robot the most that this is on one of the other models,
    where only controllers that were not evolved there count. What was evolved on the robot itself has no regret and
    is regretted by none.
    """

    claimed: Estimate | None = None
    achieved: Estimate | None = None
    gap: Estimate | None = None
    kept: Estimate | None = None
    worst: Estimate | None = None
    worst_on: str = ""
    regret: Estimate | None = None


@dataclass(frozen=True)
class ControllerSummary:
    """One controller: fitness where it was evolved, elsewhere, and on the robot.

    ``claimed`` is the fitness on the models it was evolved against, made one as in its evolution;
    ``others`` the mean over all other models; ``other_families`` the median over the
    ``judges``, the models of families that it was not evolved against; ``achieved`` that on the
    robot. ``exploitation_gap`` is claimed minus others, ``reality_gap`` claimed minus achieved.
    None where there is nothing to tell. ``seed_fitness`` is that of the champion of each evolution run;
    ``polished`` as in `Champion`. ``floor`` is what controls at rest achieve on the robot, if that was run: shares
    are measured from there, since fitness may be negative; else from 0. ``standing`` says with intervals over trials
    what is to be expected of it.
    """

    name: str
    against: tuple[str, ...]
    aggregate: str
    claimed: Estimate | None
    others: Estimate | None
    other_families: Estimate | None
    achieved: Estimate | None
    exploitation_gap: Estimate | None
    reality_gap: Estimate | None
    judges: tuple[str, ...]
    on_robot: bool
    seed_fitness: tuple[float, ...] = ()
    polished: bool = False
    floor: float | None = None
    standing: ControllerScores = field(default_factory=ControllerScores)

    @property
    def elsewhere(self) -> Estimate | None:
        """Fitness on the robot, or on the other models where it was not run on a robot."""
        return self.others if self.achieved is None else self.achieved

    @property
    def shown(self) -> Mapping[str, Estimate]:
        """What there is of claimed, others, other_families and achieved, with the intervals of its scores."""
        at, elsewhere = self.standing, "others" if self.achieved is None else "achieved"
        found = {"claimed": self.claimed, "others": self.others, "other_families": self.other_families}
        found |= {"achieved": self.achieved, "claimed": at.claimed or self.claimed}
        found[elsewhere] = at.achieved or found[elsewhere]
        return {name: estimate for name, estimate in found.items() if estimate is not None}

    @property
    def exploited(self) -> bool | None:
        """Whether its claim is exploited; None where that cannot be said, or it was evolved on the robot itself."""
        gap = self.exploitation_gap if self.achieved is None else self.reality_gap
        return None if self.on_robot else is_exploited(self.claimed, gap)

    @property
    def kept(self) -> float | None:
        """The share of the claim that the robot shows."""
        return None if self.claimed is None else self.share_of(self.claimed.value)

    def share_of(self, fitness: float) -> float | None:
        """Return the share of ``fitness`` that is achieved on the robot, both measured from the floor."""
        floor = self.floor or 0.0
        if self.achieved is None or fitness <= floor:
            return None
        return (self.achieved.value - floor) / (fitness - floor)


@dataclass(frozen=True)
class RankCorrelation:
    """Spearman's rank correlation of a figure with achieved fitness over ``controllers`` controllers."""

    figure: str
    value: float | None
    controllers: int


def summary_of(matrix: TransferMatrix, errors: Mapping[str, float | None] | None = None) -> TransferSummary:
    """Return the summary of a matrix with the controller of the highest forecast as its pick.

    Without the prediction ``errors`` of its models (see `error_of`) all are believed alike.
    """
    return chosen_by(summarise(matrix), forecasts(matrix, errors or {}))


FIGURE = "forecast"


def chosen_by(summary: TransferSummary, found: Mapping[str, Forecast]) -> TransferSummary:
    """Return ``summary`` with the evolved controller of the highest forecast as its pick, and how forecasts rank.

    Where no controller that was evolved in models has one, nothing is picked.
    """
    evolved = [one for one in summary.controllers if one.name in found and one.against and not one.on_robot]
    if not evolved:
        return replace(summary, pick=None)
    best = highest(found, [one.name for one in evolved])
    pairs = [(found[one.name].value, one.achieved.value) for one in evolved if one.achieved is not None]
    ranked = (RankCorrelation(FIGURE, rank_correlation(pairs), len(pairs)),) if summary.correlations else ()
    return replace(summary, pick=best, correlations=(*summary.correlations, *ranked))


def summarise(matrix: TransferMatrix, *, seed: int = 0) -> TransferSummary:
    """Condense the matrix, nothing picked yet; ``seed`` is that of the bootstrap over trials."""
    controllers = tuple(_controller(champion, matrix, seed) for champion in matrix.champions)
    at_rest = matrix.at_rest
    floor = next((c.achieved.value for c in controllers if c.name in at_rest and c.achieved is not None), None)
    standing = standings(matrix, next(iter(at_rest), None))
    controllers = tuple(replace(one, floor=floor, standing=standing[one.name]) for one in controllers)
    elsewhere = [c for c in controllers if c.against and not c.on_robot]
    correlations = []
    for figure, name in (("claimed", "claimed"), ("median on other families", "other_families")):
        both = [(getattr(one, name), one.achieved) for one in elsewhere]
        pairs = [(a.value, b.value) for a, b in both if a is not None and b is not None]
        correlations.append(RankCorrelation(figure, rank_correlation(pairs), len(pairs)))
    return TransferSummary(
        controllers=controllers,
        pick=None,
        best_on={column: matrix.best(column) for column in matrix.columns},
        correlations=tuple(correlations) if matrix.robot is not None else (),
    )


def _controller(champion: Champion, matrix: TransferMatrix, seed: int) -> ControllerSummary:
    name, against = champion.name, champion.against
    judges = judges_of(champion, matrix)
    others = [column for column in matrix.models if column not in against]

    def alone(columns: Sequence[str]) -> list[Array]:
        found = [fitness_on(champion, [column], matrix, seed=seed) for column in columns]
        return [draws for draws in found if draws is not None]

    claimed = fitness_on(champion, against, matrix, seed=seed)
    elsewhere, judged = alone(others), alone(judges)
    mean = np.mean(elsewhere, axis=0) if elsewhere else None
    median = np.median(judged, axis=0) if judged else None
    achieved = None if matrix.robot is None else fitness_on(champion, [matrix.robot], matrix, seed=seed)
    return ControllerSummary(
        name=name,
        against=against,
        aggregate=champion.aggregate,
        claimed=Estimate.of(claimed),
        others=Estimate.of(mean),
        other_families=Estimate.of(median),
        achieved=Estimate.of(achieved),
        exploitation_gap=Estimate.of(None if claimed is None or mean is None else claimed - mean),
        reality_gap=Estimate.of(None if claimed is None or achieved is None else claimed - achieved),
        judges=judges,
        on_robot=matrix.robot is not None and matrix.robot in against,
        seed_fitness=tuple(champion.seed_fitness),
        polished=champion.polished,
    )


RESAMPLES = 1000
LEAST_GAP = 0.1
"""A claim is exploited only if the gap is more than this share of it."""
SURE = 2.0
"""A claim is exploited only if the gap is more than this many standard errors."""


def fitness_on(champion: Champion, columns: Sequence[str], matrix: TransferMatrix, *, seed: int = 0) -> Array | None:
    """Return a controller's fitness on ``columns``, then that of every bootstrap draw of trials, (1 + RESAMPLES,).

    On the models it was evolved against this is its claim. Several systems are made one by the rule of its
    evolution; one system goes through the same rule, so that any two of these figures can be compared. None
    unless the controller was run on all of them.

    Each of E trials is drawn E - 1 times, which makes the spread of a mean that of n - 1 (Rao and Wu 1988).
    Systems with as many trials meet the same draws, so that differences between them are paired. A single
    trial has no spread: its draws are nan.
    """
    cells = [matrix.cell(champion.name, column) for column in columns if column in matrix.columns]
    if not cells or len(cells) < len(columns) or any(cell.failed for cell in cells):
        return None
    trials = min(cell.trials for cell in cells)
    fitness = np.stack([cell.fitness[:trials] for cell in cells])
    rule = make_aggregate(champion.aggregate)
    value = rule(fitness[:, None])
    if trials < 2:
        return np.concatenate([value, np.full(RESAMPLES, np.nan)])
    picks = np.random.default_rng(seed).integers(0, trials, (RESAMPLES, trials - 1))
    return np.concatenate([value, rule(fitness[:, picks])])


def is_exploited(claimed: Estimate | None, gap: Estimate | None) -> bool | None:
    """Say whether a claim exceeds what is achieved elsewhere by a tenth of it and by two standard errors.

    None where nothing is claimed, there is nowhere else, or a single trial leaves the error unknown.
    """
    if claimed is None or gap is None or not np.isfinite(gap.standard_error):
        return None
    return gap.value > max(LEAST_GAP * abs(claimed.value), SURE * gap.standard_error)


FEWEST = 3
"""Pairs; two are always in order."""


def rank_correlation(pairs: Sequence[tuple[float, float]]) -> float | None:
    """Return Spearman's correlation, None for fewer than three pairs or where one side is all equal."""
    first, second = [a for a, _ in pairs], [b for _, b in pairs]
    if len(pairs) < FEWEST or len(set(first)) < 2 or len(set(second)) < 2:
        return None
    return float(np.corrcoef(mean_ranks(first), mean_ranks(second))[0, 1])


def mean_ranks(values: Sequence[float]) -> Array:
    """Return the rank (n,) of each of ``values``, from 1; equal ones share the mean of theirs."""
    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    ranks: Array = np.cumsum(count) - 0.5 * (count - 1.0)
    return ranks[place]


@dataclass(frozen=True)
class Figures:
    """Figures of the controllers of a matrix.

    Shares of the claim are measured from the fitness of ``at_rest``, the name of the controller that does nothing; None
    to measure from 0.
    """

    matrix: TransferMatrix
    at_rest: str | None = None

    @cached_property
    def singles(self) -> Mapping[tuple[str, str], PairedEstimate]:
        """The mean fitness of every controller on every column that it was run on."""
        return {
            (one.name, column): figure
            for column in self.matrix.columns
            for one in self.matrix.champions
            if (figure := self.on(one, [column], mean)) is not None
        }

    def on(self, champion: Champion, columns: Sequence[str], rule: Aggregate) -> PairedEstimate | None:
        """Return the figure on ``columns``, over the trials that were run on all; None if one was not run."""
        cells = [self.matrix.cell(champion.name, column) for column in columns if column in self.matrix.columns]
        if not cells or len(cells) < len(columns) or any(cell.failed for cell in cells):
            return None
        trials = min(cell.trials for cell in cells)
        return PairedEstimate.of(champion.name, np.stack([cell.fitness[:trials] for cell in cells]), rule)

    @cached_property
    def claimed(self) -> Mapping[str, PairedEstimate]:
        """The fitness of each on what it was evolved against, by the rule of its evolution."""
        return self._of_all(lambda one: self.on(one, one.against, make_aggregate(one.aggregate)))

    @cached_property
    def elsewhere(self) -> Mapping[str, PairedEstimate]:
        """The fitness of each on the robot, without one the mean over the models that it was not evolved against."""
        robot = self.matrix.robot
        if robot is not None:
            return {name: figure for (name, column), figure in self.singles.items() if column == robot}
        return self._of_all(lambda one: self.on(one, self._run(one, self.matrix.models), mean))

    @cached_property
    def gap(self) -> Mapping[str, PairedEstimate]:
        """What each claims less what it achieves."""
        return {name: self.claimed[name] - self.elsewhere[name] for name in self._with_both}

    @cached_property
    def kept(self) -> Mapping[str, PairedEstimate]:
        """The share of a positive claim that each achieves, both measured from controls at rest."""
        floor = None if self.at_rest is None else self.elsewhere.get(self.at_rest)
        found = {}
        for name in self._with_both:
            claimed, achieved = self.claimed[name], self.elsewhere[name]
            if floor is not None:
                claimed, achieved = claimed - floor, achieved - floor
            if claimed.value > 0.0:
                found[name] = achieved.over(claimed)
        return found

    def consensus(self, champion: Champion) -> PairedEstimate | None:
        """Return the median over the models of families that it was not evolved in."""
        return self.on(champion, judges_of(champion, self.matrix), median)

    def worst(self, champion: Champion) -> tuple[PairedEstimate | None, str]:
        """Return the fitness on the system where it is lowest, and which one that is."""
        columns = self._run(champion, self.matrix.columns)
        found = {column: self.singles[key] for column in columns if (key := (champion.name, column)) in self.singles}
        lowest = min(found, key=lambda column: found[column].value, default="")
        return found.get(lowest), lowest

    def regret(self, champion: Champion) -> PairedEstimate | None:
        """Return what the best other controller has more: on the robot, else where it is most.

        Where several are equally good the best is so by chance, too, and what it is better by is a little too much.
        """
        robot = self.matrix.robot
        if robot is not None and robot in champion.against:
            return None
        columns = [robot] if robot is not None else self._run(champion, self.matrix.models)
        found = []
        for column in columns:
            own = self.singles.get((champion.name, column))
            rivals = [one.name for one in self.matrix.champions if column not in one.against]
            others = [
                self.singles[name, column]
                for name in rivals
                if name != champion.name and (name, column) in self.singles
            ]
            if own is not None and others:
                found.append(max(others, key=lambda other: other.value) - own)
        return max(found, key=lambda figure: figure.value, default=None)

    @property
    def _with_both(self) -> list[str]:
        """Return the controllers whose claim is known, and what they achieve."""
        return [name for name in self.claimed if name in self.elsewhere]

    def _of_all(self, figure: Callable[[Champion], PairedEstimate | None]) -> dict[str, PairedEstimate]:
        """Return a figure of every controller that has it."""
        found = {one.name: figure(one) for one in self.matrix.champions}
        return {name: one for name, one in found.items() if one is not None}

    def _run(self, champion: Champion, columns: Sequence[str]) -> list[str]:
        """Return those of ``columns`` that it was run on and not evolved against."""
        others = [column for column in columns if column not in champion.against]
        return [column for column in others if not self.matrix.cell(champion.name, column).failed]


def judges_of(champion: Champion, matrix: TransferMatrix) -> tuple[str, ...]:
    """Return the models of families that a controller was not evolved in, on which it was run."""
    families = {matrix.families.get(column, column) for column in champion.against}
    others = [column for column in matrix.models if matrix.families[column] not in families]
    return tuple(column for column in others if not matrix.cell(champion.name, column).failed)


def standings(matrix: TransferMatrix, at_rest: str | None = None) -> Mapping[str, ControllerScores]:
    """Return how the controllers of ``matrix`` stand, by name.

    ``at_rest`` names the controller that does nothing, from whose fitness shares are measured; None to measure from 0.
    """
    figures = Figures(matrix, at_rest)
    found = {}
    for champion in matrix.champions:
        name, (worst, worst_on) = champion.name, figures.worst(champion)
        found[name] = ControllerScores(
            claimed=_estimate(figures.claimed.get(name)),
            achieved=_estimate(figures.elsewhere.get(name)),
            gap=_estimate(figures.gap.get(name)),
            kept=_estimate(figures.kept.get(name)),
            worst=_estimate(worst),
            worst_on=worst_on,
            regret=_estimate(figures.regret(champion), least=0.0),
        )
    return found


def _estimate(figure: PairedEstimate | None, *, least: float = -np.inf) -> Estimate | None:
    """Return value, standard error and interval of a figure that cannot be below ``least``."""
    if figure is None:
        return None
    low, high = figure.interval()
    return Estimate(
        max(least, figure.value), figure.standard_error, float(np.maximum(least, low)), float(np.maximum(least, high))
    )
