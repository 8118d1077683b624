"""A model adapted to another floor: better there, untouched where nothing has changed, stored with its base."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.engine.compiled.open_loop import kernel_step
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.models import DynamicsModel, load_model, save_model
from sysid_evo.models.adaptation.selection import ANEW
from sysid_evo.models.base import make_model
from sysid_evo.system import System
from sysid_evo.types import Array
from sysid_evo.validation.acceptance import AND
from tests.benchmarks.coverage import coverage
from tests.fixtures.systems import FloorCar, drive

OTHER = FloorCar(thrust=1.8, turn=2.0)


@pytest.fixture(scope="module")
def training() -> Dataset:
    return drive(FloorCar(), seconds=60.0, seed=1)


@pytest.fixture(scope="module")
def base(training: Dataset) -> DynamicsModel:
    return make_model("narx", degree=2, terms=8, state_lags=1, control_lags=1).fit(training, rng=0)


@pytest.fixture(scope="module")
def adapted(base: DynamicsModel) -> DynamicsModel:
    return base.adapt(drive(OTHER, seconds=30.0, seed=3))


def test_thirty_seconds_of_another_floor_take_at_least_two_fifths_of_the_error(
    base: DynamicsModel, adapted: DynamicsModel
) -> None:
    test = drive(OTHER, seconds=40.0, seed=4)
    assert adapted.score(test) > 0.6 * base.score(test)
    assert "better than none on 3 blocks it did not learn from" in adapted.fit_note


def test_where_nothing_has_changed_the_model_stays_what_it_is(base: DynamicsModel, training: Dataset) -> None:
    same = base.adapt(drive(FloorCar(), seconds=30.0, seed=5))
    windows = training.windows(20, stride=50, history=base.n_lags)
    arguments = (windows.past_states, windows.past_controls, windows.controls)
    np.testing.assert_array_equal(same.simulate(*arguments), base.simulate(*arguments))
    np.testing.assert_array_equal(same.envelope_, base.envelope_)
    assert "no correction: the best" in same.fit_note


def test_a_recording_too_short_to_hold_a_block_back_changes_nothing(base: DynamicsModel) -> None:
    short = base.adapt(drive(OTHER, seconds=2.0, seed=3))
    assert "too short to hold a block back" in short.fit_note
    assert not np.any(short.coefficients_)  # type: ignore[attr-defined]  # of the family adapted


def test_the_compiled_form_steps_as_step_does_around_a_base_with_lags(adapted: DynamicsModel) -> None:
    windows = drive(OTHER, seconds=6.0, seed=6).windows(1, history=adapted.n_lags)
    carry = adapted.start(windows.past_states, windows.past_controls)
    kernel = adapted.kernel()
    assert kernel is not None
    compiled = kernel_step(kernel, carry, windows.controls[:, 0], precision="float64")
    np.testing.assert_allclose(compiled, adapted.step(carry, windows.controls[:, 0]), atol=1e-9)
    assert adapted.n_lags == 1


def test_a_stored_adapted_model_holds_its_base_and_can_be_adapted_again(
    adapted: DynamicsModel, base: DynamicsModel, tmp_path: Path
) -> None:
    loaded = load_model(save_model(adapted, tmp_path / "there"))
    test = drive(OTHER, seconds=10.0, seed=7)
    assert loaded.score(test) == adapted.score(test)
    assert loaded.fit_note == adapted.fit_note
    assert type(loaded.base_) is type(adapted.base_)  # type: ignore[attr-defined]  # of the family adapted
    back, again = drive(FloorCar(), seconds=20.0, seed=9), loaded.adapt(drive(FloorCar(), seconds=20.0, seed=8))
    assert again.score(back) > 0.8 * loaded.score(back)


def test_a_stored_model_is_named_by_its_path(base: DynamicsModel, tmp_path: Path) -> None:
    path = save_model(base, tmp_path / "base")
    there = drive(OTHER, seconds=30.0, seed=3)
    by_path = make_model("adapted", base=str(path)).fit(there, rng=0)
    assert by_path.score(there) == base.adapt(there).score(there)
    with pytest.raises(InvalidArgument, match="there is nothing to adapt"):
        make_model("adapted", base=None).fit(there, rng=0)


def test_with_the_training_data_a_refit_is_tried_as_well(base: DynamicsModel, training: Dataset) -> None:
    there = drive(OTHER, seconds=20.0, seed=3)
    both = base.adapt(there, training=training)
    assert "refit" in both.tried_  # type: ignore[attr-defined]  # of the family adapted
    assert "refit" not in base.adapt(there).tried_  # type: ignore[attr-defined]  # of the family adapted


def test_a_model_that_is_no_use_there_is_fitted_anew_if_that_is_better_by_the_same_gate(training: Dataset) -> None:
    data = drive(OTHER, seconds=30.0, seed=3)
    backward = replace(data.episodes[0], controls=-data.episodes[0].controls[:, ::-1])
    useless = make_model("narx", degree=2, terms=8).fit(data.with_episodes([backward]), rng=0)
    test, anew = drive(OTHER, seconds=20.0, seed=4), make_model("narx", degree=2, terms=8).fit(data, rng=0)
    found: Any = useless.adapt(data, rng=0)
    assert found.chosen_.endswith(ANEW)
    assert found.score(test) > 1.1 * anew.score(test)
    assert found.score(test) > 0.5 * useless.score(test)


def test_the_envelope_covers_both_recordings(base: DynamicsModel, adapted: DynamicsModel) -> None:
    weak = make_model("linear").fit(drive(FloorCar(thrust=2.0), seconds=40.0, seed=1), rng=0)
    wide = weak.adapt(drive(FloorCar(), seconds=20.0, seed=3))
    assert wide.coefficients_.any()  # type: ignore[attr-defined]  # of the family adapted
    assert wide.envelope_[1, 0] > weak.envelope_[1, 0]
    assert (wide.envelope_[0] <= weak.envelope_[0]).all()
    assert len(wide.pairs_) > len(weak.pairs_)
    assert (adapted.envelope_[1] >= base.envelope_[1]).all()


def test_data_of_another_robot_are_refused_and_of_other_limits_taken(base: DynamicsModel) -> None:
    there = drive(OTHER, seconds=10.0, seed=3)
    system = there.system
    narrow = replace(system, controls=tuple(replace(c, low=-0.9, high=0.95) for c in system.controls))
    assert base.adapt(Dataset(narrow, there.episodes)).system == base.system
    slow = System(system.states, system.controls, 0.1, system.motion)
    with pytest.raises(IncompatibleSystem, match="the data are of another system: 20 Hz against 10 Hz"):
        base.adapt(Dataset(slow, tuple(replace(e, dt=0.1) for e in there)))


NETWORKS = {
    "mlp_ensemble": {"members": 2, "hidden": [8], "state_lags": 0, "control_lags": 1, "one_step_updates": 200},
    "neural_ode": {"hidden": [8], "one_step_updates": 200},
    "hybrid_ode": {"hidden": [8], "state_lags": 0, "control_lags": 1, "one_step_updates": 200},
}


@pytest.mark.parametrize("family", NETWORKS)
def test_a_network_goes_on_learning_where_it_ended(family: str, training: Dataset) -> None:
    model = make_model(family, **NETWORKS[family], updates=20, horizon=10).fit(training, rng=0)
    there, rng = drive(OTHER, seconds=20.0, seed=3), np.random.default_rng(0)
    hardly, further = (model.trained_further(there, updates, rng=rng) for updates in (1, 100))
    assert hardly is not None
    assert further is not None
    assert hardly.score(training) == pytest.approx(model.score(training), rel=0.05)
    test = drive(OTHER, seconds=20.0, seed=4)
    assert further.score(test) > 0.7 * model.score(test)


def test_a_family_without_updates_is_not_trained_further(base: DynamicsModel, training: Dataset) -> None:
    assert base.trained_further(training, 10, rng=np.random.default_rng(0)) is None


@pytest.fixture(scope="module")
def between(training: Dataset) -> DynamicsModel:
    """A network adapted to a floor on which the mean of a correction and more training is best."""
    network = make_model("mlp_ensemble", **NETWORKS["mlp_ensemble"], updates=20, horizon=10).fit(training, rng=0)
    return network.adapt(drive(OTHER, seconds=20.0, seed=3, noise=0.05), rng=0)


def test_a_mean_of_a_correction_and_another_way_is_judged_and_taken(between: Any) -> None:
    assert between.chosen_.count(AND) == 1
    correction, way = between.chosen_.split(AND)
    assert {correction, way} <= set(between.tried_)
    assert not between.corrects
    first, second = between.base_.members_
    assert first.corrects
    np.testing.assert_array_equal(between.base_.weights_, [0.5, 0.5])
    test = drive(OTHER, seconds=20.0, seed=4, noise=0.05)
    assert between.score(test) > 0.8 * first.base_.score(test)
    assert not hasattr(second, "coefficients_")


def test_such_a_mean_is_stored_and_compiled(between: Any, tmp_path: Path) -> None:
    loaded = load_model(save_model(between, tmp_path / "between"))
    test = drive(OTHER, seconds=10.0, seed=7)
    assert loaded.score(test) == between.score(test)
    windows = test.windows(1, history=between.n_lags)
    carry, kernel = between.start(windows.past_states, windows.past_controls), loaded.kernel()
    assert kernel is not None
    compiled = kernel_step(kernel, carry, windows.controls[:, 0], precision="float64")
    np.testing.assert_allclose(compiled, between.step(carry, windows.controls[:, 0]), atol=1e-9)


def test_of_a_model_that_draws_noise_no_mean_is_tried(training: Dataset) -> None:
    there = drive(OTHER, seconds=10.0, seed=3)
    with_noise, without = (
        make_model("linear", stochastic=stochastic).fit(training, rng=0).adapt(there, rng=0).tried_  # type: ignore[attr-defined]  # of the family adapted
        for stochastic in (True, False)
    )
    assert [name for name in without if AND in name] == [name for name in without if name.endswith(AND + ANEW)]
    assert with_noise == [name for name in without if AND not in name]


def test_of_a_mean_those_members_are_trained_further_that_can_be(training: Dataset) -> None:
    network: Any = make_model("mlp_ensemble", **NETWORKS["mlp_ensemble"], updates=5).fit(training, rng=0)
    linear: Any = make_model("auto", candidates=["linear"], folds=2).fit(training, rng=0)
    mean = linear.of([linear.members_[0], network], np.array([0.5, 0.5]))
    further = mean.trained_further(drive(OTHER, seconds=10.0, seed=3), 5, rng=np.random.default_rng(0))
    assert further.members_[0] is linear.members_[0]
    assert (further.members_[1].weights_[0] != network.weights_[0]).any()
    assert linear.trained_further(training, 5, rng=np.random.default_rng(0)) is None


def test_the_spread_of_an_adapted_model_is_that_of_the_new_condition(training: Dataset) -> None:
    model = make_model("linear", stochastic=True).fit(training, rng=0)
    there = drive(OTHER, seconds=30.0, seed=3, noise=0.05)
    adapted = model.adapt(there, rng=0)
    assert adapted.corrects  # type: ignore[attr-defined]  # of the family adapted
    test = drive(OTHER, seconds=60.0, seed=4, noise=0.05)
    windows = test.windows(60, stride=9, history=model.n_lags)

    def held(judged: DynamicsModel) -> Array:
        drawn = judged.simulate(windows.past_states, windows.past_controls, windows.controls, samples=60, rng=3)
        return np.array([coverage(drawn[:, :, h - 1], windows.states[:, h - 1]).mean() for h in (1, 10, 20, 60)])

    assert (np.abs(held(adapted) - 0.9) < 0.08).all(), held(adapted)
    assert (held(model) < 0.7).all(), held(model)


def test_without_noise_an_adapted_model_predicts_what_it_would_have_without_a_spread(training: Dataset) -> None:
    there, test = drive(OTHER, seconds=20.0, seed=3, noise=0.05), drive(OTHER, seconds=10.0, seed=4)
    noisy, plain = (
        make_model("linear", stochastic=stochastic).fit(training, rng=0).adapt(there, rng=0)
        for stochastic in (True, False)
    )
    assert noisy.corrects  # type: ignore[attr-defined]  # of the family adapted
    assert noisy.n_noise == 3
    quiet = noisy.without_noise()
    assert quiet.n_noise == 0
    run = test.episodes[0]
    assert plain.chosen_ == noisy.chosen_  # type: ignore[attr-defined]  # of the family adapted
    np.testing.assert_array_equal(quiet.simulate(run), plain.simulate(run))
    assert noisy.score(test) == quiet.score(test)
    assert not np.array_equal(noisy.simulate(run), quiet.simulate(run))
    assert plain.without_noise() is plain
