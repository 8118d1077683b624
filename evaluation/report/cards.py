"""Cards: what is said of one model or controller, with a verdict to see at a glance and a trial to watch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from evaluation.exploitability import ModelExploitability
from evaluation.exploitability.card import card
from evaluation.report.headlines import Tone


@dataclass(frozen=True)
class Card:
    """What is said of one thing: the first sentence as its head, the others below.

    ``watch`` names a controller that the replay can show, empty for none.
    """

    title: str
    tone: Tone
    verdict: str
    sentences: Sequence[str]
    watch: str = ""


@dataclass(frozen=True)
class Cards:
    """Cards beside each other."""

    title: str
    cards: tuple[Card, ...]


def exploitability_cards(models: Sequence[ModelExploitability], replayed: Sequence[str]) -> Cards:
    """Return a card for each model; ``replayed`` are the controllers that can be watched."""
    return Cards("How each model is exploited", tuple(_card(model, replayed) for model in models))


def _card(model: ModelExploitability, replayed: Sequence[str]) -> Card:
    first, *more = card(model)
    said = first.removeprefix(f"{model.model}: ")
    tone: Tone = "open" if model.exploited is None else "bad" if model.exploited else "good"
    watch = next((name for name in model.controllers if name in replayed), "")
    return Card(model.model, tone, said[0].upper() + said[1:], more, watch)
