"""SINDy and NARX recover known equations, and say them with units."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from model_zoo.polynomial.model import Regression, evaluate, monomials
from model_zoo.polynomial.narx import Narx
from model_zoo.polynomial.regression import Library
from model_zoo.polynomial.sindy import Sindy, SindyDiscrete
from model_zoo.scaling import root_mean_square
from sysid_evo.data import Dataset
from sysid_evo.models.base import make_model
from sysid_evo.system import Channel, System
from sysid_evo.testing import run_checks
from sysid_evo.types import Array

SYSTEM = System(
    states=(Channel("speed", "m/s"), Channel("angle", "rad")), controls=(Channel("drive", low=-1.0, high=1.0),), dt=0.01
)


def recording_of(advance: object, steps: int = 600, episodes: int = 2) -> Dataset:
    rng = np.random.default_rng(5)
    states, controls = [], []
    for _ in range(episodes):
        control = np.repeat(rng.uniform(-1.0, 1.0, (steps // 20, 1)), 20, axis=0)
        state = [rng.uniform(-0.5, 0.5, 2)]
        for u in control:
            state.append(advance(state[-1], u))  # type: ignore[operator]  # a plain function
        states.append(np.array(state))
        controls.append(control)
    return Dataset.from_arrays(SYSTEM, states, controls)


def discrete(x: Array, u: Array) -> Array:
    return np.array([0.9 * x[0] + 0.3 * u[0] - 0.1 * x[0] * x[1], 0.8 * x[1] + 0.2 * x[0] ** 2])


def continuous(x: Array, u: Array) -> Array:
    return np.array([2.0 * u[0] - 1.5 * x[0], -3.0 * x[1] + 4.0 * x[0] * u[0]])


def through_rk4(x: Array, u: Array) -> Array:
    for _ in range(4):
        h = SYSTEM.dt / 4
        k1 = continuous(x, u)
        k2 = continuous(x + h / 2 * k1, u)
        k3 = continuous(x + h / 2 * k2, u)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + continuous(x + h * k3, u))
    return x


@pytest.mark.parametrize(
    "model",
    [
        SindyDiscrete(degree=2, threshold=0.01, ridge=0.0, state_lags=0, control_lags=0),
        Narx(degree=2, terms=3, state_lags=0, control_lags=0),
    ],
)
def test_a_discrete_system_is_recovered_exactly(model: SindyDiscrete | Narx) -> None:
    model.fit(recording_of(discrete), rng=np.random.default_rng(0))
    expected = {
        (1, 0, 0): [0.9, 0.0],
        (0, 0, 1): [0.3, 0.0],
        (1, 1, 0): [-0.1, 0.0],
        (0, 1, 0): [0.0, 0.8],
        (2, 0, 0): [0.0, 0.2],
    }
    found = {
        tuple(int(p) for p in powers): row for powers, row in zip(model.exponents_, model.coefficients_, strict=True)
    }
    for powers, row in found.items():
        np.testing.assert_allclose(row, expected.get(powers, [0.0, 0.0]), atol=1e-8)
    assert set(expected) <= set(found)


def test_a_differential_equation_is_recovered() -> None:
    model = Sindy(degree=2, threshold=0.05, ridge=1e-6, state_lags=0, control_lags=0)
    model.fit(recording_of(through_rk4), rng=np.random.default_rng(0))
    expected = {(0, 0, 1): [2.0, 0.0], (1, 0, 0): [-1.5, 0.0], (0, 1, 0): [0.0, -3.0], (1, 0, 1): [0.0, 4.0]}
    found = {
        tuple(int(p) for p in powers): row for powers, row in zip(model.exponents_, model.coefficients_, strict=True)
    }
    assert set(found) == set(expected)
    for powers, row in found.items():
        np.testing.assert_allclose(row, expected[powers], atol=2e-3)


def test_equations_carry_units() -> None:
    model = Sindy(degree=2, threshold=0.05, ridge=1e-6, state_lags=0, control_lags=0)
    model.fit(recording_of(through_rk4), rng=np.random.default_rng(0))
    first, second = model.equations()
    assert first.startswith("acceleration of speed = ")
    assert "1.5 [1/s] speed" in first
    assert "2 [m/s^2] drive" in first
    assert "4 [rad/m] speed drive" in second


@pytest.mark.parametrize(
    ("family", "found"), [("sindy", "threshold"), ("sindy_discrete", "threshold"), ("narx", "terms")]
)
def test_states_far_from_zero_are_learned_as_well_as_those_near_it(family: str, found: str) -> None:
    """As coordinates of a map are; in both forms of the step."""
    data = recording_of(through_rk4)
    far = data.with_episodes([replace(e, states=e.states + 1e6) for e in data])
    settings = {"degree": 2, "control_lags": 0, "state_lags": 0, found: 0.01 if found == "threshold" else 8}
    near = make_model(family, **settings).fit(data, rng=0)
    assert -make_model(family, **settings).fit(far, rng=0).score(far) < 0.001 - 1.2 * near.score(data)
    assert not [f"{one.sentence}: {one.failure}" for one in run_checks(family, far, **settings) if one.failure]
    assert not hasattr(near, "offsets_"), "what is near zero is stored as it was before"


@pytest.mark.parametrize("settings", [{"degree": 1}, {"library": "custom(functions=[abs]) + identity"}])
def test_an_equation_far_from_zero_says_from_where_it_counts(settings: dict[str, Any]) -> None:
    """A tank that cools down to 293 K: what is printed is what is stepped, also where the library has no constant."""
    system = System((Channel("temperature", "K"),), (Channel("heater", "W", low=0.0, high=1.0),), dt=1.0)
    heater, states = np.repeat(np.random.default_rng(0).uniform(size=40), 10), [300.0]
    for u in heater:
        states.append(293.0 + 0.95 * (states[-1] - 293.0) + 0.9 * u)
    model = SindyDiscrete(threshold=0.0, ridge=0.0, control_lags=0, state_lags=0, **settings)
    model.fit(Dataset.from_arrays(system, states, heater))
    left, right = model.equations()[0].split(" = ")
    offset = float(left.removeprefix("temperature[+1] - "))
    right = re.sub(r"(\d) (?:\[[^]]*\] )?([(ha])", r"\1 * \2", re.sub(r" \[[^]]*\]", "", right))
    printed = eval(right, {"temperature": 302.0, "heater": 0.5, "abs": abs})
    (after,) = model.simulate([302.0], [0.5])[0]
    assert after == pytest.approx(293.0 + 0.95 * 9.0 + 0.45, abs=1e-6)
    assert after == pytest.approx(offset + printed, abs=1e-3)


def test_coefficients_are_those_of_pysindy() -> None:
    import pysindy

    rng = np.random.default_rng(1)
    x, u = rng.standard_normal((300, 2)), rng.standard_normal((300, 1))
    targets = np.stack([x[:, 0] * u[:, 0] - x[:, 1], 2.0 * x[:, 1] ** 2], axis=1)
    data = Regression(np.hstack([x, u]), targets, np.hstack([x, u]), x, np.zeros(2, dtype=bool))
    scale, target_scale = root_mean_square(data.regressors), root_mean_square(data.targets)
    theirs = pysindy.SINDy(
        optimizer=pysindy.STLSQ(threshold=0.02, alpha=1e-3),
        feature_library=pysindy.PolynomialLibrary(degree=2),
    )
    theirs.fit(x / scale[:2], t=1.0, x_dot=data.targets / target_scale, u=u / scale[2:])
    library = Library.of(data, monomials(3, 2))
    coefficients, exponents = library.coefficients(0.02, 1e-3), library.exponents
    assert len(library.terms) < len(x)
    rescaled = coefficients * np.prod(scale**exponents, axis=1)[:, None] / target_scale
    np.testing.assert_allclose(rescaled.T, theirs.coefficients(), atol=1e-12)
    library = np.asarray(theirs.feature_library.transform(x[:, :1].repeat(3, axis=1)))
    np.testing.assert_allclose(evaluate(x[:, :1].repeat(3, axis=1), exponents), library, atol=1e-12)


def test_monomials_are_all_and_each_once() -> None:
    found = monomials(3, 2)
    assert len(found) == 10
    assert len({tuple(row) for row in found}) == 10
    assert found.sum(axis=1).max() == 2
