"""The compiled form of the parts of families: wrappers, means, spreads, angles, limits, units."""

from dataclasses import replace

import numpy as np
import pytest

from model_zoo.features import FUNCTIONS
from model_zoo.state_space.units import UNITS
from sysid_evo.data import Dataset
from sysid_evo.engine.compiled.open_loop import kernel_step
from sysid_evo.models.adaptation import selection
from sysid_evo.models.base import make_model
from sysid_evo.registry import models
from sysid_evo.testing import MODEL, example_dataset
from tests.fixtures.families import PERIODIC
from tests.fixtures.plants import Accelerated, Cylinder, cylinder, pendulum
from tests.fixtures.systems import TANK, FloorCar, cart, drive, one_output, swung

OTHER = FloorCar(thrust=1.8, turn=2.0)


def at_night(names, often):
    return [name if name in often else pytest.param(name, marks=pytest.mark.nightly) for name in names]


def expect_alike(model, carry, control, noise=None, **tolerances):
    """Raise `AssertionError` unless both forms give the same step; return the step."""
    kernel, expected = model.kernel(), model.step(carry, control, noise)
    assert kernel is not None
    compiled = kernel_step(kernel, carry, control, noise, precision="float64")
    np.testing.assert_allclose(compiled, expected, **{"rtol": 1e-6, "atol": 1e-7, **tolerances})
    return expected


