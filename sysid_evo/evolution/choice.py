"""Choosing a controller without the robot: by what it does in models beside those that it was evolved in."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.engine import Runner
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.champion import Champion, Finalist
from sysid_evo.evolution.controllers import observed_late, selection_seeds
from sysid_evo.evolution.ensemble import EnsembleObjective
from sysid_evo.registry import make_controller, make_task

Judgement: TypeAlias = Callable[[Champion, tuple[str, ...], Array], Array]
"""What a champion's finalists are worth, (P,), by their fitness (M, P) on the models of these labels."""


def median(_champion: Champion, _models: tuple[str, ...], by_model: Array) -> Array:
    """Return the median over the models, (P,)."""
    found: Array = np.median(by_model, axis=0)
    return found


def choose(
    contenders: Sequence[tuple[Champion, Mapping[str, Runner]]],
    *,
    seed: int,
    trials: int = 100,
    judgement: Judgement = median,
) -> Champion:
    """Return the champion of the finalist that is worth most on the models beside its champion.

    Each is run there in ``trials`` fresh trials. By the median those must be of *other* families than it was evolved
    in: what a controller claims in its own model says next to nothing about what it achieves elsewhere, while this
    ranks as the robot does. A champion without such models keeps its fittest finalist; where there are
    models for some and for others not, only those with models are compared. The champion returned holds
    the finalists of all, with what they are worth. Raises `InvalidArgument` without a contender.
    """
    if not contenders:
        raise InvalidArgument("choose: expected at least one champion, got none")
    judged = [judge(champion, judges, seed=seed, trials=trials, judgement=judgement) for champion, judges in contenders]
    ranked = [(finalist, champion) for champion in judged for finalist in champion.finalists]
    known = [pair for pair in ranked if pair[0].elsewhere is not None]
    best, own = max(known or ranked, key=lambda pair: worth(pair[0]))  # of equals the first
    return replace(own, parameters=best.parameters, finalists=tuple(finalist for finalist, _ in ranked))


def judge(
    champion: Champion,
    judges: Mapping[str, Runner],
    *,
    seed: int,
    trials: int = 100,
    judgement: Judgement = median,
) -> Champion:
    """Return ``champion`` with what each finalist is worth to the ``judges``; as it is where there are none."""
    if not judges or not champion.finalists:
        return champion
    assert champion.system is not None
    task = make_task(champion.task).bind(champion.system)
    controller = make_controller(champion.controller).bind_to(task)
    late = tuple(observed_late(label, runner, champion.estimator_delay) for label, runner in judges.items())
    everyone = np.stack([finalist.parameters for finalist in champion.finalists])
    by_model = (
        EnsembleObjective(late, controller, task, seed).on_trials(everyone, selection_seeds(seed, trials)).by_model
    )
    assert by_model is not None
    worths = judgement(champion, tuple(judges), by_model)
    finalists = tuple(
        replace(one, elsewhere=float(value)) for one, value in zip(champion.finalists, worths, strict=True)
    )
    return replace(champion, finalists=finalists, judges=tuple(judges))


def worth(finalist: Finalist) -> float:
    """Return by what finalists are ranked: what the judges made of it, or what it claims where nobody judged."""
    return finalist.fitness if finalist.elsewhere is None else finalist.elsewhere
