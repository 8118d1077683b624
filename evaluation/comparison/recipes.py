"""Recipes: which cells a controller comes about by."""

from __future__ import annotations

from dataclasses import replace

from evaluation.comparison.champion_cells import ChampionCell, ChooseCell, EvolveCell, PolishCell, ensemble_name
from evaluation.comparison.columns import Column
from evaluation.comparison.experiment import Experiment
from sysid_evo.evolution import ControllerEvolution
from sysid_evo.registry import Spec

ALONE = "min"
"""The rule under which a controller of one model is evolved, and found again, where the rules come to the same."""
MEAN_OF_ONE = ("min", "mean", "median")
"""Rules that give, where there is one model, the mean over its trials."""
POLISHED = 2
"""Finalists that the recommended recipe polishes."""


def evolution_on(experiment: Experiment, members: tuple[Column, ...]) -> ControllerEvolution:
    """Return how controllers are evolved on ``members``; robots among them meet no noise but what is asked for.

    Where all rules for several models come to the same on one, it is evolved by the same one under all of them.
    """
    evolution = experiment.evolution
    if len(members) == 1 and Spec.parse(evolution.aggregate).name in MEAN_OF_ONE:
        evolution = replace(evolution, aggregate=ALONE)
    if experiment.noise is None and any(member.robot is not None for member in members):
        return replace(evolution, noise="")
    return evolution


def controller_cell(
    experiment: Experiment,
    members: tuple[Column, ...],
    *,
    judges: tuple[Column, ...],
    label: str | None = None,
    sift: bool = False,
    further: tuple[EvolveCell, ...] = (),
) -> ChampionCell:
    """Return the cell of one controller against all of ``members``, by the recipe of ``experiment``.

    By the recommended one each member is searched alone, the best are chosen by their median on those of
    ``judges`` that are models of other families and predict well, and polished on all members at once; with
    ``sift`` on those that predict well. Such a controller is called ``label``, by default after its members. The
    finalists of ``further`` evolutions, in several models at once, can be chosen, too.
    """
    evolution = evolution_on(experiment, members)
    if experiment.budget.recipe == "plain":
        return EvolveCell(members, evolution, experiment.seed)
    models = tuple(column for column in judges if column.robot is None)
    singles = tuple(EvolveCell((one,), evolution_on(experiment, (one,)), experiment.seed) for one in members)
    if len(members) == 1:
        return chosen_cell(experiment, singles, models)
    chosen = ChooseCell((*singles, *further), models, experiment.selection_trials, experiment.seed)
    name = label or ensemble_name(tuple(member.label for member in members), experiment.aggregate)
    return PolishCell(chosen, members, evolution, experiment.budget.polish, POLISHED, experiment.seed, name, sift)


def chosen_cell(experiment: Experiment, contenders: tuple[EvolveCell, ...], judges: tuple[Column, ...]) -> ChampionCell:
    """Return the choice among the finalists of ``contenders``, where there are models of other families for it.

    What was evolved on a robot itself is chosen by that robot.
    """
    members = [member for cell in contenders for member in cell.members]
    own = {member.registered for member in members}
    known = all(member.model is None for member in members) or all(judge.registered in own for judge in judges)
    if len(contenders) == 1 and known:
        return contenders[0]
    return ChooseCell(contenders, judges, experiment.selection_trials, experiment.seed)
