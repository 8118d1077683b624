"""What a controller claims, achieves, has at worst and costs, each with an interval over trials."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from evaluation.transfer.claims import Estimate
from evaluation.transfer.matrix import TransferMatrix
from evaluation.transfer.uncertainty import PairedEstimate
from sysid_evo.evolution import Champion
from sysid_evo.evolution.aggregates import Aggregate, mean, median
from sysid_evo.registry import make_aggregate


@dataclass(frozen=True)
class Standing:
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


def standings(matrix: TransferMatrix, at_rest: str | None = None) -> Mapping[str, Standing]:
    """Return how the controllers of ``matrix`` stand, by name.

    ``at_rest`` names the controller that does nothing, from whose fitness shares are measured; None to measure from 0.
    """
    figures = Figures(matrix, at_rest)
    return {champion.name: _standing(champion, figures) for champion in matrix.champions}


def _standing(champion: Champion, figures: Figures) -> Standing:
    worst, worst_on = figures.worst(champion)
    name = champion.name
    return Standing(
        claimed=_estimate(figures.claimed.get(name)),
        achieved=_estimate(figures.elsewhere.get(name)),
        gap=_estimate(figures.gap.get(name)),
        kept=_estimate(figures.kept.get(name)),
        worst=_estimate(worst),
        worst_on=worst_on,
        regret=_estimate(figures.regret(champion), least=0.0),
    )


def _estimate(figure: PairedEstimate | None, *, least: float = -np.inf) -> Estimate | None:
    """Return value, standard error and interval of a figure that cannot be below ``least``."""
    if figure is None:
        return None
    low, high = figure.interval()
    return Estimate(
        max(least, figure.value), figure.standard_error, float(np.maximum(least, low)), float(np.maximum(least, high))
    )
