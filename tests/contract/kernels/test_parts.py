"""Parts of kernels against what they compile: waypoints, networks, fits, corrections, sums of states."""

from dataclasses import replace

import numpy as np
import pytest

from sysid_evo.angles import wrap
from sysid_evo.controllers import RecurrentNetwork, View
from sysid_evo.data import Dataset
from sysid_evo.engine.compiled.open_loop import final_errors, kernel_step
from sysid_evo.evolution.model_evolution import final_error, kernel_error
from sysid_evo.kernels import ADVANCE, CONTROLLER, LANES, OBSERVE
from sysid_evo.models.adaptation.correction import CorrectionTerms
from sysid_evo.models.base import make_model
from sysid_evo.models.kernels import Predictor, stepping_kernel
from sysid_evo.models.kernels.correction import action_kernel, correction_kernel
from sysid_evo.motion import PlanarBody
from sysid_evo.randomness import trial_seeds
from sysid_evo.system import Channel, System
from sysid_evo.tasks import PointToPoint
from sysid_evo.testing.examples import ExampleDynamics, example_systems
from tests.fixtures.lanes import OWN_FIRST, RTOL, call_block, step_between_guards
from tests.fixtures.systems import CART, cart

PUSH = (Channel("a", "", -1, 1),)
PLANES = [
    System((Channel("u"), Channel("v"), Channel("r")), PUSH, 0.05, PlanarBody("u", "v", "r")),
    System((Channel("r"), Channel("u"), Channel("v")), PUSH, 0.05, PlanarBody("u", "v", "r")),
    System((Channel("r"), Channel("u")), PUSH, 0.05, PlanarBody("u", None, "r")),
]


@pytest.mark.parametrize("precision", OWN_FIRST)
@pytest.mark.parametrize("system", PLANES, ids=["uvr", "ruv", "ru"])
def test_the_waypoint_task_observes_and_advances_step_by_step(precision, system):
    rng = np.random.default_rng(3)
    task = PointToPoint(horizon=40, waypoint_radius=0.8).bind(system)
    kernel, began = task.kernel(), task.begin(trial_seeds(1, LANES))
    poses = np.stack([rng.normal(size=LANES) * size for size in (1.0, 1.0, 1e5)], axis=1)
    here = replace(began, pose=poses)
    rows, data = kernel.rows(here), kernel.trial_data(here)
    before, tolerance = rng.normal(size=(LANES, system.nx)), 100 * RTOL[precision]
    control = np.zeros((LANES, system.nu))
    for _ in range(40):
        asked = [rows, before.T, np.full((5, LANES), np.nan), kernel.parameters]
        seen = call_block(kernel.observe.function, OBSERVE, precision, asked)[2]
        off = np.abs(seen.T - task.observe(here, before))
        off[:, 3] = np.minimum(off[:, 3], 2 * np.pi - off[:, 3])
        assert off.max() < tolerance
        after = 2.0 * rng.normal(size=(LANES, system.nx))
        after[:, system.state_names.index("r")] *= 200.0  # several turns in a step
        given = [rows, before.T, after.T, control.T, np.arange(LANES), data, kernel.parameters]
        rows = call_block(kernel.advance.function, ADVANCE, precision, given, kernel.advance.bindings)[0]
        here, _ = task.advance(here, before, after, control=control)
        back = kernel.state(here, rows)
        np.testing.assert_array_equal(back.passed, here.passed)
        np.testing.assert_allclose(back.pose[:, :2], here.pose[:, :2], atol=tolerance)
        np.testing.assert_allclose(wrap(back.pose[:, 2] - here.pose[:, 2]), 0.0, atol=tolerance)
        assert (np.abs(back.pose[:, 2]) <= np.pi + 1e-6).all()
        assert (np.abs(here.pose[:, 2]) <= np.pi + 1e-6).all()
        rows, before = np.asarray(rows, dtype=float), after
        rows[2:5] = here.pose.T  # so that rounding does not add up
        rows[4] = np.remainder(rows[4] + np.pi, 2 * np.pi) - np.pi
    assert here.passed.max() >= 3


@pytest.mark.parametrize("precision", OWN_FIRST)
@pytest.mark.parametrize(
    "n_inputs, hidden, n_outputs",
    [(3, 9, 4), *(pytest.param(*one, marks=pytest.mark.nightly) for one in ((5, 6, 2), (1, 1, 1)))],
)
def test_the_recurrent_kernel_is_the_recurrent_network(precision, n_inputs, hidden, n_outputs):
    rng = np.random.default_rng(1)
    network = RecurrentNetwork(hidden=hidden).bind(n_inputs, n_outputs)
    kernel = network.kernel()
    theta = rng.normal(size=(LANES, network.n_parameters))
    memory, expected_memory = np.zeros((hidden, LANES)), np.zeros((LANES, 1, hidden))
    for _ in range(4):
        seen, raw = rng.normal(size=(LANES, n_inputs)), np.zeros((n_outputs, LANES))
        given = [theta.T, memory, seen.T, raw, kernel.parameters, np.zeros((kernel.n_scratch, LANES))]
        after = call_block(kernel.source.function, CONTROLLER, precision, given, kernel.source.bindings)
        expected, expected_memory = network.act(
            theta, expected_memory, View(seen[:, None], np.zeros((LANES, 1, 1)), None)
        )  # fmt: skip
        np.testing.assert_allclose(np.tanh(after[3].T), expected[:, 0], rtol=RTOL[precision], atol=RTOL[precision])
        memory = np.asarray(after[1], dtype=float)


