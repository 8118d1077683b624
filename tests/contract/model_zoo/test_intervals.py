"""How far a prediction may be off: intervals hold what they should on recordings that were never seen."""

from dataclasses import replace

import numpy as np
import pytest

from model_zoo.linear import Linear
from sysid_evo.carry import latest
from sysid_evo.data import Dataset
from sysid_evo.errors import NotFitted
from sysid_evo.models import DynamicsModel, load_model, save_model
from sysid_evo.system import Channel, System
from sysid_evo.testing import MODEL
from sysid_evo.validation.folds import recording_or_time_folds
from sysid_evo.validation.intervals import (
    HORIZONS,
    RECENT,
    RecentErrors,
    growth_on_unseen_recordings,
    horizon_scales,
    persistent_share,
    rough_fits,
    segments,
)
from sysid_evo.validation.intervals import Case as HeldOutCase
from tests.benchmarks.coverage import coverage

pytestmark = pytest.mark.filterwarnings("ignore::sysid_evo.errors.DataWarning")  # the recordings stand still

PAIR = System((Channel("x"), Channel("y")), (Channel("u", low=-1.0, high=1.0),), dt=0.05)
UNSEEN = {"a": 0.2, "b": 0.3, "c": 0.9}


class Biased(DynamicsModel):
    """Drifts by a known amount in every step; x by the bias of the recordings it never saw, y always alike."""

    state_bounds = None  # all states are zero: nothing to clip to

    def fit(self, dataset, *, rng, progress=None):
        seen = {name.split("[")[0] for name in dataset.names}
        self.bias_ = np.array([max((UNSEEN[name] for name in UNSEEN if name not in seen), default=0.1), 0.1])
        return self

    def next_state(self, carry, control):
        return carry + self.bias_


def resting(names):
    return Dataset.from_arrays(PAIR, [np.zeros((241, 2))] * len(names), [np.zeros((240, 1))] * len(names), names=names)


def roughly(part):
    return Biased().fit(part, rng=0)


def test_the_growth_is_the_geometric_mean_over_unseen_recordings_and_at_least_one():
    """Errors on the three are two, three and nine times those on blocks of what was seen."""
    dataset = resting(["a[0:240]", "b", "c"])
    np.testing.assert_allclose(growth_on_unseen_recordings(roughly, dataset), [[54.0 ** (1 / 3), 1.0]] * 4)
    assert rough_fits(dataset) == 5


def test_a_recording_alone_cannot_be_held_out():
    dataset = resting(["a[0:240]", "a[240:480]"])
    assert rough_fits(dataset) == 0
    np.testing.assert_array_equal(growth_on_unseen_recordings(roughly, dataset), np.ones((4, 2)))
    assert len(recording_or_time_folds(dataset)) == 3
    short = dataset.with_episodes([dataset.episodes[0][:40]])
    assert len(recording_or_time_folds(short)) == 1, (
        "where nothing can be held out, the same fit is not made three times"
    )
    assert recording_or_time_folds(short)[0][1] is short


