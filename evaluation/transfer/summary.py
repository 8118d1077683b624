"""What the transfer matrix says about each controller: claimed, achieved, and the gaps between."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from evaluation.transfer.claims import Estimate, fitness_on, is_exploited
from evaluation.transfer.matrix import TransferMatrix
from evaluation.transfer.ranks import rank_correlation
from evaluation.transfer.standing import Standing, judges_of, standings
from sysid_evo.arrays import Array
from sysid_evo.evolution import Champion

AT_REST = "constant"
"""The registered controller that does nothing, if it was not evolved."""


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
    standing: Standing = field(default_factory=Standing)

    @property
    def elsewhere(self) -> Estimate | None:
        """Fitness on the robot, or on the other models where it was not run on a robot."""
        return self.others if self.achieved is None else self.achieved

    @property
    def shown(self) -> Mapping[str, Estimate]:
        """What there is of claimed, others, other_families and achieved, with the intervals of its `Standing`."""
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


@dataclass(frozen=True)
class TransferSummary:
    """All controllers, the one to pick without the robot, and what would have predicted success.

    ``pick`` is None until one is chosen, by its forecast: see `evaluation.forecast.chosen_by`. Controllers evolved on
    the robot itself, and people, are left out of the correlations: what the first claim is what they achieve, and
    people claim nothing.
    """

    controllers: tuple[ControllerSummary, ...]
    pick: str | None
    best_on: Mapping[str, str | None]
    correlations: tuple[RankCorrelation, ...]

    def controller(self, name: str) -> ControllerSummary:
        return next(controller for controller in self.controllers if controller.name == name)


def summarise(matrix: TransferMatrix, *, seed: int = 0) -> TransferSummary:
    """Condense the matrix, nothing picked yet; ``seed`` is that of the bootstrap over trials."""
    controllers = tuple(_controller(champion, matrix, seed) for champion in matrix.champions)
    at_rest = [
        champion.name for champion in matrix.champions if champion.controller.name == AT_REST and not champion.against
    ]
    floor = next((c.achieved.value for c in controllers if c.name in at_rest and c.achieved is not None), None)
    standing = standings(matrix, next(iter(at_rest), None))
    controllers = tuple(replace(one, floor=floor, standing=standing[one.name]) for one in controllers)
    elsewhere = [c for c in controllers if c.against and not c.on_robot]
    correlations = tuple(
        _correlation(figure, [getattr(c, name) for c in elsewhere], [c.achieved for c in elsewhere])
        for figure, name in (("claimed", "claimed"), ("median on other families", "other_families"))
    )
    return TransferSummary(
        controllers=controllers,
        pick=None,
        best_on={column: matrix.best(column) for column in matrix.columns},
        correlations=correlations if matrix.robot is not None else (),
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


def _correlation(
    figure: str, values: Sequence[Estimate | None], achieved: Sequence[Estimate | None]
) -> RankCorrelation:
    pairs = [(a.value, b.value) for a, b in zip(values, achieved, strict=True) if a is not None and b is not None]
    return RankCorrelation(figure, rank_correlation(pairs), len(pairs))
