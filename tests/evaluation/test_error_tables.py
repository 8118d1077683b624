"""Tables of where errors are: each says what is so, in words, and fits the screen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from evaluation.prediction import PERSISTENCE, Prediction, PredictionProtocol, assess_prediction
from evaluation.report.render.terminal import to_rich
from evaluation.report.sections.error_analysis import episode_error_sheet, fit_sheet, region_sheet, residual_sheet
from evaluation.report.sections.prediction import difference_sheet
from tests.evaluation.test_where_errors_are import LosesGrip, noisy
from tests.fixtures.known_models import Known, fitted, recording
from tests.fixtures.reports import prediction, printed


@pytest.fixture(scope="module")
def assessed() -> Prediction:
    models = {"known": fitted(Known()), "grip": fitted(LosesGrip())}
    return assess_prediction(models, recording(), noisy(2, 4), protocol=PredictionProtocol(resamples=200))


def test_each_model_stands_beside_the_best_with_the_words_where_there_is_no_difference() -> None:
    found = difference_sheet(prediction({PERSISTENCE: 0.9, "linear": 0.3, "level": 0.302, "sindy": 0.5}, spread=0.01))
    assert found is not None
    rows = {row[0]: row[1] for row in found.rows}
    assert [row[0] for row in found.rows] == ["linear", "level", "sindy", PERSISTENCE]
    assert rows["linear"] == "best"
    assert rows["level"].startswith("+0.002\n-0.0")
    assert rows["level"].endswith("no significant\ndifference")
    assert rows["sindy"].startswith("+0.200\n+0.1")
    assert "significant" not in rows["sindy"]
    assert difference_sheet(prediction({"linear": 0.3})) is None


def test_the_table_of_residuals_tells_white_from_coloured_and_names_a_control(assessed: Prediction) -> None:
    white = assessed.model("grip")
    assert white.residuals is not None
    p = white.residuals.white_p.copy()
    p[:] = [0.5, 0.001, np.nan]
    cross_p = np.ones_like(white.residuals.cross_p)
    cross_p[1, 0] = 0.001
    cross, band = np.zeros_like(white.residuals.cross), np.ones_like(white.residuals.cross_band)
    cross[8, 1, 0] = 0.25
    known = replace(white.residuals, white_p=p, cross=cross, cross_band=band, cross_p=cross_p)
    sheet = residual_sheet(replace(assessed, models=(replace(white, residuals=known),)))
    assert sheet is not None
    (row,) = sheet.rows
    assert row[1] == "white\nsteer, 0.15 s: +0.25"
    assert row[2].startswith("not white\n")
    assert row[3] == "–"


def test_the_table_of_regions_names_the_worst_or_none(assessed: Prediction) -> None:
    sheet = region_sheet(assessed)
    assert sheet is not None
    rows = {row[0]: row[1:] for row in sheet.rows}
    assert rows["known"][0] == "nowhere clearly"
    assert rows["grip"][0].startswith("forward_speed above ")
    assert float(rows["grip"][1].split("\n")[0]) > 1.2
    assert rows["grip"][2] == "20 %"
    assert "N after 5 steps (0.25 s)" in sheet.note


def test_episodes_and_fits_have_a_row_each(assessed: Prediction) -> None:
    sheet, fits = episode_error_sheet(assessed), fit_sheet(assessed)
    assert sheet is not None
    assert fits is not None
    assert [row[0] for row in sheet.rows] == [f"episode-{i}" for i in range(4)]
    assert sheet.columns == ("episode", *assessed.names)
    known = next(row for row in fits.rows if row[0] == "known")
    mean = np.mean([episode.fit[0] for episode in assessed.model("known").episodes])
    assert known[1].startswith(f"{mean:.1f}\n")


def test_free_runs_that_reach_their_clip_are_counted_and_timed(assessed: Prediction) -> None:
    known = assessed.model("known")
    assert known.divergence is not None
    hit = replace(known, divergence=replace(known.divergence, free_run_times=(None, 2.0, 4.0, None)))
    fits = fit_sheet(replace(assessed, models=(hit, *(one for one in assessed.models if one is not known))))
    assert fits is not None
    assert [row[0] for row in fits.rows if row[0].startswith("known")] == ["known\nclip 2 of 4, 3.0 s"]


def test_every_table_is_80_columns_wide_at_most(assessed: Prediction) -> None:
    sheets = (difference_sheet, residual_sheet, region_sheet, episode_error_sheet, fit_sheet)
    for made in (sheet(assessed) for sheet in sheets):
        assert made is not None
        lines = printed(to_rich(made))
        assert max(map(len, lines)) <= 80
        assert made.title in lines