def recorded(seed, episodes=10, steps=400):
    """A damped linear system with noise of three kinds: in every step, all along a recording, and of measurement."""
    rng = np.random.default_rng(seed)
    control = np.repeat(rng.uniform(-1.0, 1.0, (episodes, steps // 10, 1)), 10, axis=1)
    matrix, slope = np.array([[0.95, 0.05], [-0.05, 0.9]]), np.array([[0.1], [0.05]])
    states, lasting = np.zeros((episodes, steps + 1, 2)), 0.01 * rng.standard_normal((episodes, 2))
    for k in range(steps):
        white = rng.standard_normal((episodes, 2)) * [0.01, 0.005]
        states[:, k + 1] = states[:, k] @ matrix.T + control[:, k] @ slope.T + white + lasting
    measured = states + 0.02 * rng.standard_normal(states.shape)
    return Dataset.from_arrays(PAIR, list(measured), list(control), names=[f"{seed}-{i}" for i in range(episodes)])


def held(model, data):
    """Return the coverage (nx,) at each horizon."""
    windows = data.windows(max(HORIZONS), stride=9, history=model.n_lags)
    drawn = model.simulate(windows.past_states, windows.past_controls, windows.controls, samples=60, rng=3)
    return [coverage(drawn[:, :, h - 1], windows.states[:, h - 1]) for h in HORIZONS]


def test_intervals_hold_nine_in_ten_at_all_four_horizons_of_recordings_never_seen():
    model = Linear(stochastic=True).fit(recorded(1), rng=0)
    found = np.array(held(model, recorded(2)))
    assert (np.abs(found.mean(axis=1) - 0.9) < 0.05).all(), found
    assert model.n_carry == 2 + 2 + 1 + 1
    growing = model.variant()
    growing.horizon_scales_ = np.tile(model.horizon_scales_[:1], (4, 1))
    assert not (np.abs(np.array(held(growing, recorded(2))).mean(axis=1) - 0.9) < 0.05).all()


def test_the_lasting_share_is_distinguished_from_white_and_measurement_noise():
    rng = np.random.default_rng(0)
    sample = np.concatenate([np.arange(20) + 100 * run for run in range(2000)])
    lasting = np.repeat(rng.standard_normal((2000, 2)) * [1.0, 0.5], 20, axis=0)
    white = rng.standard_normal((40_000, 2)) * [1.0, 0.5 * np.sqrt(3.0)]
    measured = 2.0 * np.diff(rng.standard_normal((40_001, 2)), axis=0)
    np.testing.assert_allclose(persistent_share(lasting + white + measured, sample), [0.5, 0.25], atol=0.08)
    np.testing.assert_allclose(persistent_share(lasting, sample), 1.0, atol=0.02)
    assert (persistent_share(white, sample) < 0.05).all()


class Still:
    """Never moves of itself."""

    n_lags, system, state_bounds = 0, PAIR, None

    def initial_carry(self, states, controls):
        return states[:, -1]

    def disturbed(self, carry, control, disturbance):
        return carry + disturbance


def test_each_stretch_of_time_adds_what_is_missing_at_its_end():
    """A walk of step size 1 whose noise triples after ten steps."""
    rng = np.random.default_rng(1)
    size = np.where(np.arange(60) < 10, 1.0, 3.0)[:, None]
    walks = [
        np.cumsum(np.concatenate([np.zeros((1, 2)), size * rng.standard_normal((60, 2))]), axis=0) for _ in range(300)
    ]
    data = Dataset.from_arrays(PAIR, walks, [np.zeros((60, 1))] * 300)
    case = HeldOutCase.of(Still(), data, 60, 300)
    scales = horizon_scales([case], np.zeros(2), np.random.default_rng(0))
    np.testing.assert_allclose(scales, np.array([1.0, 1.0, 3.0, 3.0])[:, None] * np.ones(2), rtol=0.25)
    assert segments(20) == [(0, 1), (1, 10), (10, 20)]
    insensitive = HeldOutCase.of(Still(), data, 60, 300, noisy=Insensitive())
    doubled = horizon_scales([insensitive], np.zeros(2), np.random.default_rng(0))
    np.testing.assert_allclose(doubled, 2.0 * scales)


class Insensitive(Still):
    """Responds half as much to noise."""

    def disturbed(self, carry, control, disturbance):
        return carry + 0.5 * disturbance


def test_a_step_adds_noise_of_which_a_share_lasts_times_a_factor_and_counts_the_steps():
    model = Linear(stochastic=True, control_lags=1).fit(recorded(1, episodes=4, steps=200), rng=0)
    rng = np.random.default_rng(0)
    carry = rng.standard_normal((80, model.n_carry)) * 0.3
    carry[:, -2], carry[:, -1] = np.arange(80), rng.uniform(1.0, 3.0, 80)
    control, noise = rng.uniform(-1.0, 1.0, (80, 1)), rng.standard_normal((80, 2))
    after = model.step(carry, control, noise)
    np.testing.assert_array_equal(after[:, -2], carry[:, -2] + 1)
    np.testing.assert_array_equal(after[:, [-4, -3, -1]], carry[:, [-4, -3, -1]])
    moved = after[:, :2] - model.variant(stochastic=False).step(carry[:, :-4], control)[:, :2]
    share = np.sqrt(1.0 - model.persistent_) * noise + np.sqrt(model.persistent_) * carry[:, -4:-2]
    own = model.horizon_scales_
    away = (1.0 - 1.0 / carry[:, -1:]) ** 2
    spans = [own[0], own[1], own[2], own[3]], [own[0], own[1], own[1:3].max(axis=0), own[1:].max(axis=0)]
    scale, largest = (np.repeat(span, [1, 9, 10, 60], axis=0) for span in spans)
    scale = scale + away * (largest - scale)
    np.testing.assert_allclose(moved, carry[:, -1:] * scale * model.residual_ * share, atol=1e-12)


def history(data, model, count=60):
    """Return windows of ``count`` steps with the whole history that the spread uses."""
    return data.windows(count, stride=9, history=model.n_lags + model.n_recent)


def reversed_of(data):
    """Return ``data`` of a system in which controls act the other way, with half their effect."""
    return data.with_episodes([replace(episode, controls=-0.5 * episode.controls) for episode in data])


def test_intervals_grow_with_the_error_over_the_last_measured_second():
    """The factor of a recording whose model is right is little above 1, of another it is its error in usual ones."""
    model = Linear(stochastic=True).fit(recorded(1), rng=0)
    assert model.n_recent == RECENT == 20

    def factors(data, given=None):
        windows = history(data, model)
        parts = [windows.past_states, windows.past_controls]
        if given is not None:
            parts = [part[:, -given - extra :] for part, extra in zip(parts, (1, 0), strict=True)]
            parts = latest(*parts, model.n_lags + RECENT, PAIR.neutral_control)
        return model.start(*parts)[:, -1]

    own, other = recorded(2), reversed_of(recorded(2))
    assert 1.0 <= np.mean(factors(own)) < 1.3
    assert np.mean(factors(other)) > 3.0
    assert np.mean(factors(own)) < np.mean(factors(other, 5)) < np.mean(factors(other)), "a short history says less"
    windows = history(other, model)
    np.testing.assert_array_equal(model.start(windows.past_states[:, -1:], windows.past_controls[:, :0])[:, -1], 1.0)

    def covered(judged):
        drawn = judged.simulate(windows.past_states, windows.past_controls, windows.controls, samples=60, rng=3)
        return coverage(drawn[:, :, 19], windows.states[:, 19]).mean()

    narrow = model.variant()
    narrow.keep_spread(model.residual_, model.persistent_, model.horizon_scales_)
    assert narrow.n_recent == 0
    assert covered(model) > 0.7 > 0.5 > covered(narrow)


def recent_of(errors, steps):
    return RecentErrors(
        np.broadcast_to(errors, (len(errors), RECENT, 2)), np.broadcast_to(steps, (len(errors), RECENT))
    )


def test_the_usual_error_is_that_of_most_runs_and_never_falls():
    rng, steps = np.random.default_rng(0), np.arange(1, RECENT + 1)
    size = np.where(steps == 10, 0.1, steps)[:, None]
    errors = size * rng.standard_normal((4000, RECENT, 2))
    errors[::10] = 1e6  # diverged
    usual = RecentErrors.usual([recent_of(errors[:2000], steps), recent_of(errors[2000:], steps)])
    np.testing.assert_allclose(usual, 1.1 * np.where(steps == 10, 9.0, steps)[:, None] * np.ones(2), rtol=0.12)


def test_the_factor_is_the_relative_error_and_steps_without_a_measurement_are_usual():
    steps, usual = np.arange(1, RECENT + 1), np.full((RECENT, 2), 0.5)
    errors = np.array([0.1, 0.5, 1.5])[:, None, None] * np.ones((3, RECENT, 2))
    np.testing.assert_allclose(RecentErrors(errors, np.tile(steps, (3, 1))).factor(usual)[:, 0], [1.0, 1.0, 3.0])
    late = np.tile(np.maximum(steps - 10, 0), (3, 1))
    np.testing.assert_allclose(RecentErrors(errors, late).factor(usual)[:, 0], [1.0, 1.0, np.sqrt(5.0)])
    np.testing.assert_allclose(RecentErrors(errors, late).factor(0.0 * usual)[:, 0], 1.0)


def test_a_simulation_of_the_last_samples_begins_after_padding():
    model = Linear(stochastic=True, control_lags=1).fit(recorded(1, episodes=4, steps=200), rng=0)
    episode = recorded(2, episodes=1, steps=60).episodes[0]
    whole = RecentErrors.of(model, episode.states[None, 10:32], episode.controls[None, 10:31])
    np.testing.assert_array_equal(whole.steps, [np.arange(1, 21)])
    simulated = model.variant(stochastic=False).simulate(
        episode.states[10:12], episode.controls[10:11], episode.controls[11:31]
    )
    np.testing.assert_allclose(whole.errors[0], episode.states[12:32] - simulated, atol=1e-12)
    short = latest(episode.states[None, 24:32], episode.controls[None, 24:31], 21, PAIR.neutral_control)
    part = RecentErrors.of(model, *short)
    np.testing.assert_array_equal(part.steps, [[0] * 13 + [1, 2, 3, 4, 5, 6, 7]])
    simulated = model.variant(stochastic=False).simulate(episode.states[24:25], episode.controls[24:31])
    np.testing.assert_allclose(part.errors[0, 13:], episode.states[25:32] - simulated, atol=1e-12)


NO_LAGS = {"control_lags": 0, "state_lags": 0}


@pytest.mark.parametrize(
    ("family", "options"),
    [
        ("linear", {}),
        pytest.param("narx", {"terms": 6, **NO_LAGS}, marks=pytest.mark.nightly),
        pytest.param("k_neighbours", {"neighbours": 8, **NO_LAGS}, marks=pytest.mark.nightly),
    ],
)
def test_families_with_a_spread_keep_the_contract(family, options, car_data):
    results = MODEL.run(family, car_data, stochastic=True, **options)
    assert not [f"{c.rule}: {c.failure}" for c in results if c.failure]


def test_a_spread_that_was_not_learned_is_refused_and_one_that_was_is_stored(tmp_path):
    data = recorded(1, episodes=3, steps=120)
    plain = Linear().fit(data, rng=0)
    spread = Linear(stochastic=True).fit(data, rng=0)
    np.testing.assert_array_equal(plain.coefficients_, spread.coefficients_)
    with pytest.raises(NotFitted, match="was not fitted with stochastic=True"):
        plain.set_params(stochastic=True).simulate(data.episodes[0].states[0], data.episodes[0].controls, samples=5)
    save_model(spread, tmp_path / "model")
    start, controls = data.episodes[0].states[0], data.episodes[0].controls
    again = load_model(tmp_path / "model").simulate(start, controls, samples=5)
    np.testing.assert_array_equal(again, spread.simulate(start, controls, samples=5))
    assert np.ptp(again[:, -1], axis=0).min() > 0
