"""A state that is observed late, while the dynamics goes on underneath."""

from __future__ import annotations

import numpy as np
import pytest

from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import rollout
from sysid_evo.engine.compiled.open_loop import kernel_step
from sysid_evo.errors import InvalidArgument
from sysid_evo.models import DelayedEstimate, Dynamics
from sysid_evo.models.base import make_model
from sysid_evo.randomness import trial_seeds
from sysid_evo.system import Channel, System
from sysid_evo.tasks import PointToPoint
from sysid_evo.testing import example_dataset
from sysid_evo.types import Array
from tests.fixtures.by_hand import Climber, SluggishCar

DT = 0.1
LINE = System((Channel("height", "m"),), (Channel("climb", "m", -1.0, 1.0),), DT)
DELAYS = [0.0, 0.02, 0.05, 0.0725, 0.1, 0.16]


def observed(dynamics: Dynamics, carry: Array) -> Array:
    return carry[:, dynamics.observed_at :][:, : dynamics.system.nx]


@pytest.mark.parametrize("samples", [0.0, 0.25, 1.0, 1.5, 2.0, 3.75])
def test_ramp_is_observed_as_much_lower_as_it_rises_within_the_delay(samples: float) -> None:
    late = DelayedEstimate(Climber(LINE), samples * DT)
    past = np.arange(-late.n_lags, 1.0)[None, :, None]
    carry = late.start(past, np.ones((1, late.n_lags, 1)))
    for k in range(8):
        assert carry[0, 0] == k
        assert observed(late, carry)[0, 0] == pytest.approx(k - samples)
        carry = late.step(carry, np.ones((1, 1)))


def test_dynamics_underneath_goes_on_as_without_the_wrapper(rng: np.random.Generator) -> None:
    system = example_dataset().system
    plain = SluggishCar(system)
    late = DelayedEstimate(plain, 0.07)
    draws, lags = rng.standard_normal((4, plain.n_draws)), late.n_lags
    states, controls = np.zeros((4, lags + 1, system.nx)), np.zeros((4, lags, system.nu))
    a = plain.start(states[:, lags - plain.n_lags :], controls[:, lags - plain.n_lags :], draws)
    b = late.start(states, controls, draws)
    for _ in range(20):
        control, noise = rng.integers(-1, 2, (4, system.nu)).astype(float), rng.standard_normal((4, plain.n_noise))
        a, b = plain.step(a, control, noise), late.step(b, control, noise)
        np.testing.assert_array_equal(a, b[:, : plain.n_carry])


@pytest.mark.parametrize("engine", ["reference", "float64", "float32"])
def test_without_a_delay_every_engine_scores_as_without_the_wrapper(engine: str) -> None:
    model = make_model("linear").fit(example_dataset(), rng=np.random.default_rng(0))
    given = RecurrentNetwork(), np.random.default_rng(1).normal(0.0, 2.0, (8, 78)), PointToPoint(horizon=80)
    a, b = (rollout(d, *given, trial_seeds(0, 5), engine=engine) for d in (model, DelayedEstimate(model, 0.0)))
    np.testing.assert_array_equal(a.fitness, b.fitness)


@pytest.mark.parametrize("delay", DELAYS)
def test_compiled_form_steps_as_step_does(delay: float, rng: np.random.Generator) -> None:
    dataset = example_dataset()
    model = make_model("linear", state_lags=2, control_lags=1).fit(dataset, rng=np.random.default_rng(0))
    late = DelayedEstimate(model, delay)
    windows = dataset.windows(1, stride=7, history=late.n_lags)
    carry = late.start(windows.past_states, windows.past_controls)
    kernel = late.kernel()
    assert kernel is not None
    compiled = stepped = carry
    for _ in range(6):
        control = rng.integers(-1, 2, (len(carry), dataset.system.nu)).astype(float)
        compiled = kernel_step(kernel, compiled, control, precision="float64")
        stepped = late.step(stepped, control)
        np.testing.assert_allclose(compiled, stepped, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("delay", [0.03, 0.12])
def test_engines_agree_and_the_delay_matters(delay: float) -> None:
    model = make_model("linear").fit(example_dataset(), rng=np.random.default_rng(0))
    late = DelayedEstimate(model, delay)
    given = RecurrentNetwork(), np.random.default_rng(1).normal(0.0, 2.0, (20, 78)), PointToPoint(horizon=100)
    seeds = trial_seeds(0, 5)
    exact = rollout(late, *given, seeds, engine="reference", record=True)
    fast = rollout(late, *given, seeds, engine="float64", record=True)
    np.testing.assert_array_equal(exact.fitness, fast.fitness)
    np.testing.assert_array_equal(exact.clipped, fast.clipped)
    for a, b in zip(exact.trajectories, fast.trajectories, strict=True):
        np.testing.assert_allclose(a.states, b.states, rtol=1e-6, atol=1e-6)
    plain = rollout(model, *given, seeds, engine="reference", record=True)
    assert any(
        not np.array_equal(a.controls, b.controls) for a, b in zip(exact.trajectories, plain.trajectories, strict=True)
    )


def test_pose_follows_the_true_state_and_the_controller_sees_the_late_one() -> None:
    """What moves the pose is what the wrapped dynamics did; only observations are late."""
    model = make_model("linear").fit(example_dataset(), rng=np.random.default_rng(0))
    run = rollout(
        DelayedEstimate(model, 0.05), RecurrentNetwork(), np.random.default_rng(1).normal(0.0, 2.0, (1, 78)),
        PointToPoint(horizon=60), trial_seeds(0, 1), engine="reference", record=True,
    )  # fmt: skip
    trajectory = run.trajectories[0]
    system, pose = model.system, np.zeros(3)
    assert trajectory.pose is not None
    for k in range(60):
        before, after = trajectory.states[k], trajectory.states[k + 1]
        assert system.motion is not None
        pose = system.motion.move(pose, before, after, system.dt, system.state_names)
        np.testing.assert_allclose(trajectory.pose[k + 1], pose, atol=1e-9)
        stepped = model.step(before[None], trajectory.controls[k][None])[0]
        np.testing.assert_allclose(after, np.clip(stepped, *model.envelope))


def test_clipping_of_the_true_state_is_counted_and_never_observed_beyond_it() -> None:
    limited = Climber(LINE, envelope=np.array([[-2.0], [2.0]]))
    late = DelayedEstimate(limited, 0.04)
    carry = late.start(np.full((1, 2, 1), 1.5), np.ones((1, 1, 1)))
    after = late.step(carry, np.ones((1, 1)))
    assert after[0, 0] == 2.5, "the loop clips and counts"
    assert observed(late, after)[0, 0] == pytest.approx(0.6 * 2.0 + 0.4 * 1.5)


@pytest.mark.parametrize("delay", [-0.01, np.nan, np.inf])
def test_delay_must_be_a_time(delay: float) -> None:
    with pytest.raises(InvalidArgument, match="delay"):
        DelayedEstimate(Climber(LINE), delay)


def test_estimate_of_an_estimate_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="already"):
        DelayedEstimate(DelayedEstimate(Climber(LINE), 0.01), 0.01)
