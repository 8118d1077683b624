"""From a prediction to the next carry: integration, frame, lags, Runge-Kutta, lifted scalar steps."""

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sysid_evo.kernels import LANES, DynamicsKernel, ScalarStep
from sysid_evo.models.kernels import (
    Predictor,
    network_predictor,
    polynomial_predictor,
    runge_kutta_predictor,
    stepping_kernel,
    turning_frame,
)
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System
from tests.fixtures.lanes import OWN_FIRST, RTOL, predictions, step_between_guards

few = settings(max_examples=5, deadline=None, derandomize=True)


def plane(lateral="v", order="uvr"):
    names = [name for name in order if lateral is not None or name != "v"]
    body = PlanarBody(forward="u", lateral=lateral, yaw_rate="r")
    return System(tuple(Channel(n) for n in names), (Channel("a", "", -1, 1), Channel("b", "", -1, 1)), 0.05, body)


def no_motion(nx, nu=2, dt=0.05):
    return System(tuple(Channel(f"x{i}") for i in range(nx)), tuple(Channel(f"u{i}", "", -1, 1) for i in range(nu)), dt)


def agree(found, expected, precision, times=1.0):
    np.testing.assert_allclose(found, expected, rtol=RTOL[precision], atol=times * RTOL[precision])


@pytest.mark.parametrize("precision", OWN_FIRST)
@pytest.mark.parametrize("output", ["next_state", "acceleration"])
@pytest.mark.parametrize(
    "system",
    [plane(), plane(order="rvu"), plane(order="vru"), plane(lateral=None), plane(None, "ru"), no_motion(4)],
    ids=["uvr", "rvu", "vru", "ur", "ru", "no motion"],
)
@few
@given(seed=st.integers(0, 10**6), state_lags=st.integers(0, 3), control_lags=st.integers(0, 3))
def test_a_step_is_what_the_contract_of_models_says(precision, output, system, seed, state_lags, control_lags):
    rng = np.random.default_rng(seed)
    nx, nu = system.nx, system.nu
    n_carry = nx * (1 + state_lags) + nu * control_lags
    matrix, offset = rng.normal(size=(n_carry + nu, nx)) / 3.0, rng.normal(size=nx)
    carry, control = 3.0 * rng.normal(size=(LANES, n_carry)), rng.uniform(-1, 1, (LANES, nu))
    predictor = network_predictor([[(matrix, offset)]], n_carry, nu)
    kernel = stepping_kernel(predictor, system, output=output, lags=(state_lags, control_lags))
    said = np.concatenate([carry, control], axis=1) @ matrix + offset
    after = said if output == "next_state" else system.integrate(carry[:, :nx], said)
    states = np.concatenate([after, carry[:, : nx * (1 + state_lags)]], axis=1)[:, : nx * (1 + state_lags)]
    controls = np.concatenate([control, carry[:, nx * (1 + state_lags) :]], axis=1)[:, : nu * control_lags]
    stepped = step_between_guards(kernel, carry, control, precision=precision)
    agree(stepped, np.concatenate([states, controls], 1), precision)


@pytest.mark.parametrize("precision", OWN_FIRST)
@few
@given(
    seed=st.integers(0, 10**6),
    hidden=st.lists(st.integers(1, 9), max_size=3),
    members=st.integers(1, 3),
    nx=st.integers(1, 4),
    lags=st.integers(0, 2),
    nu=st.integers(0, 3),
)
def test_networks_give_their_mean(precision, seed, hidden, members, nx, lags, nu):
    rng, n_carry = np.random.default_rng(seed), nx * (1 + lags)
    sizes = [n_carry + nu, *hidden, nx]
    networks = [
        [(rng.normal(size=(a, b)) / np.sqrt(a), rng.normal(size=b)) for a, b in pairwise(sizes)] for _ in range(members)
    ]
    x, u = rng.normal(size=(LANES, n_carry)), rng.normal(size=(LANES, nu))
    outputs = []
    for layers in networks:
        z = np.concatenate([x, u], axis=1)
        for i, (weights, bias) in enumerate(layers):
            z = z @ weights + bias
            z = np.tanh(z) if i < len(layers) - 1 else z
        outputs.append(z)
    predictor = network_predictor(networks, n_carry, nu)
    kernel = stepping_kernel(predictor, no_motion(nx, nu), output="next_state", lags=(lags, 0))
    agree(step_between_guards(kernel, x, u, precision=precision)[:, :nx], np.mean(outputs, axis=0), precision)


