"""Prediction error: against theory first, then against published figures for the same recording."""

from __future__ import annotations

from evaluation.prediction import PERSISTENCE, assess_prediction
from sysid_evo.data import Dataset


def test_persistence_on_the_slippery_log_scores_what_the_protocol_gives(slippery: tuple[Dataset, Dataset]) -> None:
    prediction = assess_prediction({}, *slippery)
    row = prediction.model(PERSISTENCE)
    assert [round(score.n, 3) for score in row.at] == [0.197, 1.127, 1.339, 1.447]
    print(row.at[0].interval, row.free_run.n, row.free_run.interval, row.at[3])