def on(data, model, **tolerances):
    windows = data.windows(1, stride=max(1, data.n_steps // 150), history=model.n_lags)
    carry = model.start(windows.past_states, windows.past_controls)
    expect_alike(model, carry, windows.controls[:, 0], **tolerances)


@pytest.mark.parametrize("family", at_night(["narx", "sindy", "sindy_discrete"], ("sindy",)))
def test_states_far_from_zero_step_equally(family):
    data = cart()
    far = data.with_episodes([replace(episode, states=episode.states + 1e6) for episode in data])
    model = make_model(family, degree=2, control_lags=0, state_lags=0).fit(far, rng=0)
    assert hasattr(model, "offsets_")
    on(far, model)


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["action", "linear", "action + gains"])
def test_an_adapted_model_steps_around_a_base_with_lags(kind, monkeypatch):
    monkeypatch.setattr(selection, "KINDS", (kind,))
    base = make_model("narx", degree=2, terms=8, state_lags=1, control_lags=1)
    adapted = base.fit(drive(FloorCar(), seconds=60.0, seed=1), rng=0).adapt(drive(OTHER, seconds=30.0, seed=3))
    assert adapted.n_lags == 1
    assert adapted.chosen_.startswith(f"{kind}, ridge")
    on(drive(OTHER, seconds=6.0, seed=6), adapted, atol=1e-9)


@pytest.mark.nightly
def test_a_mean_of_a_correction_and_more_training_steps_in_one_kernel(monkeypatch):
    monkeypatch.setattr(selection, "EQUAL_SHARE", 0.0)
    small = {"members": 2, "hidden": [8], "state_lags": 0, "control_lags": 1, "one_step_updates": 200, "updates": 20}
    network = make_model("mlp_ensemble", **small, horizon=10).fit(drive(FloorCar(), seconds=60.0, seed=1), rng=0)
    between = network.adapt(drive(OTHER, seconds=20.0, seed=3, noise=0.05), rng=0)
    assert len(between.base_.members_) == 2
    on(drive(OTHER, seconds=10.0, seed=7), between, atol=1e-9)


@pytest.mark.nightly
def test_members_with_lags_of_their_own_step_as_their_mean_does(car_data):
    parts = ("linear(state_lags=1, control_lags=2)", "linear(ridge=300.0)", "linear")
    mean = make_model("auto", candidates=["linear"]).fit(car_data, rng=0)
    mean.become([make_model(part).fit(car_data, rng=0) for part in parts], np.array([0.5, 0.25, 0.25]))
    windows = example_dataset(seed=5).windows(6, stride=25, history=mean.n_lags)
    carry = mean.start(windows.past_states, windows.past_controls)
    for k in range(6):
        carry = expect_alike(mean, carry, windows.controls[:, k], rtol=1e-7, atol=1e-9)


def test_every_function_an_integral_and_a_spread_are_compiled():
    """Inside and outside the data; a carry with a spread ends with the number of steps and a factor of the noise."""
    functions = ", ".join(f"'{name}(0.7*x)'" for name in FUNCTIONS)
    library = f"custom(functions=[{functions}]) * polynomial(degree=1)"
    model = make_model(
        "sindy", library=library, threshold=0.0, ridge=1e-3, state_lags=0, control_lags=1, stochastic=True
    )
    model.fit(cart(), rng=0)
    assert {row.function for row in model.features.rows} == {"", *FUNCTIONS}
    rng = np.random.default_rng(0)
    carry, control = rng.uniform(-1.8, 1.8, (80, model.n_carry)), rng.uniform(-1.0, 1.0, (80, 1))
    carry[:, -2] = np.arange(80)
    noise = rng.standard_normal((80, model.n_noise))
    after = expect_alike(model, carry, control, noise, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(after[:, -2:], carry[:, -2:] + [1, 0])


def test_noise_is_added_before_limits_hold_a_state():
    """A tank that runs full stays full, unless the noise of a step takes more than ran over."""
    rng, runs = np.random.default_rng(0), []
    for _ in range(3):
        valve, states = np.repeat(rng.uniform(0.0, 2.0, (40, 2)), 5, axis=0), [np.array([2.0, 0.0])]
        for u in valve:
            after = states[-1] * [0.9, 0.8] + u * [0.3, 0.5] + rng.normal(scale=0.05, size=2)
            states.append(np.clip(after, [0.0, -9.0], [4.0, 9.0]))
        runs.append((np.array(states), valve))
    data = Dataset.from_arrays(TANK, *zip(*runs, strict=True))
    model = make_model("linear", state_lags=1, control_lags=1, stochastic=True).fit(data, rng=0)
    carry = np.tile(model.start(np.full((1, 2, 2), 4.0), np.full((1, 1, 2), 2.0)), (80, 1))
    carry[40:] = model.start(np.zeros((1, 2, 2)), np.zeros((1, 1, 2)))
    control, noise = np.repeat([[2.0, 1.0], [0.0, 0.0]], 40, axis=0), 5.0 * rng.standard_normal((80, 2))
    after = expect_alike(model, carry, control, noise, rtol=1e-9, atol=1e-9)
    assert 0.5 < np.mean(after[:40, 0] == 4.0) < 1.0
    assert (after[40:, :2] != 0.0).any()


@pytest.mark.parametrize("family", at_night(PERIODIC, ("nearest_neighbour",)))
def test_a_periodic_state_is_observed_equally(family):
    data = swung(1, steps=120)
    model = make_model(family, **PERIODIC[family], state_lags=1, control_lags=1).fit(data)
    steps = data.transitions(state_lags=1, control_lags=1)
    expect_alike(model, steps.carry, steps.control, rtol=1e-6, atol=1e-6)


DELAYED = {"actuator_lag": True, "command_delay": True, "substeps": 2}


@pytest.mark.parametrize(
    ("law", "data", "options"),
    [
        pytest.param(Accelerated, pendulum, DELAYED, marks=pytest.mark.nightly),  # by day single_track
        pytest.param(Cylinder, cylinder, {"residual": True, "residual_points": 12}, marks=pytest.mark.nightly),
    ],
)
def test_a_grey_box_keeps_the_contract_compiled(law, data, options, register):
    register(models, "grey_box_in_c", law)
    results = MODEL.run("grey_box_in_c", data(steps=150), starts=1, windows=30, **options)
    assert not [check for check in results if check.failure]


@pytest.mark.parametrize("family", at_night(["nonlinear_state_space", "latent_ode"], ("nonlinear_state_space",)))
def test_every_kind_of_unit_is_the_same_compiled(family):
    model = make_model(family, order=2, members=1, screening_iterations=2, iterations=2, horizon=50).fit(
        one_output(0), rng=0
    )
    model.inner_ = [4.0 * inner for inner in model.inner_]
    model.outer_ = [outer + 0.1 for outer in model.outer_]
    for kind in range(len(UNITS)):
        model.kinds_ = [np.resize([UNITS.index("sharp"), kind], len(model.kinds_[0]))]
        on(one_output(1), model, rtol=1e-7)


@pytest.mark.nightly
@pytest.mark.parametrize("family", ["nonlinear_state_space", "latent_ode"])
def test_a_linear_space_in_the_place_of_networks_is_the_same_compiled(family, monkeypatch):
    monkeypatch.setattr("model_zoo.state_space.nonlinear_state_space.REQUIRED_RATIO", 0.0)
    few = {"order": 2, "members": 2, "mixtures": 3, "screening_iterations": 3, "iterations": 2, "horizon": 100}
    model = make_model(family, **few).fit(one_output(0, 300, bend=0.03), rng=0)
    assert [len(units) for units in model.inner_] == [0]
    on(one_output(1), model, rtol=1e-9, atol=1e-9)
