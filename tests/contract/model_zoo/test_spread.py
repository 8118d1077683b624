"""How often intervals hold the truth stands in the report, in numbers and in words."""

from dataclasses import replace

import numpy as np
import pytest

from evaluation.prediction.cases import PredictionProtocol, measured_cases
from evaluation.prediction.scores import ConditionError, Coverage, ModelPrediction
from evaluation.prediction.scoring import condition_errors, score_model
from evaluation.report.sections.prediction import condition_table, coverage_table
from evaluation.storage import load_result, save_result
from sysid_evo.data import Dataset
from sysid_evo.models import DynamicsModel
from sysid_evo.system import Channel, System
from tests.fixtures.reports import prediction

SYSTEM = System((Channel("x"), Channel("y")), (Channel("u", low=-1.0, high=1.0),), dt=0.05)


class Walk(DynamicsModel):
    """A random walk with steps of ``size``."""

    state_bounds = None

    def __init__(self, *, size=1.0, stochastic=True):
        self.size = size
        self.stochastic = stochastic

    @property
    def n_noise(self):
        return 2 if self.stochastic else 0

    def fit(self, dataset, *, rng, progress=None):
        return self

    def step(self, carry, control, noise=None):
        return carry if noise is None else carry + self.size * noise


def walked(seed):
    steps = np.random.default_rng(seed).standard_normal((20, 300, 2))
    states = np.concatenate([np.zeros((20, 1, 2)), np.cumsum(steps, axis=1)], axis=1)
    return Dataset.from_arrays(SYSTEM, list(states), [np.zeros((300, 1))] * 20)


def test_coverage_is_that_of_the_noise_and_errors_are_those_without(tmp_path):
    data = walked(0)
    cases = measured_cases(data, walked(1), PredictionProtocol(stride=20))
    fitted = {size: Walk(size=size).fit(data, rng=np.random.default_rng(0)) for size in (1.0, 0.4)}
    scores = {size: score_model("walk", model, cases, family="walk") for size, model in fitted.items()}
    assert [held.horizon for held in scores[1.0].coverage] == [1, 10, 20, 60]
    for held in scores[1.0].coverage:
        assert held.calibrated
        np.testing.assert_allclose(held.inside, 0.9, atol=0.07)
    assert all(held.mean < 0.6 for held in scores[0.4].coverage)
    wide, narrow = (np.array([held.width for held in scores[size].coverage]) * cases.std for size in (1.0, 0.4))
    np.testing.assert_allclose(wide, 2 * 1.645 * np.sqrt([[1.0], [10.0], [20.0], [60.0]]) * np.ones(2), rtol=0.06)
    np.testing.assert_allclose(narrow, 0.4 * wide, rtol=0.01)
    quiet = score_model("walk", fitted[1.0].variant(stochastic=False), cases, family="walk")
    assert quiet.coverage == ()
    assert [score.n for score in quiet.scores] == [score.n for score in scores[1.0].scores]
    save_result(scores[1.0], tmp_path / "walk")
    loaded = load_result(ModelPrediction, tmp_path / "walk")
    assert [held.mean for held in loaded.coverage] == [held.mean for held in scores[1.0].coverage]


@pytest.mark.parametrize("shares", [(0.9, 0.87), (0.9, 0.6), (0.99, 0.6), ()])
def test_intervals_with_wrong_coverage_are_marked_in_the_table(shares):
    made_up = prediction({"persistence": 0.9, "linear": 0.3})
    held = tuple(
        Coverage(h, 100, 0.9, np.full(3, share), np.ones(3)) for h, share in zip((1, 20), shares, strict=False)
    )
    model = replace(made_up.model("linear"), coverage=held)
    sheet = coverage_table(replace(made_up, models=(made_up.models[0], model)))
    assert (sheet is None) is (not shares)
    if sheet is not None:
        marked = [cell.startswith("! ") for cell in sheet.rows[0][1:]]
        assert marked == [not one.calibrated for one in held if one.horizon in made_up.cases.horizons]


def test_the_coverage_in_a_condition_is_that_of_the_model_fitted_to_the_others():
    def labelled(seed):
        data = walked(seed)
        names = ["dry", "wet"] * (len(data.episodes) // 2)
        return data.with_episodes([replace(e, condition=name) for e, name in zip(data, names, strict=True)])

    training, test = labelled(0), labelled(1)

    def errors(stochastic):
        def learned(data, size=0.4):
            return Walk(size=size, stochastic=stochastic).fit(data, rng=np.random.default_rng(0))

        return condition_errors(learned(training, 1.0), learned, training, test, PredictionProtocol(stride=20))

    found = {stochastic: errors(stochastic) for stochastic in (True, False)}
    assert [one.condition for one in found[True]] == ["dry", "wet"]
    assert all(one.covered == pytest.approx(0.5, abs=0.08) for one in found[True])
    assert [one.covered for one in found[False]] == [None, None]
    assert [(one.within, one.across) for one in found[True]] == [(one.within, one.across) for one in found[False]]


def test_the_table_of_conditions_reports_the_share_inside_if_there_are_intervals():
    errors = ConditionError("wet", 20, 0.3, 0.4, 0.64), ConditionError("dry", 20, 0.3, None, None)
    sheet = condition_table({"linear": errors})
    assert sheet.columns == ("model", "wet", "dry")
    assert sheet.rows[0][1:] == ("0.300 → 0.400\n64 % inside", "0.300 → –")
