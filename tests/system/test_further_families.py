"""Where no default family predicts, others are tried before anything is evolved."""

from dataclasses import replace

import numpy as np
import pytest

from evaluation import chosen_models, compare, plan_run, running, with_further_families
from evaluation.experiment import Experiment
from evaluation.prediction.scoring import assess_prediction
from evaluation.report.sections.prediction import headline
from model_zoo.linear import Linear
from sysid_evo.cli.experiments import print_held_out_scores
from sysid_evo.data import Dataset
from sysid_evo.plan import Store, execute
from sysid_evo.registry import models
from tests.fixtures.recordings import oscillator_data

pytestmark = pytest.mark.usefixtures("blank_figures")

FAR = "far"


class Far(Linear):
    """A linear model that simulates far from everything that was measured."""

    def fit(self, dataset, **settings):
        fitted = super().fit(dataset, **settings)
        fitted.intercept_ = fitted.intercept_ + 100.0
        return fitted


@pytest.fixture
def useless_default(register, monkeypatch):
    """One family that predicts nothing is the only default one; linear and k_neighbours are the further ones."""
    register(models, FAR, Far)
    monkeypatch.setattr(chosen_models, "OTHER_FAMILIES", (FAR,))
    monkeypatch.setattr(running, "FURTHER_FAMILIES", ("linear", "k_neighbours"))


def many_episodes():
    """The episodes of the oscillator six times, enough to compare models."""
    data = oscillator_data()
    episodes = [episode for _ in range(6) for episode in data]
    states, controls = ([getattr(one, name) for one in episodes] for name in ("states", "controls"))
    return Dataset.from_arrays(data.system, states, controls)


def settled(folder, data=None, **settings):
    """Return the labels and the tried models of a comparison whose families are settled."""
    data = many_episodes() if data is None else data
    experiment = Experiment.of({"stop_after": "prediction", "held_out": 0.5, **settings})
    comparison, _ = plan_run(experiment, folder, data)
    if experiment.chooses_families:
        store = Store(folder)
        comparison = with_further_families(comparison, store, lambda plan: execute(plan, store), data)
    return list(comparison.fits), list(comparison.experiment.tried_models)


@pytest.mark.usefixtures("useless_default")
def test_the_first_further_family_that_predicts_is_added_and_the_report_says_so(tmp_path):
    report = compare(many_episodes(), out=tmp_path, stop_after="prediction", held_out=0.5)
    assert [model.name for model in report.models] == [FAR, "linear"]
    assert Experiment.read(tmp_path)["tried_models"] == ["linear"]
    assert "of linear, tried in this order, linear is, and was added" in (tmp_path / "report.html").read_text()
    assert settled(tmp_path) == ([FAR, "linear"], ["linear"])
    in_vain = replace(report, settings={"tried_models": ("k_neighbours",)})
    assert "of k_neighbours, tried in this order, none is." in repr(headline(in_vain))


@pytest.mark.usefixtures("useless_default")
def test_a_family_worse_than_no_change_and_a_linear_model_is_reported_after_its_fit(tmp_path, capsys):
    report = compare(many_episodes(), out=tmp_path / "compared", stop_after="prediction", held_out=0.5)
    far, linear = (report.prediction.model(name) for name in (FAR, "linear"))
    assert far.warning.startswith("far is worse than both no change (persistence) and a linear model on held-out data")
    assert not linear.warning
    assert (
        f"{far.warning}. Forecasts leave it out if two others remain."
        in (tmp_path / "compared/report.html").read_text()
    )
    direct = assess_prediction(
        {FAR: Far().fit(many_episodes(), rng=np.random.default_rng(0))}, many_episodes(), many_episodes()
    )
    assert direct.model(FAR).warning
    experiment = Experiment.of({"stop_after": "fit", "models": (FAR, "linear")})
    comparison, _ = plan_run(experiment, tmp_path / "fitted", many_episodes())
    store = Store(tmp_path / "fitted")
    execute(comparison.plan, store)
    print_held_out_scores(comparison, store)
    shown = " ".join(capsys.readouterr().err.split())
    assert "far is worse than both no change" in shown
    assert "linear is worse" not in shown


@pytest.mark.usefixtures("useless_default")
def test_a_model_that_only_scored_is_evolved_in_where_no_other_predicts(tmp_path, monkeypatch):
    monkeypatch.setattr(chosen_models, "SCORING_FAMILIES", ("linear",))
    experiment = Experiment.of({"held_out": 0.5, "task": "set_point(channels=position)"})
    comparison, _ = plan_run(experiment, tmp_path, many_episodes())
    assert (list(comparison.fits), comparison.experiment.searched) == ([FAR, "linear"], (FAR,))
    store = Store(tmp_path)
    found = with_further_families(comparison, store, lambda plan: execute(plan, store), many_episodes())
    assert (list(found.fits), found.experiment.searched) == ([FAR, "linear"], (FAR, "linear"))
    assert found.experiment.tried_models == ("linear",)


@pytest.mark.usefixtures("useless_default")
def test_families_that_were_tried_in_vain_are_named_and_left_out(tmp_path, monkeypatch):
    monkeypatch.setattr(running, "FURTHER_FAMILIES", ("far2=far",))
    assert settled(tmp_path) == ([FAR], ["far2=far"])


@pytest.mark.usefixtures("useless_default")
def test_families_that_are_named_are_compared_as_they_are(tmp_path):
    assert settled(tmp_path, models=(FAR,)) == ([FAR], [])


@pytest.mark.usefixtures("useless_default")
def test_nothing_is_added_if_the_test_data_are_too_few_to_decide(tmp_path):
    assert settled(tmp_path, data=oscillator_data()) == ([FAR], [])


def test_nothing_is_tried_where_a_default_family_predicts(tmp_path, monkeypatch):
    monkeypatch.setattr(chosen_models, "OTHER_FAMILIES", ("linear",))
    assert settled(tmp_path) == (["linear"], [])
