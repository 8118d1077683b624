"""A model without a compiled form is timed by the plan, and searches in it have fewer generations."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

from evaluation.cells import slow_models
from evaluation.experiment import Experiment
from evaluation.planning import plan_comparison
from evaluation.report.sections.evolution import fewer_generations
from model_zoo.linear import Linear
from sysid_evo.models import DynamicsModel
from sysid_evo.registry import models
from sysid_evo.testing import example_dataset

EACH = 2e-5 - slow_models.IN_NUMPY  # s that a step of one rollout takes, without the time of the engine
GENERATION = 5 * 100 * 500 * 2e-5  # s, in the preset quick


class Clock:
    """The time passes when a slow model steps."""

    now, fits = 0.0, 0

    @classmethod
    def look(cls):
        return cls.now


class Slow(DynamicsModel):
    """A model of NumPy only; each step takes the same time, or one that grows with the training data."""

    grows: bool = False

    def fit(self, dataset, *, rng, progress=None):
        self.seen_, Clock.fits = dataset.n_steps, Clock.fits + 1
        return self

    def next_state(self, carry, control):
        Clock.now += len(carry) * EACH * (self.seen_ / 1000 if self.grows else 1.0)
        return carry[:, : self.system.nx]


class OfPython(Linear):
    """A family whose models may have no compiled form; these have one."""

    timing_parameters = {"ridge": 0.5}  # noqa: RUF012


@pytest.fixture(autouse=True)
def _families(register, monkeypatch):
    register(models, "slow", Slow)
    register(models, "of_python", OfPython)
    monkeypatch.setenv("SYSID_EVO_ENGINE", "auto")
    monkeypatch.setattr(slow_models, "time", SimpleNamespace(process_time=Clock.look))
    slow_models._timed.cache_clear()


def planned(*specs, **settings):
    settings = {"ensembles": (), "reference": False, "search_minutes": 2.0, **settings}
    return plan_comparison(Experiment(models=specs, **settings), dataset=example_dataset(episodes=3, steps=400))


def generations(comparison):
    return {cell.name: cell.settings.evolution.generations for cell in comparison.plan.of_kind("evolve")}


def test_a_slow_model_gets_as_many_generations_as_fit_into_its_time():
    comparison = planned("linear", "slow", ensembles=("linear+slow",))
    fitting = int(120.0 / GENERATION)
    assert generations(comparison) == {"linear": 900, "slow": fitting, "linear+slow": fitting}
    (polish,) = comparison.plan.of_kind("polish")
    assert polish.settings.generations == fitting
    assert any(f"slow: {fitting} of 900 generations, about 2 min" in text for text in comparison.plan.remarks)
    (search,) = (cell for cell in comparison.plan.of_kind("evolve") if cell.name == "slow")
    assert search.expected_seconds == pytest.approx(120.0)


def test_a_search_has_ten_generations_however_long_they_take():
    comparison = planned("slow", search_minutes=0.01)
    assert generations(comparison) == {"slow": 10}
    assert any("slow: 10 of 900 generations, about 0.83 min" in text for text in comparison.plan.remarks)


def test_a_short_search_is_not_shortened():
    comparison = planned("slow", generations=11)
    assert generations(comparison) == {"slow": 11}
    assert not any("generations" in text for text in comparison.plan.remarks)


def test_the_time_of_a_step_that_grows_with_the_data_is_extrapolated():
    """To the 1,200 steps of the recording."""
    (found,) = planned("slow(grows=True)").experiment.step_seconds.values()
    assert found == pytest.approx(1200 / 1000 * EACH + slow_models.IN_NUMPY, rel=0.02)


def test_the_time_of_compiled_support_vectors_is_extrapolated_and_that_of_trees_is_not(monkeypatch):
    """Each step of a compiled model takes here as many microseconds as its fit had steps."""
    monkeypatch.setattr(slow_models, "_seconds", lambda model: 1e-6 * len(model.training_sample_))
    lags = "state_lags=0, control_lags=0"
    found = planned(f"a=regressor(estimator=SVR, {lags})", f"b=regressor(estimator=DecisionTreeRegressor, {lags})")
    times = {text[0]: seconds for text, seconds in found.experiment.step_seconds.items()}
    assert times["a"] > 1.1 * times["b"] > 0.0


def test_a_run_is_planned_again_with_the_same_times():
    first, fits = planned("slow"), Clock.fits
    slow_models._timed.cache_clear()
    again = plan_comparison(first.experiment, dataset=example_dataset(episodes=3, steps=400))
    assert Clock.fits == fits, "no model is fitted again"
    assert [cell.digest for cell in again.plan] == [cell.digest for cell in first.plan]


def test_a_compiled_model_is_not_slow():
    assert planned("of_python").experiment.step_seconds == {}


def test_regressors_without_compiled_form_are_slow(monkeypatch):
    monkeypatch.setattr(slow_models, "time", time)
    quick, slow = "estimator=Ridge", "estimator=KNeighborsRegressor, algorithm=brute"
    specs = (f"{name}=regressor({kind}, state_lags=0, control_lags=0)" for name, kind in (("b", quick), ("a", slow)))
    (text,) = planned(*specs).experiment.step_seconds
    assert text.startswith("a=")


def test_a_plan_without_recordings_times_a_model_fitted_to_random_numbers():
    comparison = plan_comparison(Experiment(models=("slow",), reference=False, robot="cart_pole"))
    assert comparison.experiment.step_seconds == {"slow": 2e-5}


def test_the_report_shows_how_many_generations_were_left():
    champion = SimpleNamespace(name="a", against=("mine", "b"), polished=False, history=np.zeros((120, 3)))
    other = SimpleNamespace(name="b", against=("b",), polished=False, history=np.zeros((120, 3)))
    settings = {"generations": 900, "polish_generations": 240, "step_seconds": {"mine=slow": 2e-5}}
    (sentence,) = fewer_generations(SimpleNamespace(champions=[champion, other]), settings)
    assert sentence.startswith("a: 120 of 900 generations, because a step takes long in mine 20 µs")
