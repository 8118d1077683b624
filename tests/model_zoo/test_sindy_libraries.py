"""Any library and optimiser of pysindy by name: the same terms, known equations found, what cannot be named refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pysindy as ps
import pytest
from sklearn.linear_model import Lasso

from model_zoo.features import FUNCTIONS, Features
from model_zoo.polynomial.libraries import basis_of
from model_zoo.polynomial.model import evaluate
from model_zoo.scaling import root_mean_square
from sysid_evo.data import Dataset
from sysid_evo.engine import kernel_step
from sysid_evo.errors import InvalidArgument
from sysid_evo.models.base import make_model
from sysid_evo.system import Channel, System
from sysid_evo.testing import run_checks

SYSTEM = System((Channel("speed", "m/s"), Channel("turn", "rad/s")), (Channel("drive", low=-1.0, high=1.0),), dt=0.02)
NO_LAGS: dict[str, Any] = {"state_lags": 0, "control_lags": 0}


def driven(noise: float = 0.0, steps: int = 600) -> Dataset:
    """Drag in air, and a torque that is periodic in the speed; by small Euler steps."""
    rng = np.random.default_rng(2)
    drive = np.repeat(rng.uniform(-1.0, 1.0, (2, steps // 20, 1)), 20, axis=1)
    states = np.zeros((2, steps + 1, 2))
    for k in range(steps):
        x = states[:, k].copy()
        for _ in range(20):
            speed, turn = x.T
            change = [4.0 * drive[:, k, 0] - 0.8 * speed * np.abs(speed), 3.0 * np.sin(2.0 * speed) - 2.0 * turn]
            x = x + SYSTEM.dt / 20 * np.stack(change, axis=1)
        states[:, k + 1] = x
    return Dataset.from_arrays(SYSTEM, list(states + noise * rng.standard_normal(states.shape)), list(drive))


def coefficients(model: Any) -> dict[str, list[float]]:
    """Return the coefficients of each term by its name."""
    names = model.features.names
    return {
        " ".join(name for name, power in zip(names, powers, strict=True) for _ in range(power)): list(row)
        for powers, row in zip(model.exponents_, model.coefficients_, strict=True)
    }


@pytest.mark.parametrize(
    ("library", "theirs"),
    [
        ("polynomial(degree=3)", ps.PolynomialLibrary(degree=3)),
        (
            "polynomial(degree=2, include_interaction=false, include_bias=false)",
            ps.PolynomialLibrary(degree=2, include_interaction=False, include_bias=False),
        ),
        ("polynomial(degree=3, interaction_only=true)", ps.PolynomialLibrary(degree=3, interaction_only=True)),
        ("fourier(n_frequencies=2)", ps.FourierLibrary(n_frequencies=2)),
        ("fourier(include_cos=false)", ps.FourierLibrary(include_cos=False)),
        ("identity + fourier", ps.IdentityLibrary() + ps.FourierLibrary()),
        (
            "polynomial(degree=1) * fourier(n_frequencies=2)",
            ps.PolynomialLibrary(degree=1) * ps.FourierLibrary(n_frequencies=2),
        ),
    ],
)
def test_a_library_has_the_terms_of_pysindys_in_their_order(library: str, theirs: Any) -> None:
    seen = np.random.default_rng(0).uniform(-2.0, 2.0, (30, 3))
    features = Features(SYSTEM, (0, 0))
    basis = basis_of(library, features)
    inputs = Features(SYSTEM, (0, 0), basis.functions)(seen[:, :2], seen[:, 2:])
    expected = np.asarray(theirs.fit(seen).transform(seen))
    np.testing.assert_allclose(evaluate(inputs, basis.exponents), expected, atol=1e-12)


def test_functions_that_made_the_data_are_found_among_others() -> None:
    library = "identity + fourier(n_frequencies=2, inputs=[speed]) + custom(functions=['x*abs(x)', tanh])"
    model = make_model("sindy", library=library, threshold=0.05, ridge=1e-9, **NO_LAGS).fit(driven())
    found = coefficients(model)
    assert set(found) == {"drive", "(speed |speed|)", "sin(2 speed)", "turn"}
    np.testing.assert_allclose(found["(speed |speed|)"], [-0.8, 0.0], atol=0.03)
    np.testing.assert_allclose(found["sin(2 speed)"], [0.0, 3.0], atol=0.1)
    first, second = model.equations()
    assert "[1/m] (speed |speed|)" in first
    assert "[rad/s^2] sin(2 speed)" in second


def test_of_a_periodic_state_fourier_takes_the_harmonics() -> None:
    system = System((Channel("angle", "deg", period=360.0), Channel("rate", "deg/s")), (Channel("torque"),), 0.05)
    features = Features(system, (0, 0))
    basis = basis_of("fourier(n_frequencies=2)", features)
    angle = np.array([[30.0, 0.0], [390.0, 0.0]])
    values = Features(system, (0, 0), basis.functions)(angle, np.zeros((2, 1)))
    terms = evaluate(values, basis.exponents)
    np.testing.assert_allclose(terms[0], terms[1], atol=1e-12)
    assert {"sin angle", "cos angle"} <= set(features.names)
    np.testing.assert_allclose(terms[0, :2], [0.5, np.sqrt(0.75)])
    np.testing.assert_allclose(np.sort(np.abs(terms[0]))[-1], 1.0)
    assert np.isclose(terms[0], np.sin(np.pi / 3)).any()


def test_every_function_has_a_compiled_form_inside_and_outside_the_data() -> None:
    functions = ", ".join(f"'{name}(0.7*x)'" for name in FUNCTIONS)
    library = f"custom(functions=[{functions}]) * polynomial(degree=1)"
    data = driven(steps=200)
    options = {"state_lags": 0, "control_lags": 1}
    model = make_model("sindy", library=library, threshold=0.0, ridge=1e-3, **options).fit(data)
    steps = data.transitions(control_lags=1)
    assert {row.function for row in model.features.rows} == {"", *FUNCTIONS}
    carry, control = steps.carry[::7] * 1.5, steps.control[::7]
    kernel = model.kernel()
    assert kernel is not None
    compiled = kernel_step(kernel, carry, control, precision="float64")
    np.testing.assert_allclose(compiled, model.step(carry, control), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "options",
    [
        pytest.param(
            {"library": "fourier(n_frequencies=2)", "optimizer": "SR3(reg_weight_lam=0.1)"}, marks=pytest.mark.nightly
        ),
        {
            "degree": 2,
            "optimizer": "EnsembleOptimizer(opt=STLSQ(threshold=0.1), bagging=true, n_models=3)",
            "constraints": ["damping of yaw_rate <= 0"],
        },
    ],
)
def test_libraries_and_optimisers_keep_the_contract(options: dict[str, Any], switched: Dataset) -> None:
    broken = [f"{c.sentence}: {c.failure}" for c in run_checks("sindy", switched, **options, **NO_LAGS) if c.failure]
    assert not broken


@pytest.mark.parametrize(
    ("optimizer", "theirs"),
    [
        ("STLSQ(threshold=0.1)", lambda: ps.STLSQ(threshold=0.1)),
        ("sr3(reg_weight_lam=0.01)", lambda: ps.SR3(reg_weight_lam=0.01)),
        ("FROLS(max_iter=3)", lambda: ps.FROLS(max_iter=3)),
        ("SSR(max_iter=3)", lambda: ps.SSR(max_iter=3)),
        (
            "WrappedOptimizer(optimizer=Lasso(alpha=0.001))",
            lambda: ps.WrappedOptimizer(Lasso(0.001, fit_intercept=False)),
        ),
    ],
)
def test_an_optimiser_by_name_finds_what_pysindys_own_finds(optimizer: str, theirs: Callable[[], Any]) -> None:
    """From rows that were compressed, where its objective allows that."""
    data = driven()
    model = make_model("sindy_discrete", degree=2, optimizer=optimizer, **NO_LAGS).fit(data)
    library = model.library_of(model.regression(data, (0, 0)), (0, 0), 2)
    steps = data.transitions()
    seen = np.concatenate([steps.carry, steps.control], axis=1)
    terms = evaluate(seen / root_mean_square(seen), library.exponents)
    expected = theirs().fit(terms, steps.after / root_mean_square(steps.after)).coef_.T
    np.testing.assert_allclose(library.found_by(optimizer, 0) / library.unit, expected, atol=1e-5)


def test_bagging_hangs_on_the_seed_of_the_fit_alone() -> None:
    data = driven(noise=0.02)
    bagged = "EnsembleOptimizer(opt=STLSQ(threshold=0.1), bagging=true, n_models=3, ensemble_aggregator=mean)"
    first, again, other = (
        make_model("sindy", degree=1, optimizer=bagged, **NO_LAGS).fit(data, rng=seed).coefficients_
        for seed in (1, 1, 2)
        if np.random.random() >= 0.0  # noqa: NPY002  # a draw from NumPy's own generator between the fits
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"library": ps.FourierLibrary()}, "library: expected None or text"),
        ({"library": "wavelets"}, "expected one of polynomial, fourier, custom"),
        ({"library": "custom(functions=['__import__(x)'])"}, "expected functions out of abs"),
        ({"library": "fourier(n_frequencies=0)"}, "has no terms"),
        ({"library": "polynomial(order=2)"}, "has no parameter 'order'"),
        ({"library": "polynomial - fourier"}, "joined by"),
        ({"library": "fourier", "degree": 2}, "say it in the library"),
        ({"optimizer": "Adam"}, "expected one of STLSQ"),
        ({"optimizer": "TrappingSR3"}, "is of no use here"),
        ({"optimizer": "SR3", "threshold": 0.1}, "say it in the optimizer"),
    ],
)
def test_what_cannot_be_named_is_refused_where_it_is_given(options: dict[str, Any], said: str) -> None:
    with pytest.raises(InvalidArgument, match=said):
        make_model("sindy", **options)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"optimizer": "SR3(lambda_=1)"}, "has no parameter 'lambda_'"),
        ({"optimizer": "SR3(relax_coeff_nu=-1)"}, "relax_coeff_nu must be positive"),
        ({"library": "fourier(inputs=[height])"}, "expected inputs out of drive"),
        ({"constraints": ["damping of height <= 0"]}, "STATE out of speed, turn"),
        ({"constraints": ["height in speed <= 0"]}, "no such term"),
        ({"constraints": ["speed is small"]}, "expected 'TERM in STATE <= 0'"),
        ({"constraints": ["drive in speed <= 0", "drive in speed >= 1"]}, "nothing is allowed for drive in speed"),
    ],
)
def test_what_does_not_fit_the_system_is_refused_before_the_fit(options: dict[str, Any], said: str) -> None:
    with pytest.raises(InvalidArgument, match=said):
        make_model("sindy", **options).check_system(SYSTEM)


@pytest.mark.parametrize("optimizer", [None, "ConstrainedSR3(reg_weight_lam=0.01)"])
def test_constraints_hold_and_the_other_terms_make_up_for_them(optimizer: str | None) -> None:
    if optimizer:
        pytest.importorskip("cvxpy")
    said = ["damping of turn <= -2.5", "terms with drive in turn = 0", "drive in speed = 5"]
    model = make_model("sindy", library="identity", optimizer=optimizer, constraints=said, **NO_LAGS).fit(driven())
    found = coefficients(model)
    assert found["turn"][1] <= -2.5
    assert found["drive"] == [5.0, 0.0]
    assert found["speed"][1] > 0


def test_the_weak_form_sees_through_noise() -> None:
    """Differences of noisy states, divided by a short dt, drown the torque that the weak form finds."""
    library = "identity + custom(functions=['x*abs(x)', 'sin(2*x)'], inputs=[speed])"
    weak = f"WeakPDELibrary(function_library={library!r}, H_xt=0.3)"
    off = []
    for text in (library, weak):
        model = make_model("sindy", library=text, threshold=0.0, ridge=1e-6, **NO_LAGS).fit(driven(noise=0.03))
        found = coefficients(model)
        off.append(abs(found["drive"][0] - 4.0) + abs(found["sin(2 speed)"][1] - 3.0))
    assert off[1] < 0.5 * off[0]
    with pytest.raises(InvalidArgument, match="has no weak form"):
        make_model("sindy_discrete", library="WeakPDELibrary")