def oscillator(system, *, n_carry=None):
    """dx/dt = v, dv/dt = -4 x + u: a polynomial."""
    rows = n_carry or 2
    powers = np.zeros((3, rows + 1), dtype=int)
    powers[0, 1] = powers[1, 0] = powers[2, -1] = 1
    coefficients = np.array([[1.0, 0.0], [0.0, -4.0], [0.0, 1.0]])
    return runge_kutta_predictor(polynomial_predictor(powers, coefficients, rows, 1), system, n_carry=n_carry)


def test_runge_kutta_is_of_fourth_order():
    """The error after 1 s of x'' = -4 x + u falls by 16 when the step is halved."""
    u, errors = np.full((LANES, 1), 0.5), []
    for steps in (3, 6, 12):
        system, x = no_motion(2, 1, dt=1.0 / steps), np.tile([1.0, 0.0], (LANES, 1))
        for _ in range(steps):
            x = predictions(oscillator(system), x, u, 2, "float32")
        errors.append(abs(x[0, 0] - (0.125 + 0.875 * math.cos(2.0))))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert ((orders > 3.7) & (orders < 4.3)).all(), orders


def test_runge_kutta_in_a_step_shifts_the_lags_it_held():
    system = no_motion(2, 1)
    kernel = stepping_kernel(oscillator(system, n_carry=5), system, output="next_state", lags=(1, 1))
    carry, u = np.random.default_rng(0).normal(size=(LANES, 5)).astype(np.float32), np.full((LANES, 1), 0.5)
    after = step_between_guards(kernel, carry, u, precision="float32")
    expected = predictions(oscillator(system), carry[:, :2], u, 2, "float32")
    np.testing.assert_allclose(after[:, :2], expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(after[:, 2:4], carry[:, :2])
    np.testing.assert_array_equal(after[:, 4], u[:, 0])


@pytest.mark.parametrize("precision", OWN_FIRST)
@pytest.mark.parametrize("neural", [False, pytest.param(True, marks=pytest.mark.nightly)])
@few
@given(
    seed=st.integers(0, 10**6),
    nx=st.integers(1, 4),
    nu=st.integers(0, 2),
    substeps=st.integers(1, 3),
    lags=st.integers(0, 3),
)
def test_runge_kutta_equals_plain_numpy_around_any_derivative(precision, neural, seed, nx, nu, substeps, lags):
    rng = np.random.default_rng(seed)
    system, n_carry = no_motion(nx, nu), nx + lags
    n_in = n_carry + nu
    if neural:
        layers = [(rng.normal(size=(n_in, 5)), rng.normal(size=5)), (rng.normal(size=(5, nx)), rng.normal(size=nx))]
        derivative = network_predictor([layers], n_carry, nu)
    else:
        powers, coefficients = rng.integers(0, 3, (8, n_in)), rng.normal(size=(8, nx))
        derivative = polynomial_predictor(powers, coefficients, n_carry, nu)
    carry, u = rng.uniform(-1, 1, (LANES, n_carry)), rng.uniform(-1, 1, (LANES, nu))

    def slope(x):
        z = np.concatenate([x, carry[:, nx:], u], axis=1)
        if neural:
            return np.tanh(z @ layers[0][0] + layers[0][1]) @ layers[1][0] + layers[1][1]
        return np.prod(z[:, None] ** powers, axis=2) @ coefficients

    x, h = carry[:, :nx], system.dt / substeps
    for _ in range(substeps):
        k1 = slope(x)
        k2 = slope(x + 0.5 * h * k1)
        k3 = slope(x + 0.5 * h * k2)
        k4 = slope(x + h * k3)
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    predictor = runge_kutta_predictor(derivative, system, substeps=substeps, n_carry=n_carry)
    agree(predictions(predictor, carry, u, nx, precision), x, precision)


def leak(x, u, p, y, scratch):
    for row in range(int(p[0])):
        for lane in range(LANES):
            y[row * LANES + lane] = u[lane] - p[1] * x[row * LANES + lane]


@pytest.mark.parametrize("precision", OWN_FIRST)
@pytest.mark.parametrize(
    "system", [plane(), plane(order="rvu"), pytest.param(plane(None, "ru"), marks=pytest.mark.nightly), no_motion(3)]
)
def test_a_turning_frame_adds_how_the_motion_turns_and_draws_back_what_is_outside(precision, system):
    """A rate of at most 0.9 either way; states between -1 and 0.5, and a fifth beyond that."""
    rng = np.random.default_rng(5)
    x, u = 2.0 * rng.normal(size=(LANES, system.nx)), rng.uniform(-1, 1, (LANES, 2))
    rate = Predictor(leak, np.array([system.nx, 0.7]), 0)
    learned, turning = u[:, :1] - 0.7 * x, system.frame_rotation(x)
    bounds = np.tile([[-1.0], [0.5], [5.0], [-0.9], [0.9]], system.nx)
    above, below = np.maximum(x - 0.5, 0.0), np.maximum(-1.0 - x, 0.0)
    total = np.clip(learned, -0.9, 0.9) + turning
    faded = total * np.clip(1.0 - 5.0 * np.where(total > 0, above, below), 0.0, 1.0)
    for limits, expected in ((None, learned + turning), (bounds, faded - (above - below) / system.dt)):
        turned = turning_frame(rate, system, bounds=limits)
        agree(predictions(turned, x, u, system.nx, precision), expected, precision, times=10.0)


def noisy_pendulum(x, u, w, p):
    angle, rate = x
    rate = rate + p[0] * (u[0] - p[1] * math.sin(angle)) + p[2] * w[1]
    return angle + p[0] * rate + 0.1 * w[0], rate


def decay(x, u, p):
    return (x[0] * 0.5 + p[0],)


@pytest.mark.parametrize("precision", OWN_FIRST)
def test_a_lifted_scalar_step_is_the_scalar_step_in_every_lane(precision):
    rng = np.random.default_rng(2)
    carry, control, noise = rng.normal(size=(LANES, 2)), rng.normal(size=(LANES, 1)), rng.normal(size=(LANES, 2))
    parameters = np.array([0.05, 9.81, 0.3])
    kernel = DynamicsKernel(ScalarStep(noisy_pendulum, n_carry=2, nu=1, n_noise=2), parameters)
    expected = [noisy_pendulum(x, u, w, parameters) for x, u, w in zip(carry, control, noise, strict=True)]
    agree(step_between_guards(kernel, carry, control, noise, precision=precision), expected, precision)
    small = DynamicsKernel(ScalarStep(decay, n_carry=1, nu=0), np.array([3.0]))
    after = step_between_guards(small, carry[:, :1], np.zeros((LANES, 0)), precision=precision)
    agree(after, carry[:, :1] * 0.5 + 3.0, precision)


def test_the_same_source_twice_is_the_same_key():
    system = no_motion(2, 1)
    kernels = [stepping_kernel(oscillator(system), system, output="next_state") for _ in range(2)]
    assert kernels[0].source == kernels[1].source
    assert hash(kernels[0].source) == hash(kernels[1].source)
    lifted = ScalarStep(decay, 1, 0)
    assert lifted == ScalarStep(decay, 1, 0)
    assert lifted != dataclasses.replace(lifted, nu=1)
