"""Cards of models: the verdict first, then how and what to do, and the trial to watch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from evaluation.exploitability.optimism import Optimism
from evaluation.report.sections.exploitability import exploitability_cards, worst_trials
from evaluation.transfer import Estimate, TransferMatrix
from tests.evaluation.test_replay import on_a_plane
from tests.fixtures.reports import exploited, matrix


@pytest.fixture(scope="module")
def kept() -> TransferMatrix:
    """A matrix whose own cell kept three trials."""
    made = matrix({"linear": {"linear": 10.0, "car": 4.0}}, robot="car")
    trace = on_a_plane(np.linspace(0.0, 1.0, 5))
    cell = replace(made.cell("linear", "linear"), traces=(trace, trace, trace))
    return replace(made, cells={**made.cells, ("linear", "linear"): cell})


def helped(trial: int, value: float = 2.0) -> Optimism:
    return Optimism(value, value - 1.0, value + 1.0, 0.8, trial, 6.0)


def test_a_card_begins_with_its_verdict_and_keeps_the_other_sentences(kept: TransferMatrix) -> None:
    (card,) = exploitability_cards([exploited()], kept).cards
    assert (card.title, card.tone) == ("linear", "bad")
    assert card.verdict.startswith("Exploited: its controllers claim 10.00 waypoints")
    assert any("turn on the spot" in sentence for sentence in card.sentences)
    tones = [exploited(gap=Estimate(0.1, 0.1)), exploited(gap=None)]
    assert [card.tone for card in exploitability_cards(tones, kept).cards] == ["good", "open"]


def test_a_card_shows_the_trial_that_helps_the_task_most_a_second_before(kept: TransferMatrix) -> None:
    model = exploited(optimism=helped(2))
    (card,) = exploitability_cards([model], kept).cards
    assert (card.watch, card.time) == ("linear, trial 3", 5.0)
    assert worst_trials([model], kept) == {"linear": 2}


@pytest.mark.parametrize("optimism", [None, helped(5), helped(1, -2.0)])
def test_without_such_a_trial_it_shows_the_first_one(kept: TransferMatrix, optimism: Optimism | None) -> None:
    (card,) = exploitability_cards([exploited(optimism=optimism)], kept).cards
    assert card.watch == "linear"
    assert worst_trials([exploited(optimism=optimism)], kept) == {}


def test_a_model_without_a_kept_trial_has_nothing_to_watch() -> None:
    made = matrix({"linear": {"linear": 10.0, "car": 4.0}}, robot="car")
    assert exploitability_cards([exploited(optimism=helped(2))], made).cards[0].watch == ""
