"""Noise and a late state around a dynamics: what differs from trial to trial, and what not."""

from functools import cache

import numpy as np
import pytest

from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import rollout
from sysid_evo.errors import InvalidArgument, UnknownName
from sysid_evo.models import Disturbed, DomainRandomisation, state_std
from sysid_evo.models.base import make_model
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry.registry import noises
from sysid_evo.system import Channel, System
from sysid_evo.tasks import PointToPoint
from sysid_evo.testing import example_dataset
from sysid_evo.testing.examples import ExampleDynamics, pendulum
from tests.fixtures.by_hand import Climber, SluggishCar, started

DT = 0.1
LINE = System((Channel("height", "m"),), (Channel("climb", "m", -1.0, 1.0),), DT)


@cache
def linear():
    return make_model("linear", state_lags=1, control_lags=1).fit(example_dataset(), rng=0)


class SpinningBody(ExampleDynamics):
    """Its angle goes round a fifth of a turn in each step."""

    def step(self, carry, control, noise=None):
        return carry + np.array([0.4 * np.pi, 0.0])


def test_what_is_zero_changes_nothing_and_draws_nothing(rng):
    plain = SluggishCar(example_dataset().system)
    for noise in (None, DomainRandomisation()):
        same = Disturbed(plain, noise)
        assert [same.n_carry, same.n_noise, same.n_draws, same.n_lags, same.observed_at] == [
            plain.n_carry, plain.n_noise, plain.n_draws, plain.n_lags, 0
        ]  # fmt: skip
        a, b = started(plain, 4, np.random.default_rng(3)), started(same, 4, np.random.default_rng(3))
        for _ in range(10):
            control, drawn = rng.integers(-1, 2, (4, 2)).astype(float), rng.standard_normal((4, same.n_noise))
            a, b = plain.step(a, control, drawn), same.step(b, control, drawn)
            np.testing.assert_array_equal(a, b)


def test_a_gain_changes_how_soon_a_state_ends_and_not_where():
    plain, control = ExampleDynamics(LINE), np.ones((200, 1))
    noisy = Disturbed(plain, DomainRandomisation(gain=0.2))
    carry = started(noisy, 200, np.random.default_rng(0))
    factor = carry[:, 1]
    assert 0.15 < np.log(factor).std() < 0.25
    first = noisy.step(carry, control)
    np.testing.assert_allclose(first[:, 0] / factor, plain.push[0, 0])
    for _ in range(200):
        carry = noisy.step(carry, control)
    np.testing.assert_allclose(carry[:, 0], plain.push[0, 0] / 0.1, rtol=1e-4)


def test_process_noise_moves_the_state_from_none_to_all_of_it(rng):
    shaken = Disturbed(Climber(LINE), DomainRandomisation(process=0.5), spread=np.array([4.0]))
    carry, moved = started(shaken, 500, rng), []
    for _ in range(200):
        after = shaken.step(carry, np.zeros((500, 1)), rng.standard_normal((500, 1)))
        moved.append((after - carry)[:, 0])
        carry = after
    size = np.std(moved, axis=0)
    assert size.min() < 0.05
    assert 1.8 < size.max() < 2.3, "half of 4"


def test_what_is_observed_of_a_moved_state_comes_late_and_then_with_an_error():
    """The order of effects: step, gain, process noise; clipped, delayed, white noise."""
    limits = np.array([[-3.0], [3.0]])
    noise = DomainRandomisation(sensor=0.5, gain=0.5, process=0.5)
    both = Disturbed(Climber(LINE, state_bounds=limits), noise, delay=1.25 * DT, spread=np.array([2.0]))
    carry = started(both, 8, np.random.default_rng(0))
    gain, process, level = carry[:, 1], carry[:, 2], carry[:, -1]
    states, rng = [np.zeros(8)] * 3, np.random.default_rng(1)
    np.testing.assert_array_equal(observed(both, carry)[:, 0], 0.0)
    for _ in range(12):
        command, z = rng.uniform(-1.0, 1.0, 8), rng.standard_normal((8, 2))
        carry = both.step(carry, command[:, None], z)
        state = states[-1] + gain * command + process * z[:, 0]
        np.testing.assert_allclose(carry[:, 0], state, atol=1e-12)
        shown = 0.75 * states[-1] + 0.25 * states[-2]
        np.testing.assert_allclose(observed(both, carry)[:, 0], shown + level * z[:, 1], atol=1e-12)
        states = [*states, np.clip(state, *limits[:, 0])]
        carry[:, 0] = states[-1]  # as a loop clips it
    assert np.abs(states).max() == 3.0


