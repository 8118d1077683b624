"""A spread for any family: its intervals hold what they should at four horizons, in NumPy and compiled."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from model_zoo.linear import Linear
from sysid_evo.data import Dataset
from sysid_evo.engine import kernel_step
from sysid_evo.errors import NotFitted
from sysid_evo.models import load_model, save_model
from sysid_evo.models.base import make_model
from sysid_evo.system import Channel, System
from sysid_evo.testing import run_checks
from sysid_evo.types import Array
from sysid_evo.validation.intervals import HORIZONS, horizon_scales, persistent_share, segments
from sysid_evo.validation.intervals import Case as HeldOutCase
from tests.benchmarks.coverage import coverage

SYSTEM = System((Channel("x"), Channel("y")), (Channel("u", low=-1.0, high=1.0),), dt=0.05)


def recorded(seed: int, episodes: int = 10, steps: int = 400) -> Dataset:
    """A damped linear system with noise of three kinds: in every step, all along a recording, and of measurement."""
    rng = np.random.default_rng(seed)
    control = np.repeat(rng.uniform(-1.0, 1.0, (episodes, steps // 10, 1)), 10, axis=1)
    matrix, slope = np.array([[0.95, 0.05], [-0.05, 0.9]]), np.array([[0.1], [0.05]])
    states, lasting = np.zeros((episodes, steps + 1, 2)), 0.01 * rng.standard_normal((episodes, 2))
    for k in range(steps):
        white = rng.standard_normal((episodes, 2)) * [0.01, 0.005]
        states[:, k + 1] = states[:, k] @ matrix.T + control[:, k] @ slope.T + white + lasting
    measured = states + 0.02 * rng.standard_normal(states.shape)
    return Dataset.from_arrays(SYSTEM, list(measured), list(control), names=[f"{seed}-{i}" for i in range(episodes)])


def held(model: Linear, data: Dataset) -> list[Array]:
    """Return the coverage (nx,) at each horizon."""
    windows = data.windows(max(HORIZONS), stride=9, history=model.n_lags)
    drawn = model.simulate(windows.past_states, windows.past_controls, windows.controls, samples=60, rng=3)
    return [coverage(drawn[:, :, h - 1], windows.states[:, h - 1]) for h in HORIZONS]


def test_intervals_hold_nine_in_ten_at_all_four_horizons_of_recordings_never_seen() -> None:
    model = Linear(stochastic=True).fit(recorded(1), rng=0)
    found = np.array(held(model, recorded(2)))
    assert (np.abs(found.mean(axis=1) - 0.9) < 0.05).all(), found
    assert model.n_carry == 2 + 2 + 1
    growing = model.variant()
    growing.horizon_scales_ = np.tile(model.horizon_scales_[:1], (4, 1))
    assert not (np.abs(np.array(held(growing, recorded(2))).mean(axis=1) - 0.9) < 0.05).all()


def test_the_lasting_share_is_told_from_white_and_from_measurement_noise() -> None:
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

    n_lags, system, envelope = 0, SYSTEM, None

    def lagged(self, states: Array, controls: Array) -> Array:
        return states[:, -1]

    def disturbed(self, carry: Array, control: Array, disturbance: Array) -> Array:
        return carry + disturbance


def test_each_stretch_of_time_adds_what_is_missing_at_its_end() -> None:
    """A walk of step size 1 whose noise triples after ten steps."""
    rng = np.random.default_rng(1)
    size = np.where(np.arange(60) < 10, 1.0, 3.0)[:, None]
    walks = [
        np.cumsum(np.concatenate([np.zeros((1, 2)), size * rng.standard_normal((60, 2))]), axis=0) for _ in range(300)
    ]
    data = Dataset.from_arrays(SYSTEM, walks, [np.zeros((60, 1))] * 300)
    case = HeldOutCase.of(Still(), data, 60, 300)
    scales = horizon_scales([case], np.zeros(2), np.random.default_rng(0))
    np.testing.assert_allclose(scales, np.array([1.0, 1.0, 3.0, 3.0])[:, None] * np.ones(2), rtol=0.25)
    assert segments(20) == [(0, 1), (1, 10), (10, 20)]


def test_the_compiled_form_adds_the_same_noise_and_counts_the_steps() -> None:
    model = make_model("sindy_discrete", degree=1, threshold=0.01, state_lags=0, control_lags=1, stochastic=True)
    model.fit(recorded(1, episodes=4, steps=200), rng=0)
    rng = np.random.default_rng(0)
    carry = rng.standard_normal((80, model.n_carry)) * 0.3
    carry[:, -1] = np.arange(80)
    control, noise = rng.uniform(-1.0, 1.0, (80, 1)), rng.standard_normal((80, 2))
    expected = model.step(carry, control, noise)
    kernel = model.kernel()
    assert kernel is not None
    np.testing.assert_allclose(kernel_step(kernel, carry, control, noise, precision="float64"), expected, rtol=1e-9)
    np.testing.assert_array_equal(expected[:, -1], carry[:, -1] + 1)
    np.testing.assert_array_equal(expected[:, -3:-1], carry[:, -3:-1])
    moved = expected[:, :2] - model.variant(stochastic=False).step(carry[:, :-3], control)[:, :2]
    share = np.sqrt(1.0 - model.persistent_) * noise + np.sqrt(model.persistent_) * carry[:, -3:-1]
    scale = model.horizon_scales_[[0] + [1] * 9 + [2] * 10 + [3] * 60]
    np.testing.assert_allclose(moved, scale * model.residual_ * share, atol=1e-12)


@pytest.mark.parametrize(
    "family",
    ["linear", *(pytest.param(name, marks=pytest.mark.nightly) for name in ("narx", "k_neighbours"))],
)
def test_families_with_a_spread_keep_the_contract(family: str, switched: Dataset) -> None:
    options = {
        "narx": {"terms": 6, "control_lags": 1, "state_lags": 0},
        "k_neighbours": {"neighbours": 8, "control_lags": 0, "state_lags": 0},
    }.get(family, {})
    broken = [
        f"{c.sentence}: {c.failure}" for c in run_checks(family, switched, stochastic=True, **options) if c.failure
    ]
    assert not broken


def test_a_spread_that_was_not_learned_is_refused_and_one_that_was_is_stored(tmp_path: Path) -> None:
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
