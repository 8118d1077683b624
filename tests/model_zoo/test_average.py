"""The mean of named families: equal weights, everything learned, nothing chosen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from model_zoo.average import Average
from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleSystem, SysidEvoError
from sysid_evo.models import load_model, save_model
from sysid_evo.models.base import make_model
from sysid_evo.registry import make_robot
from sysid_evo.testing.examples import example_dataset
from tests.fixtures.systems import FloorCar, drive


@pytest.fixture(scope="module")
def data() -> Dataset:
    return example_dataset()


@pytest.fixture(scope="module")
def average(data: Dataset) -> Any:
    return make_model("average(families=[linear, narx(terms=4)])").fit(data, rng=0)


def test_it_predicts_the_mean_of_what_its_families_predict(average: Any, data: Dataset) -> None:
    windows = data.windows(1, history=average.n_lags)
    predicted = average.simulate(windows.past_states, windows.past_controls, windows.controls)
    members = [
        model.simulate(windows.past_states, windows.past_controls, windows.controls)
        for model in (make_model("linear").fit(data, rng=0), make_model("narx(terms=4)").fit(data, rng=0))
    ]
    np.testing.assert_allclose(predicted, np.mean(members, axis=0), atol=1e-9)
    assert not np.allclose(members[0], members[1], atol=1e-3)


def test_it_is_stored_with_its_members_and_names_what_it_uses(average: Any, data: Dataset, tmp_path: Path) -> None:
    loaded = load_model(save_model(average, tmp_path / "average"))
    assert loaded.score(data) == average.score(data)
    assert average.uses() == ("linear", "narx")
    assert make_model("average").uses() == ("narx", "k_neighbours")


def test_fitted_models_are_put_together_with_the_widest_envelope() -> None:
    slow, fast = (
        make_model("linear").fit(drive(FloorCar(thrust=thrust), seconds=20.0, seed=1), rng=0) for thrust in (1.0, 3.0)
    )
    made = Average.made_of([slow, fast])
    np.testing.assert_array_equal(made.envelope_[0], np.minimum(slow.envelope_[0], fast.envelope_[0]))
    np.testing.assert_array_equal(made.envelope_[1], np.maximum(slow.envelope_[1], fast.envelope_[1]))
    assert made.envelope_[1, 0] > slow.envelope_[1, 0]
    np.testing.assert_array_equal(made.weights_, [0.5, 0.5])
    assert made.system == slow.system


def test_with_noise_it_spreads_as_far_as_it_errs() -> None:
    data = drive(FloorCar(), seconds=60.0, seed=1, noise=0.05)
    model = make_model("average(stochastic=true)").fit(data, rng=0)
    test = drive(FloorCar(), seconds=60.0, seed=2, noise=0.05)
    windows = test.windows(20, stride=9, history=model.n_lags)
    drawn = model.simulate(windows.past_states, windows.past_controls, windows.controls, samples=60, rng=3)
    low, high = np.quantile(drawn[:, :, -1], [0.05, 0.95], axis=0)
    held = ((windows.states[:, -1] >= low) & (windows.states[:, -1] <= high)).mean()
    assert 0.8 < held < 0.98


@pytest.mark.parametrize(
    ("families", "said"),
    [
        ([], "families: expected at least one family, got none"),
        (["narx", "average"], "families: expected other families, got average, which would hold itself"),
        (["nrax"], "narx"),
        (["narx(term=4)"], "term"),
    ],
)
def test_wrong_families_are_refused_at_once(families: list[str], said: str) -> None:
    with pytest.raises(SysidEvoError, match=said):
        make_model("average", families=families)


def test_a_family_that_does_not_fit_the_system_is_named() -> None:
    with pytest.raises(IncompatibleSystem, match=r"families: linear is not periodic, and angle comes round"):
        make_model("average(families=[narx, linear])").check_system(make_robot("pendulum").system)
    with pytest.raises(IncompatibleSystem, match="Parametrised describes a planar body"):
        make_model("average", families=["parametrised"]).check_system(make_robot("thermal").system)


def test_without_noise_neither_the_mean_nor_its_members_draw_any(data: Dataset) -> None:
    members = [make_model("linear", stochastic=stochastic).fit(data, rng=0) for stochastic in (True, False)]
    mean = Average.made_of(members)
    assert mean.n_noise == 3
    quiet = mean.without_noise()
    assert quiet.n_noise == 0
    np.testing.assert_allclose(quiet.simulate(data.episodes[0]), members[1].simulate(data.episodes[0]), atol=1e-9)
    assert mean.score(data) == quiet.score(data)
    assert quiet.without_noise() is quiet
    noisy = make_model("average(families=[linear], stochastic=true)").fit(data, rng=0)
    assert noisy.n_noise == 3
    assert noisy.without_noise().n_noise == 0