def test_sensor_noise_is_in_standard_deviations_and_goes_from_none_to_all_of_it(rng):
    noisy = Disturbed(Climber(LINE), DomainRandomisation(sensor=0.5), spread=np.array([4.0]))
    carry, shown = started(noisy, 500, rng), []
    for _ in range(400):
        carry = noisy.step(carry, np.zeros((500, 1)), rng.standard_normal((500, 1)))
        assert (carry[:, 0] == 0.0).all(), "the state itself stays"
        shown.append(carry[:, 1])
    size = np.std(shown, axis=0)
    assert size.min() < 0.05
    assert 1.9 < size.max() < 2.2, "half of 4"
    assert 0.95 < size.mean() < 1.05


def test_the_unit_of_noise_is_the_spread_of_the_training_states_or_of_a_driven_robot():
    data = example_dataset()
    states = np.concatenate([episode.states[:-1] for episode in data.episodes])
    np.testing.assert_allclose(state_std(linear()), states.std(axis=0))
    turned = SpinningBody(pendulum())
    assert state_std(turned)[0] < 2.0, "turns that were made do not count"
    driven = state_std(SluggishCar(data.system))
    assert (driven > 0).all()
    np.testing.assert_array_equal(driven, state_std(SluggishCar(data.system)))


@pytest.mark.parametrize(
    ("made", "error", "complaint"),
    [
        (lambda: noises.make("domain_randomisation(sensor=-1)"), InvalidArgument, "sensor"),
        (lambda: noises.make("domain_randomisation(gain=true)"), InvalidArgument, "gain"),
        (lambda: noises.make("domain_randomisation(dropout=0.2)"), InvalidArgument, "dropout"),
        (lambda: noises.make("domain_randomisation(sensr=1)"), InvalidArgument, "sensor"),
        (lambda: noises.make("domain_randomisatio(sensor=1)"), UnknownName, "domain_randomisation"),
        (lambda: Disturbed(Climber(LINE), delay=-0.01), InvalidArgument, "delay"),
        (lambda: Disturbed(Climber(LINE), delay=np.nan), InvalidArgument, "delay"),
        (lambda: Disturbed(Climber(LINE), delay=np.inf), InvalidArgument, "delay"),
        (lambda: Disturbed(Disturbed(Climber(LINE), delay=0.01), delay=0.01), InvalidArgument, "already"),
    ],
)
def test_noise_and_delays_that_make_no_sense_are_refused(made, error, complaint):
    with pytest.raises(error, match=complaint):
        made()


def observed(dynamics, carry):
    return carry[:, dynamics.observed_at :][:, : dynamics.system.nx]


@pytest.mark.parametrize("samples", [0.0, 0.25, 1.0, 1.5, 2.0, 3.75])
def test_ramp_is_observed_as_much_lower_as_it_rises_within_the_delay(samples):
    late = Disturbed(Climber(LINE), delay=samples * DT)
    past = np.arange(-late.n_lags, 1.0)[None, :, None]
    carry = late.start(past, np.ones((1, late.n_lags, 1)))
    for k in range(8):
        assert carry[0, 0] == k
        assert observed(late, carry)[0, 0] == pytest.approx(k - samples)
        carry = late.step(carry, np.ones((1, 1)))


def test_dynamics_underneath_goes_on_as_without_the_wrapper(rng):
    system = example_dataset().system
    plain = SluggishCar(system)
    late = Disturbed(plain, delay=0.07)
    draws, lags = rng.standard_normal((4, plain.n_draws)), late.n_lags
    states, controls = np.zeros((4, lags + 1, system.nx)), np.zeros((4, lags, system.nu))
    a = plain.start(states[:, lags - plain.n_lags :], controls[:, lags - plain.n_lags :], draws)
    b = late.start(states, controls, draws)
    for _ in range(20):
        control, noise = rng.integers(-1, 2, (4, system.nu)).astype(float), rng.standard_normal((4, plain.n_noise))
        a, b = plain.step(a, control, noise), late.step(b, control, noise)
        np.testing.assert_array_equal(a, b[:, : plain.n_carry])


def test_pose_follows_the_true_state_and_the_controller_sees_the_late_one():
    """What moves the pose is what the wrapped dynamics did; only observations are late."""
    model = make_model("linear").fit(example_dataset(), rng=0)
    run = rollout(
        Disturbed(model, delay=0.05), RecurrentNetwork(), np.random.default_rng(1).normal(0.0, 2.0, (1, 78)),
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
        np.testing.assert_allclose(after, np.clip(stepped, *model.state_bounds))


def test_clipping_of_the_true_state_is_counted_and_never_observed_beyond_it():
    limited = Climber(LINE, state_bounds=np.array([[-2.0], [2.0]]))
    late = Disturbed(limited, delay=0.04)
    carry = late.start(np.full((1, 2, 1), 1.5), np.ones((1, 1, 1)))
    after = late.step(carry, np.ones((1, 1)))
    assert after[0, 0] == 2.5, "the loop clips and counts"
    assert observed(late, after)[0, 0] == pytest.approx(0.6 * 2.0 + 0.4 * 1.5)