@pytest.mark.parametrize("precision", OWN_FIRST)
def test_the_compiled_fit_has_the_error_of_the_plain_one(precision, car_data):
    """131 windows fill no whole number of blocks; the number of threads changes nothing."""
    family = make_model("parametrised", generations=3).fit(car_data, rng=0)
    rng = np.random.default_rng(5)
    windows = car_data.windows(10)
    windows = windows[rng.integers(len(windows), size=131)]
    population = family.parameters_ * rng.uniform(0.5, 1.5, (37, 12))
    weight = np.array([2.0, 0.5, 7.0])
    plain = final_error(family._advance, population, windows, weight=weight)
    kernel, parameters = family._kernels(population)
    found = kernel_error(kernel, parameters, windows, weight=weight, precision=precision)
    np.testing.assert_allclose(found, plain, rtol=1e-4 if precision == "float32" else 1e-9)
    given = (
        kernel.source, kernel.n_scratch, parameters, windows.start_states, windows.controls, windows.states[:, -1],
        weight,
    )  # fmt: skip
    for threads in (1, 2, 3, 99):
        np.testing.assert_array_equal(final_errors(*given, precision=precision, threads=threads), found)


def explode(x, u, p, y, scratch):
    for lane in range(LANES):
        y[lane] = p[0] * x[lane] * x[lane]


@pytest.mark.parametrize("precision", OWN_FIRST)
def test_a_candidate_that_diverges_has_the_largest_error(precision):
    system = System((Channel("x"),), (Channel("u", "", -1, 1),), 0.1)
    start, controls, truth = np.full((5, 1), 2.0), np.zeros((5, 12, 1)), np.zeros((5, 1))
    kernel = stepping_kernel(Predictor(explode, np.array([1.0]), 0), system, output="next_state")
    parameters = np.tile(kernel.parameters, (2, 1))
    parameters[1, -1] = 0.1
    error = final_errors(kernel.source, kernel.n_scratch, parameters, start, controls, truth, precision=precision)
    assert np.isfinite(error).tolist() == [False, True]


@pytest.mark.parametrize(
    "system",
    [pytest.param(system, marks=pytest.mark.nightly if at != 2 else ()) for at, system in enumerate(example_systems())],
)
def test_a_correction_corrects_as_its_terms_do(system, rng):
    model = ExampleDynamics(system)
    states, controls = rng.normal(0.0, 1.0, (81, system.nx)), rng.uniform(-1.0, 1.0, (80, system.nu))
    terms = CorrectionTerms.of(Dataset.from_arrays(system, states, controls), products=True, model=model)
    before, control, coefficients = 2.0 * states[:70], controls[:70], rng.normal(size=terms.shape)
    kernel = correction_kernel(model.kernel(), system, terms.arrays, coefficients)
    compiled, after = kernel_step(kernel, before, control, precision="float32"), model.step(before, control)
    expected = terms.corrected(before, control, after, coefficients)
    np.testing.assert_allclose(compiled, expected, rtol=1e-4, atol=1e-4)
    assert not np.allclose(compiled, after, atol=1e-2)


@pytest.mark.parametrize("delay", [0.0, 0.4])
def test_a_correction_of_the_action_steps_under_the_corrected_control(delay, rng):
    system = example_systems()[2]
    model = ExampleDynamics(system)
    before, (control, earlier) = rng.normal(size=(70, system.nx)), rng.uniform(-1.0, 1.0, (2, 70, system.nu))
    gain, offset = rng.normal(size=system.nu), rng.normal(size=system.nu)
    kernel = action_kernel(model.kernel(), gain, offset, delay, system.nx)
    expected = model.step(before, gain * ((1.0 - delay) * control + delay * earlier) + offset)
    carry = np.concatenate([before, earlier], axis=1)
    compiled = kernel_step(kernel, carry, control, precision="float32")
    np.testing.assert_allclose(compiled[:, : system.nx], expected, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(compiled[:, system.nx :], control if delay else earlier, rtol=1e-6)
    assert not np.allclose(compiled[:, : system.nx], model.step(before, control), atol=1e-2)


LIMITED = replace(CART, states=(Channel("position", "m", -1.5, 1.5), CART.states[1]))


@pytest.mark.parametrize(
    "family",
    ["narx", *(pytest.param(name, marks=pytest.mark.nightly) for name in ("sindy", "sindy_discrete", "backprop27"))],
)
def test_the_compiled_form_adds_the_change_of_a_sum_of_states_as_the_model_does(family, rng):
    """A cart with drag whose position adds up its speed, and ends at the limits of its channel."""
    options = {"epochs": 100} if family == "backprop27" else {}
    model = make_model(family, **options).fit(cart(LIMITED), rng=0)
    here, control = rng.uniform(-1.8, 1.8, (LANES, 2)), rng.uniform(-1.0, 1.0, (LANES, 1))
    carry = model.start(np.repeat(here[:, None], model.n_lags + 1, axis=1), np.zeros((LANES, model.n_lags, 1)))
    found, expected = (
        step_between_guards(model.kernel(), carry, control, precision="float32"),
        model.step(carry, control),
    )
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)
    assert np.abs(expected[:, 0]).max() == 1.5
