"""What is compared by default where a state is an angle, and which episodes are held back where they are short."""

from __future__ import annotations

from typing import Any

import numpy as np

from evaluation.cells.data import Split, whole_episodes
from evaluation.experiment import Experiment
from evaluation.planning import plan_comparison
from sysid_evo.data import Dataset
from sysid_evo.registry import models
from sysid_evo.system import Channel, System

SWING = System(
    (Channel("angle", "rad", period=2.0 * np.pi), Channel("speed", "rad/s")),
    (Channel("torque", "N m", -1.0, 1.0),),
    0.05,
)


def swings(lengths):
    rng = np.random.default_rng(0)
    states = [np.cumsum(rng.standard_normal((length + 1, 2)), axis=0) for length in lengths]
    return Dataset.from_arrays(SWING, states, [rng.uniform(-1.0, 1.0, length) for length in lengths])


def test_families_that_predict_well_where_an_angle_comes_round_are_the_default_there():
    plan = plan_comparison(Experiment(only="prediction"), dataset=swings([400, 400]))
    assert set(plan.fits) == {"backprop27", "nearest_neighbour", "sindy", "narx", "mlp_ensemble"}
    assert plan.experiment.models is not None
    assert len(plan.experiment.models) == len(plan.fits)  # the run can be planned again from what is stored of it
    assert any("evolved3 is left out" in text and "angle comes round" in text for text in plan.plan.remarks)
    asked = plan_comparison(Experiment(only="prediction", models=("evolved3", "linear")), dataset=swings([400, 400]))
    assert set(asked.fits) == {"evolved3", "linear"}
    assert not any("left out" in text for text in asked.plan.remarks)


def test_a_family_that_says_it_is_periodic_steps_the_same_a_turn_later():
    data = swings([300])
    names = [name for name in models.names() if getattr(models.get(name), "periodic", False)]
    assert {"nearest_neighbour", "k_neighbours", "sindy", "narx", "mlp_ensemble", "gaussian_process"} <= set(names)
    assert "linear" not in names
    quick: dict[str, dict[str, Any]] = {name: models.get(name).presets.get("quick", {}) for name in names}
    for name in ("nearest_neighbour", "sindy_discrete", "narx", "backprop27"):
        model = models.make(name, **quick[name]).fit(data)
        lags, control, turn = model.n_lags, np.array([[0.5]]), np.array([[2.0 * np.pi, 0.0]])
        states = np.tile([[0.4, 1.0]], (1, lags + 1, 1))
        begun, later = (model.start(some, np.zeros((1, lags, 1))) for some in (states, states + turn))
        np.testing.assert_allclose(model.next_state(later, control), model.next_state(begun, control) + turn)


def test_whole_episodes_are_held_back_where_parts_of_them_would_be_too_short():
    short = swings([40, 90] * 10)
    names = whole_episodes(short, 0.25)
    held = sum(len(episode) for episode in short if episode.name in names)
    assert 0.15 * short.n_steps < held <= 0.25 * short.n_steps
    parts = Split().of(short)
    assert parts.test is not None
    assert set(parts.test.names) == set(names)
    assert {*parts.training.names, *names} == set(short.names)


def test_a_few_episodes_or_long_ones_are_cut_instead():
    assert whole_episodes(swings([40] * 7), 0.25) == []
    assert whole_episodes(swings([400] * 9), 0.25) == []
    assert whole_episodes(swings([400] * 9 + [20] * 9), 0.25) == []
    parts = Split().of(swings([400] * 9))
    assert parts.test is not None
    assert len(parts.test) == len(parts.training) == 9
