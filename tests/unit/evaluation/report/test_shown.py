"""What a report, a study and all else look like where a user of Python looks at them."""

from dataclasses import fields

import pytest

from evaluation import Study, compare, run_study
from evaluation.experiment import Experiment, Settings
from evaluation.report.report import PrintedReport
from sysid_evo import make_model
from sysid_evo.errors import InvalidArgument

pytestmark = pytest.mark.usefixtures("blank_figures")

MOST = 5_000
"""Characters of what a cell of a notebook shows."""


def test_all_that_a_notebook_shows_is_small(car_data, report):
    shown = {
        "Dataset": car_data,
        "Trajectory": car_data.episodes[0],
        "Linear()": make_model("linear").fit(car_data),
        "Known cars": PrintedReport(**{one.name: getattr(report, one.name) for one in fields(report)}),
        "Champion": report.matrix.champions[0],
        "Prediction": report.prediction,
        "TransferMatrix": report.matrix,
        "Study": Study.of({"experiment": {"models": ["linear"]}, "grid": {"seed": "0..1"}}),
    }
    for title, thing in shown.items():
        assert len(repr(thing)) < 500
        assert len(thing._repr_html_()) < MOST
        assert title in thing._repr_html_()


def test_progress_counts_the_cells_of_a_comparison(car_data, tmp_path):
    told = []
    compare(car_data, models=["linear"], stop_after="fit", out=tmp_path, progress=lambda *now: told.append(now))
    done, cells, _ = told[-1]
    assert done == cells > 1
    assert "fit linear" in {title for *_, title in told}


def test_progress_counts_the_cells_of_a_study(tmp_path):
    told = []
    settings = {"models": ["linear"], "stop_after": "fit", "minutes": 0.2}
    study = {"experiment": settings, "grid": {"seed": [0]}}
    found = run_study(study, out=tmp_path, progress=lambda *now: told.append(now))
    assert told[-1][0] == told[-1][1]
    assert len(repr(found)) < 500


def test_a_setting_that_is_misspelt_is_refused_with_the_right_one():
    with pytest.raises(
        InvalidArgument, match=r"generatons is no setting of an experiment\. Did you mean 'generations'\?"
    ):
        compare(generatons=3)


def test_type_checkers_know_every_setting_of_an_experiment():
    """But for the data, which are an argument of their own, and what the program writes itself."""
    written = {"data", "data_digest", "tried_models", "step_seconds"}
    assert {*Settings.__annotations__, *written} == set(Experiment.model_fields)
