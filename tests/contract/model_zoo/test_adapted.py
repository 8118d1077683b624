"""A model adapted to another floor: better there, untouched where nothing has changed, stored with its base."""

from collections import Counter
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.engine.compiled.open_loop import kernel_step
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.models import load_model, save_model
from sysid_evo.models.adaptation import adapted as module
from sysid_evo.models.adaptation import selection
from sysid_evo.models.adaptation.action import ActionCorrection
from sysid_evo.models.adaptation.adapted import Adapted, calibrated_elsewhere
from sysid_evo.models.adaptation.correction import CorrectionTerms
from sysid_evo.models.adaptation.selection import (
    FINE_TUNED,
    NEW_FIT,
    NONE,
    REFIT,
    Adaptation,
    AdaptationDecision,
    LearnedCorrection,
)
from sysid_evo.models.base import make_model
from sysid_evo.system import System
from sysid_evo.validation import intervals
from sysid_evo.validation.acceptance import AND
from sysid_evo.validation.intervals import LAGS, MAX_WINDOWS
from tests.benchmarks.coverage import coverage
from tests.fixtures.systems import FloorCar, drive

OTHER = FloorCar(thrust=1.8, turn=2.0)


@contextmanager
def only(*kinds):
    """Corrections of these kinds are the only ones tried: all five take far longer than one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(selection, "KINDS", kinds)
        yield patch


@pytest.fixture
def quickly():
    with only("linear"):
        yield


@pytest.fixture(scope="module")
def training():
    return drive(FloorCar(), seconds=60.0, seed=1)


@pytest.fixture(scope="module")
def base(training):
    return make_model("narx", degree=2, terms=8, state_lags=1, control_lags=1).fit(training, rng=0)


@pytest.fixture(scope="module")
def adapted(base):
    with only("linear"):
        return base.adapt(drive(OTHER, seconds=30.0, seed=3))


def test_thirty_seconds_on_another_floor_reduce_the_error_by_at_least_40_per_cent(base, adapted):
    test = drive(OTHER, seconds=40.0, seed=4)
    assert adapted.score(test) > 0.6 * base.score(test)
    assert "lower on 3 blocks it was not fitted to" in adapted.fit_note


def test_without_a_change_of_conditions_the_model_is_not_adapted(base, training):
    same = base.adapt(drive(FloorCar(), seconds=8.0, seed=5))
    windows = training.windows(20, stride=50, history=base.n_lags)
    arguments = (windows.past_states, windows.past_controls, windows.controls)
    np.testing.assert_array_equal(same.simulate(*arguments), base.simulate(*arguments))
    np.testing.assert_array_equal(same.state_bounds_, base.state_bounds_)
    assert same.fit_note.startswith("not adapted: the best candidate (")


@pytest.fixture(scope="module")
def weaker(base):
    """A model adapted to ten seconds of a car whose motor and steering act less."""
    with only("action", "gains", "action + gains"):
        return base.adapt(commanded(drive(FloorCar(), seconds=10.0, seed=3)), rng=0)


def commanded(data):
    """The same motion under stronger commands."""
    return data.with_episodes([replace(e, controls=e.controls / np.array([0.6, 0.7])) for e in data])


def test_ten_seconds_are_enough_to_correct_the_action(base, weaker, tmp_path):
    assert weaker.chosen_.startswith("action, ridge")
    assert not weaker.corrects
    np.testing.assert_allclose(weaker.gain_, [0.6, 0.7], atol=0.1)
    test = commanded(drive(FloorCar(), seconds=40.0, seed=4))
    assert weaker.score(test) > 0.6 * base.score(test)
    loaded = load_model(save_model(weaker, tmp_path / "weaker"))
    assert loaded.score(test) == weaker.score(test)
    assert any(line.startswith("drive -> 0.") for line in weaker.equations())


def late(data):
    """The same motion, but every command was sent one sample before it acted."""
    return data.with_episodes([replace(e, states=e.states[:-1], controls=e.controls[1:]) for e in data])


@pytest.fixture(scope="module")
def delayed(base):
    """A model adapted to ten seconds of the same car, whose commands act one sample later."""
    with only("action", "delayed action", "gains"):
        return base.adapt(late(drive(FloorCar(), seconds=10.0, seed=3, noise=0.0)), rng=0)


def test_ten_seconds_are_enough_to_correct_a_delay(base, delayed, tmp_path):
    assert delayed.chosen_.startswith("delayed action, ridge")
    assert delayed.delay_[0] > 0.7
    test = late(drive(FloorCar(), seconds=40.0, seed=4))
    assert delayed.score(test) > 0.8 * base.score(test)
    loaded = load_model(save_model(delayed, tmp_path / "late"))
    assert loaded.score(test) == delayed.score(test)
    assert any(line.startswith("drive -> ") and "samples later" in line for line in delayed.equations())


def test_a_model_with_a_corrected_action_steps_equally_in_both_engines(base, weaker, delayed):
    data = commanded(drive(FloorCar(), seconds=5.0, seed=6))
    terms = CorrectionTerms.of(weaker.action.recorded(data), model=base)
    coefficients = 0.1 * np.random.default_rng(0).normal(size=terms.shape)
    run, rng = data.episodes[0], np.random.default_rng(1)
    for one in (weaker, delayed):
        both = weaker.holding(LearnedCorrection(base, terms, coefficients, action=one.action))
        lags = both.n_lags
        carry = both.start(run.states[None, : lags + 1], run.controls[None, :lags])
        control = rng.uniform(-1.0, 1.0, (1, 2))
        for model in (one, both):
            assert carry.shape == (1, model.n_carry)
            found = kernel_step(model.kernel(), carry, control, precision="float64")
            np.testing.assert_allclose(found, model.step(carry, control), atol=1e-9)
        acted = one.action(np.stack([run.controls[lags - 1], control[0]]))[1:]
        inner = carry[:, : base.n_carry]
        expected = terms.next_carry(inner, acted, base.step(inner, acted), coefficients)
        np.testing.assert_allclose(both.step(carry, control)[:, : base.n_carry], expected, rtol=1e-12)


def test_action_and_acceleration_are_corrected_together(base):
    """A car whose motor acts less and that turns less: neither correction alone describes both."""
    kinds = ("linear", "gains", "action + gains")
    with only(*kinds):
        found = base.adapt(commanded(drive(FloorCar(turn=2.0), seconds=12.0, seed=3)), rng=0)
    tried = dict(zip(found.candidates_, found.test_errors_, strict=True))
    best = {kind: min(e[0] for n, e in tried.items() if n.startswith(f"{kind}, ridge")) for kind in kinds}
    assert best["action + gains"] < min(best["linear"], best["gains"])


def test_a_recording_too_short_for_a_held_out_block_changes_nothing(base):
    short = base.adapt(drive(OTHER, seconds=2.0, seed=3))
    assert "too short for three blocks" in short.fit_note
    assert not np.any(short.coefficients_)


@pytest.mark.usefixtures("quickly")
def test_a_stored_adapted_model_holds_its_base_and_can_be_adapted_again(adapted, tmp_path):
    loaded = load_model(save_model(adapted, tmp_path / "there"))
    test = drive(OTHER, seconds=10.0, seed=7)
    assert loaded.score(test) == adapted.score(test)
    assert loaded.fit_note == adapted.fit_note
    assert type(loaded.base_) is type(adapted.base_)
    back, again = drive(FloorCar(), seconds=20.0, seed=9), loaded.adapt(drive(FloorCar(), seconds=20.0, seed=8))
    assert again.score(back) > 0.8 * loaded.score(back)


@pytest.mark.usefixtures("quickly")
def test_a_stored_model_is_named_by_its_path(base, tmp_path):
    path, there = save_model(base, tmp_path / "base"), drive(OTHER, seconds=8.0, seed=3)
    by_path = make_model("adapted", base=str(path)).fit(there, rng=0)
    assert by_path.score(there) == base.adapt(there).score(there)
    with pytest.raises(InvalidArgument, match="there is no model to adapt"):
        make_model("adapted", base=None).fit(there, rng=0)


@pytest.mark.usefixtures("quickly")
def test_with_the_training_data_a_refit_is_tried_as_well(base, adapted, training):
    assert REFIT in base.adapt(drive(OTHER, seconds=8.0, seed=3), training=training).candidates_
    assert REFIT not in adapted.candidates_


@pytest.mark.usefixtures("quickly")
def test_a_bad_model_is_refitted_if_that_passes_the_same_acceptance_test(training):
    data = drive(OTHER, seconds=30.0, seed=3)
    backward = replace(data.episodes[0], controls=-data.episodes[0].controls[:, ::-1])
    useless = make_model("narx", degree=2, terms=8).fit(data.with_episodes([backward]), rng=0)
    test, anew = drive(OTHER, seconds=20.0, seed=4), make_model("narx", degree=2, terms=8).fit(data, rng=0)
    found = useless.adapt(data, rng=0)
    assert found.chosen_.endswith(NEW_FIT)
    assert found.score(test) > 1.1 * anew.score(test)
    assert found.score(test) > 0.5 * useless.score(test)


def test_the_state_bounds_cover_both_recordings(base, adapted):
    weak = make_model("linear").fit(drive(FloorCar(thrust=2.0), seconds=40.0, seed=1), rng=0)
    with only("products"):
        wide = weak.adapt(drive(FloorCar(), seconds=12.0, seed=3))
    assert wide.coefficients_.any()
    assert wide.state_bounds_[1, 0] > weak.state_bounds_[1, 0]
    assert (wide.state_bounds_[0] <= weak.state_bounds_[0]).all()
    assert len(wide.training_sample_) > len(weak.training_sample_)
    assert (adapted.state_bounds_[1] >= base.state_bounds_[1]).all()


def test_data_of_another_robot_are_refused_and_of_other_limits_taken(base):
    there = drive(OTHER, seconds=2.0, seed=3)
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
def test_fine_tuning_a_network_continues_from_its_weights(family, training):
    model = make_model(family, **NETWORKS[family], updates=20, horizon=10).fit(training, rng=0)
    there, rng = drive(OTHER, seconds=20.0, seed=3), np.random.default_rng(0)
    hardly, further = (model.fine_tuned(there, updates, rng=rng) for updates in (1, 100))
    assert hardly is not None
    assert further is not None
    assert hardly.score(training) == pytest.approx(model.score(training), rel=0.05)
    test = drive(OTHER, seconds=20.0, seed=4)
    assert further.score(test) > 0.7 * model.score(test)


def test_a_family_without_updates_is_not_fine_tuned(base, training):
    assert base.fine_tuned(training, 10, rng=np.random.default_rng(0)) is None


@pytest.fixture(scope="module")
def between(training):
    """A network adapted to a floor on which the mean of a correction and a refit is best by far."""
    network = make_model("mlp_ensemble", **NETWORKS["mlp_ensemble"], updates=20, horizon=10).fit(training, rng=0)
    with only("linear") as patch:
        patch.setattr(selection, "EQUAL_SHARE", 0.0)
        patch.setattr(selection, "FINE_TUNED", {})
        return network.adapt(drive(OTHER, seconds=20.0, seed=3, noise=0.05), rng=0)


def test_the_mean_of_a_correction_and_another_candidate_is_tried_and_accepted(between):
    assert between.chosen_.count(AND) == 1, between.fit_note
    correction, way = between.chosen_.split(AND)
    assert {correction, way} <= set(between.candidates_)
    assert not between.corrects
    first, second = between.base_.members_
    assert first.corrects
    np.testing.assert_array_equal(between.base_.weights_, [0.5, 0.5])
    test = drive(OTHER, seconds=20.0, seed=4, noise=0.05)
    assert between.score(test) > 0.8 * first.base_.score(test)
    assert not hasattr(second, "coefficients_")


def test_such_a_mean_is_stored(between, tmp_path):
    loaded = load_model(save_model(between, tmp_path / "between"))
    test = drive(OTHER, seconds=10.0, seed=7)
    assert loaded.score(test) == between.score(test)


@pytest.fixture(scope="module")
def lines(training):
    """A linear model with a spread, as it was and adapted to a floor that shakes, and one without a spread adapted."""
    there = drive(OTHER, seconds=30.0, seed=3, noise=0.05)
    noisy, plain = (make_model("linear", stochastic=stochastic).fit(training, rng=0) for stochastic in (True, False))
    with only("linear"):
        return noisy, noisy.adapt(there, rng=0), plain.adapt(there, rng=0)


def test_no_mean_is_tried_for_a_model_with_process_noise(lines):
    _, noisy, plain = lines
    means = [name for name in plain.candidates_ if AND in name]
    assert means == [name for name in plain.candidates_ if name.endswith(AND + NEW_FIT)]
    assert noisy.candidates_ == [name for name in plain.candidates_ if name not in means]


def test_the_spread_of_an_adapted_model_is_that_of_the_new_condition(lines):
    model, adapted, _ = lines
    assert adapted.corrects
    assert adapted.n_recent == 0 < model.n_recent, "the factor of the base compares with another condition"
    test = drive(OTHER, seconds=60.0, seed=4, noise=0.05)
    windows = test.windows(60, stride=9, history=model.n_lags)

    def held(judged):
        drawn = judged.simulate(windows.past_states, windows.past_controls, windows.controls, samples=60, rng=3)
        return np.array([coverage(drawn[:, :, h - 1], windows.states[:, h - 1]).mean() for h in (1, 10, 20, 60)])

    assert (np.abs(held(adapted) - 0.9) < 0.08).all(), held(adapted)
    assert (held(model) < 0.7).all(), held(model)


def test_without_noise_an_adapted_model_predicts_what_it_would_have_without_a_spread(lines):
    _, noisy, plain = lines
    assert noisy.corrects
    assert noisy.n_noise == 3
    quiet, test = noisy.without_noise(), drive(OTHER, seconds=10.0, seed=4)
    assert quiet.n_noise == 0
    run = test.episodes[0]
    assert plain.chosen_ == noisy.chosen_
    np.testing.assert_array_equal(quiet.simulate(run), plain.simulate(run))
    assert noisy.score(test) == quiet.score(test)
    assert not np.array_equal(noisy.simulate(run), quiet.simulate(run))
    assert plain.without_noise() is plain


NOISE = 0.05


@pytest.fixture(scope="module")
def steady():
    """A model of the car, linear and with a spread, that hardly errs."""
    return make_model("linear", stochastic=True).fit(drive(FloorCar(), seconds=40.0, seed=1, noise=0.001), rng=0)


@pytest.fixture(scope="module")
def parts():
    """Two recordings of the same car on a floor that shakes, the second of two episodes."""
    first, second, third = (drive(FloorCar(), seconds=s, seed=s, noise=NOISE) for s in (12, 7, 9))
    return [first, second.with_episodes([*second, *third])]


def uncorrected(steady, held):
    terms = CorrectionTerms.of(drive(FloorCar(), seconds=5.0, seed=3))
    return LearnedCorrection(steady, terms, np.zeros(terms.shape), held)


def test_a_model_that_keeps_its_base_has_its_intervals(steady, parts):
    same, windows = Adapted.holding(uncorrected(steady, parts[0])), parts[0].windows(20, stride=9, history=20)
    runs = [
        one.simulate(windows.past_states, windows.past_controls, windows.controls, samples=5) for one in (same, steady)
    ]
    np.testing.assert_array_equal(*runs)
    assert (steady.start(windows.past_states, windows.past_controls)[:, -1] > 2.0).all()


def kept(model):
    return [getattr(model, name).copy() for name in ("residual_", "persistent_", "horizon_scales_")]


def test_the_error_of_a_step_is_that_over_all_held_parts_and_the_base_keeps_its_own(steady, parts):
    before = kept(steady)
    found = calibrated_elsewhere(steady, [uncorrected(steady, held) for held in parts], np.random.default_rng(0))
    assert found is not steady
    assert all((one == other).all() for one, other in zip(kept(steady), before, strict=True))
    assert found.residual_[:2] == pytest.approx(np.full(2, NOISE), rel=0.25)  # how it turns is not linear
    assert (found.residual_[:2] > 3.0 * before[0][:2]).all()
    assert (found.persistent_[:2] < 0.3).all()


def test_samples_of_two_parts_and_of_two_episodes_are_never_neighbours(steady, parts, monkeypatch):
    seen = []

    def persistent_share(errors, numbers):
        seen.append(numbers)
        return np.zeros(errors.shape[1])

    monkeypatch.setattr(intervals, "persistent_share", persistent_share)
    calibrated_elsewhere(steady, [uncorrected(steady, held) for held in parts], np.random.default_rng(0))
    (numbers,) = seen
    steps = np.diff(numbers)
    assert (steps > 0).all()
    assert (np.sort(steps)[-2:] > max(LAGS)).all()
    assert (np.sort(steps)[:-2] == 1).all()


def test_every_part_is_run_with_the_error_of_all_and_has_its_share_of_windows(steady, parts, monkeypatch):
    cases = []

    def horizon_scales(own, *_):
        cases.extend(own)
        return np.ones((4, 3))

    monkeypatch.setattr(module, "MAX_WINDOWS", 60)
    monkeypatch.setattr(module, "horizon_scales", horizon_scales)
    apart = [*(uncorrected(steady, held) for held in parts), uncorrected(steady, None)]
    found = calibrated_elsewhere(steady, apart, np.random.default_rng(0))
    assert [len(case.windows) for case in cases] == [30, 30]
    assert all((case.model.base.residual_ == found.residual_).all() for case in cases)
    assert MAX_WINDOWS > 60


def test_a_correction_is_part_of_the_step(steady, parts):
    """One that adds as much to every acceleration shifts every step by that, and is no noise about a mean."""
    plain, pushed = uncorrected(steady, parts[0]), 1.0
    coefficients = plain.coefficients.copy()
    coefficients[0] = pushed / (plain.terms.unit * steady.system.dt)
    shifted = calibrated_elsewhere(steady, [replace(plain, coefficients=coefficients)], np.random.default_rng(0))
    assert shifted.residual_ == pytest.approx(np.full(3, pushed), rel=0.1)


@pytest.mark.parametrize(
    ("action", "done"),
    [
        (ActionCorrection(np.array([0.6, 0.7]), np.zeros(2)), commanded),
        (ActionCorrection(np.ones(2), np.zeros(2), 1.0), late),
    ],
)
def test_a_correction_of_the_action_is_part_of_the_step(steady, parts, action, done):
    plain = [uncorrected(steady, held) for held in parts]
    acted = [replace(one, held=done(one.held), action=action) for one in plain]
    expected, found, wrong = (
        calibrated_elsewhere(steady, cases, np.random.default_rng(0)).residual_
        for cases in (plain, acted, [replace(one, action=None) for one in acted])
    )
    np.testing.assert_allclose(found, expected, rtol=1e-9 if action.delay == 0.0 else 0.02)
    assert (wrong > 1.05 * expected).any()


@pytest.mark.parametrize(
    ("chosen", "anew"),
    [(NONE, False), (NEW_FIT, False), (REFIT, False), ("linear, ridge 3", True), ("fine-tuned, 50 updates", True)],
)
def test_refitted_and_unchanged_models_keep_their_own_spread(steady, parts, monkeypatch, chosen, anew):
    learned = uncorrected(steady, None)
    found = Adaptation(learned, AdaptationDecision(10.0, 3, (), chosen), (uncorrected(steady, parts[0]),))
    monkeypatch.setattr(module, "adaptation", lambda *_, **__: found)
    calibrated = steady.variant()
    monkeypatch.setattr(module, "calibrated_elsewhere", lambda *_: calibrated)
    model = make_model("adapted", base=None).given(steady).fit(parts[0], rng=0)
    assert model.base_ is (calibrated if anew else steady)


def polynomial(thrust):
    data = drive(FloorCar(thrust=thrust), seconds=30.0, seed=1)
    return make_model("narx", degree=2, terms=8, state_lags=0, control_lags=0).fit(data, rng=0)


@pytest.mark.usefixtures("quickly")
@pytest.mark.parametrize(
    ("thrust", "blocks", "of_way", "of_mean"),
    [
        (5.0, 1, False, False),  # the wrong way: both it and the mean are much worse in the first block
        (0.5, 3, False, True),  # too far: farther off than the model was, but the mean is in the middle
        (1.6, 3, True, True),
    ],
)
def test_a_candidate_is_dropped_after_a_block_in_which_it_and_its_mean_are_much_worse(
    thrust, blocks, of_way, of_mean, monkeypatch
):
    model, further, called = polynomial(3.0), polynomial(thrust), Counter()

    def fine_tuned(self, dataset, updates, *, rng):
        called[updates] += 1
        return further

    monkeypatch.setattr(type(model), "fine_tuned", fine_tuned)
    adapted = model.adapt(drive(FloorCar(thrust=1.7), seconds=12.0, seed=3, noise=0.0), rng=0)
    shown = dict(zip(adapted.candidates_, adapted.test_errors_, strict=True))
    for way in FINE_TUNED:
        (mean,) = [name for name in shown if name.endswith(AND + way)]
        for name, better in ((way, of_way), (mean, of_mean)):
            assert len(shown[name]) == 1 + blocks
            assert (max(shown[name][1:]) < 1.1) == better, shown[name]
    chosen = [updates for way, updates in zip(FINE_TUNED, called, strict=True) if way in adapted.chosen_]
    assert {updates: count - (updates in chosen) for updates, count in called.items()} == dict.fromkeys(called, blocks)
