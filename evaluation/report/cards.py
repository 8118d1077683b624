"""Cards: what is said of one model or controller, with a verdict to see at a glance and a trial to watch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from evaluation.exploitability import ModelExploitability
from evaluation.exploitability.card import card
from evaluation.report.headlines import Tone
from evaluation.report.replay import trial_name
from evaluation.transfer import TransferMatrix

LEAD = 1.0
"""Seconds that are shown before what is to be watched."""


@dataclass(frozen=True)
class Card:
    """What is said of one thing: the first sentence as its head, the others below.

    ``watch`` is the row of the replay to look at, from ``time`` (s) on; empty for none.
    """

    title: str
    tone: Tone
    verdict: str
    sentences: Sequence[str]
    watch: str = ""
    time: float = 0.0


@dataclass(frozen=True)
class Cards:
    """Cards beside each other."""

    title: str
    cards: tuple[Card, ...]


def exploitability_cards(models: Sequence[ModelExploitability], matrix: TransferMatrix) -> Cards:
    """Return a card for each model, with its controller to watch where a trial was kept."""
    return Cards("How each model is exploited", tuple(_card(model, matrix) for model in models))


def worst_trials(models: Sequence[ModelExploitability], matrix: TransferMatrix) -> dict[str, int]:
    """Return which trial of each model's first controller helps the task most against what others believe."""
    found = {}
    for model in models:
        worst = model.optimism
        told = worst is not None and worst.is_sure and worst.value > 0.0
        if told and model.controllers and worst is not None:
            controller = model.controllers[0]
            if worst.trial < _kept(matrix, controller, model.model):
                found[controller] = worst.trial
    return found


def _card(model: ModelExploitability, matrix: TransferMatrix) -> Card:
    first, *more = card(model)
    said = first.removeprefix(f"{model.model}: ")
    tone: Tone = "open" if model.exploited is None else "bad" if model.exploited else "good"
    watched = [name for name in model.controllers if _kept(matrix, name, model.model)]
    if not watched:
        return Card(model.model, tone, said[0].upper() + said[1:], more)
    worst = worst_trials([model], matrix).get(watched[0])
    time = 0.0 if worst is None or model.optimism is None else max(0.0, model.optimism.time - LEAD)
    return Card(model.model, tone, said[0].upper() + said[1:], more, trial_name(watched[0], worst or 0), time)


def _kept(matrix: TransferMatrix, controller: str, model: str) -> int:
    """Return how many trials of a controller on a model were kept."""
    cell = matrix.cells.get((controller, model))
    return 0 if cell is None else len(cell.traces)
