"""What a controller claims, achieves, has at worst and costs, each with an interval over seeds and trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from evaluation.transfer.claims import Estimate
from evaluation.transfer.matrix import TransferMatrix
from evaluation.transfer.nested import Nested, Rule, regrets
from sysid_evo.evolution import Champion
from sysid_evo.registry import make_aggregate


@dataclass(frozen=True)
class Standing:
    """What a controller, or those of several evolution ``seeds``, do in the matrix; None where nothing is known.

    ``claimed`` is the fitness on the models it was evolved against, made one as in its evolution; ``achieved`` that on
    the robot, without one the mean over the other models, and ``gap`` the first less the second. ``kept`` is the share
    of the claim that is achieved, both measured from controls at rest where those were run. ``worst`` is the fitness
    on ``worst_on``, the system where it is lowest, of all that it was not evolved against. ``regret`` is what the best
    other controller achieves more, at least 0; without a robot the most that this is on one of the other models,
    where only controllers that were not evolved there count. What was evolved on the robot itself has no regret and
    is regretted by none.
    """

    seeds: int
    claimed: Estimate | None = None
    achieved: Estimate | None = None
    gap: Estimate | None = None
    kept: Estimate | None = None
    worst: Estimate | None = None
    worst_on: str = ""
    regret: Estimate | None = None


@dataclass(frozen=True)
class Figures:
    """Figures of the controllers of a matrix: of each one alone, or of the controllers of all its evolution seeds."""

    matrix: TransferMatrix
    all_seeds: bool = False

    @cached_property
    def singles(self) -> Mapping[tuple[str, str], Nested]:
        """The mean fitness of every controller on every column that it was run on."""
        pairs = [(champion, column) for champion in self.matrix.champions for column in self.matrix.columns]
        found = {(one.name, column): self.on(one, [column], make_aggregate("mean")) for one, column in pairs}
        return {pair: figure for pair, figure in found.items() if figure is not None}

    @cached_property
    def known(self) -> Mapping[tuple[str, str], Nested]:
        """The same, and that of the controller alone where other seeds were not run."""
        return {**Figures(self.matrix).singles, **self.singles} if self.all_seeds else self.singles

    def on(self, champion: Champion, columns: Sequence[str], rule: Rule) -> Nested | None:
        """Return the figure on ``columns``, over the trials that were run on all; None if one was not run."""
        cells = [self.matrix.cell(champion.name, column) for column in columns if column in self.matrix.columns]
        if not cells or len(cells) < len(columns) or any(cell.failed for cell in cells):
            return None
        trials = min(cell.trials for cell in cells)
        found = [cell.by_seed if self.all_seeds else cell.fitness[None] for cell in cells]
        if len({len(one) for one in found}) > 1 or not len(found[0]):
            return None
        return Nested.of(champion.name, np.stack([one[:, :trials] for one in found]), rule)

    def claimed(self, champion: Champion) -> Nested | None:
        """Return the fitness on what it was evolved against, by the rule of its evolution."""
        return self.on(champion, champion.against, make_aggregate(champion.aggregate))

    def elsewhere(self, champion: Champion) -> Nested | None:
        """Return the fitness on the robot, without one the mean over the models that it was not evolved against."""
        if self.matrix.robot is not None:
            return self.singles.get((champion.name, self.matrix.robot))
        return self.on(champion, self._run(champion, self.matrix.models), make_aggregate("mean"))

    def consensus(self, champion: Champion) -> Nested | None:
        """Return the median over the models of families that it was not evolved in."""
        return self.on(champion, judges_of(champion, self.matrix), make_aggregate("median"))

    def worst(self, champion: Champion) -> tuple[Nested | None, str]:
        """Return the fitness on the system where it is lowest, and which one that is."""
        columns = self._run(champion, self.matrix.columns)
        found = {column: self.singles[key] for column in columns if (key := (champion.name, column)) in self.singles}
        lowest = min(found, key=lambda column: found[column].value, default="")
        return found.get(lowest), lowest

    def regret(self, champion: Champion) -> Nested | None:
        """Return what the best other controller has more: on the robot, else where it is most."""
        robot = self.matrix.robot
        if robot is not None and robot in champion.against:
            return None
        columns = [robot] if robot is not None else self._run(champion, self.matrix.models)
        found = []
        for column in columns:
            rivals = [one for one in self.matrix.champions if column not in one.against]
            there = {one.name: self.known[key] for one in rivals if (key := (one.name, column)) in self.known}
            if (champion.name, column) in self.singles and len(there) > 1:
                found.append(regrets(there)[champion.name])
        return max(found, key=lambda figure: figure.value, default=None)

    def _run(self, champion: Champion, columns: Sequence[str]) -> list[str]:
        """Return those of ``columns`` that it was run on and not evolved against."""
        others = [column for column in columns if column not in champion.against]
        return [column for column in others if not self.matrix.cell(champion.name, column).failed]


def judges_of(champion: Champion, matrix: TransferMatrix) -> tuple[str, ...]:
    """Return the models of families that a controller was not evolved in, on which it was run."""
    families = {matrix.families.get(column, column) for column in champion.against}
    others = [column for column in matrix.models if matrix.families[column] not in families]
    return tuple(column for column in others if not matrix.cell(champion.name, column).failed)


def standings(matrix: TransferMatrix, at_rest: str | None = None, *, all_seeds: bool = False) -> Mapping[str, Standing]:
    """Return how the controllers of ``matrix`` stand, by name; with ``all_seeds`` those with several evolution seeds.

    ``at_rest`` names the controller that does nothing, from whose fitness shares are measured; None to measure from 0.
    """
    alone, several = Figures(matrix), Figures(matrix, all_seeds=True)
    resting = next((one for one in matrix.champions if one.name == at_rest), None)
    floor = None if resting is None else alone.elsewhere(resting)
    found = {}
    for champion in matrix.champions:
        seeds = max((len(matrix.cell(champion.name, column).by_seed) for column in matrix.columns), default=0)
        if not all_seeds:
            found[champion.name] = _standing(champion, alone, floor)
        elif seeds > 1:
            found[champion.name] = _standing(champion, several, floor, seeds)
    return found


def _standing(champion: Champion, figures: Figures, floor: Nested | None, seeds: int = 1) -> Standing:
    claimed, achieved = figures.claimed(champion), figures.elsewhere(champion)
    worst, worst_on = figures.worst(champion)
    both = claimed is not None and achieved is not None
    return Standing(
        seeds=seeds,
        claimed=_estimate(claimed),
        achieved=_estimate(achieved),
        gap=_estimate(claimed - achieved) if claimed is not None and achieved is not None else None,
        kept=_estimate(_share(achieved, claimed, floor)) if both else None,
        worst=_estimate(worst),
        worst_on=worst_on,
        regret=_estimate(figures.regret(champion), least=0.0),
    )


def _share(achieved: Nested | None, claimed: Nested | None, floor: Nested | None) -> Nested | None:
    if achieved is None or claimed is None:
        return None
    if floor is not None:
        achieved, claimed = achieved - floor, claimed - floor
    return achieved.over(claimed) if claimed.value > 0.0 else None


def _estimate(figure: Nested | None, *, least: float = -np.inf) -> Estimate | None:
    """Return value, standard error and interval of a figure that cannot be below ``least``."""
    if figure is None:
        return None
    low, high = figure.interval()
    return Estimate(
        max(least, figure.value), figure.standard_error, float(np.maximum(least, low)), float(np.maximum(least, high))
    )
