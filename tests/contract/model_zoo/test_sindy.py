"""SINDy and NARX: known equations with units, any library and optimiser of pysindy, a bounded continuation."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pysindy as ps
import pytest
from sklearn.linear_model import Lasso

from model_zoo.features import Features
from model_zoo.polynomial.libraries import basis_of
from model_zoo.polynomial.model import Regression, evaluate, growth, monomials
from model_zoo.polynomial.narx import Narx
from model_zoo.polynomial.optimizers import make_optimizer, run
from model_zoo.polynomial.sindy import MARGIN, Library, Sindy, SindyDiscrete, continuation_limits, continued
from model_zoo.scaling import root_mean_square
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidArgument
from sysid_evo.models.base import make_model
from sysid_evo.registry import make_robot
from sysid_evo.system import Channel, System
from sysid_evo.testing import MODEL

HEADING = System(
    states=(Channel("speed", "m/s"), Channel("angle", "rad")), controls=(Channel("drive", low=-1.0, high=1.0),), dt=0.01
)
NO_LAGS = {"state_lags": 0, "control_lags": 0}


def recording_of(advance, steps=600, episodes=2):
    rng = np.random.default_rng(5)
    states, controls = [], []
    for _ in range(episodes):
        control = np.repeat(rng.uniform(-1.0, 1.0, (steps // 20, 1)), 20, axis=0)
        state = [rng.uniform(-0.5, 0.5, 2)]
        for u in control:
            state.append(advance(state[-1], u))
        states.append(np.array(state))
        controls.append(control)
    return Dataset.from_arrays(HEADING, states, controls)


def by_powers(model):
    return {tuple(map(int, powers)): row for powers, row in zip(model.exponents_, model.coefficients_, strict=True)}


def discrete(x, u):
    return np.array([0.9 * x[0] + 0.3 * u[0] - 0.1 * x[0] * x[1], 0.8 * x[1] + 0.2 * x[0] ** 2])


def continuous(x, u):
    return np.array([2.0 * u[0] - 1.5 * x[0], -3.0 * x[1] + 4.0 * x[0] * u[0]])


def through_rk4(x, u):
    for _ in range(4):
        h = HEADING.dt / 4
        k1 = continuous(x, u)
        k2 = continuous(x + h / 2 * k1, u)
        k3 = continuous(x + h / 2 * k2, u)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + continuous(x + h * k3, u))
    return x


@pytest.mark.parametrize(
    "model",
    [
        SindyDiscrete(degree=2, threshold=0.01, ridge=0.0, **NO_LAGS),
        Narx(degree=2, terms=3, **NO_LAGS),
    ],
)
def test_a_discrete_system_is_recovered_exactly(model):
    model.fit(recording_of(discrete), rng=0)
    linear = {(1, 0, 0): [0.9, 0.0], (0, 1, 0): [0.0, 0.8], (0, 0, 1): [0.3, 0.0]}
    expected = {**linear, (1, 1, 0): [-0.1, 0.0], (2, 0, 0): [0.0, 0.2]}
    found = by_powers(model)
    for powers, row in found.items():
        np.testing.assert_allclose(row, expected.get(powers, [0.0, 0.0]), atol=1e-8)
    assert set(expected) <= set(found)


def test_a_differential_equation_is_recovered_and_printed_with_units():
    model = Sindy(degree=2, threshold=0.05, ridge=1e-6, **NO_LAGS)
    model.fit(recording_of(through_rk4), rng=0)
    expected = {(0, 0, 1): [2.0, 0.0], (1, 0, 0): [-1.5, 0.0], (0, 1, 0): [0.0, -3.0], (1, 0, 1): [0.0, 4.0]}
    found = by_powers(model)
    assert set(found) == set(expected)
    for powers, row in found.items():
        np.testing.assert_allclose(row, expected[powers], atol=2e-3)
    first, second = model.equations()
    assert first.startswith("acceleration of speed = ")
    assert "1.5 [1/s] speed" in first
    assert "2 [m/s^2] drive" in first
    assert "4 [rad/m] speed drive" in second


@pytest.mark.parametrize(
    ("family", "found"),
    [("sindy", {"threshold": 0.01}), ("sindy_discrete", {"threshold": 0.01}), ("narx", {"terms": 8})],
)
def test_states_far_from_zero_are_learned_as_well_as_those_near_it(family, found):
    """As coordinates of a map are."""
    data = recording_of(through_rk4)
    far = data.with_episodes([replace(e, states=e.states + 1e6) for e in data])
    settings = {"degree": 2, **NO_LAGS, **found}
    near = make_model(family, **settings).fit(data, rng=0)
    assert -make_model(family, **settings).fit(far, rng=0).score(far) < 0.001 - 1.2 * near.score(data)
    assert not [f"{one.rule}: {one.failure}" for one in MODEL.run(family, far, **settings) if one.failure]
    assert not hasattr(near, "offsets_"), "what is near zero is stored as it was before"


@pytest.mark.parametrize("settings", [{"degree": 1}, {"library": "custom(functions=[abs]) + identity"}])
def test_an_equation_far_from_zero_shows_its_offset(settings):
    """A tank that cools down to 293 K: what is printed is what is stepped, also where the library has no constant."""
    system = System((Channel("temperature", "K"),), (Channel("heater", "W", low=0.0, high=1.0),), dt=1.0)
    heater, states = np.repeat(np.random.default_rng(0).uniform(size=40), 10), [300.0]
    for u in heater:
        states.append(293.0 + 0.95 * (states[-1] - 293.0) + 0.9 * u)
    model = SindyDiscrete(threshold=0.0, ridge=0.0, **NO_LAGS, **settings)
    model.fit(Dataset.from_arrays(system, states, heater))
    left, right = model.equations()[0].split(" = ")
    offset = float(left.removeprefix("temperature[+1] - "))
    right = re.sub(r"(\d) (?:\[[^]]*\] )?([(ha])", r"\1 * \2", re.sub(r" \[[^]]*\]", "", right))
    printed = eval(right, {"temperature": 302.0, "heater": 0.5, "abs": abs})
    (after,) = model.simulate([302.0], [0.5])[0]
    assert after == pytest.approx(293.0 + 0.95 * 9.0 + 0.45, abs=1e-6)
    assert after == pytest.approx(offset + printed, abs=1e-3)


def test_coefficients_are_those_of_pysindy():
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


def test_monomials_are_all_and_each_once():
    found = monomials(3, 2)
    assert len(found) == 10
    assert len({tuple(row) for row in found}) == 10
    assert found.sum(axis=1).max() == 2


DRAG = System((Channel("speed", "m/s"), Channel("turn", "rad/s")), (Channel("drive", low=-1.0, high=1.0),), dt=0.02)


@cache
def dragged(noise=0.0, steps=600):
    """Drag in air, and a torque that is periodic in the speed; by small Euler steps."""
    rng = np.random.default_rng(2)
    drive = np.repeat(rng.uniform(-1.0, 1.0, (2, steps // 20, 1)), 20, axis=1)
    states = np.zeros((2, steps + 1, 2))
    for k in range(steps):
        x = states[:, k].copy()
        for _ in range(20):
            speed, turn = x.T
            change = [4.0 * drive[:, k, 0] - 0.8 * speed * np.abs(speed), 3.0 * np.sin(2.0 * speed) - 2.0 * turn]
            x = x + DRAG.dt / 20 * np.stack(change, axis=1)
        states[:, k + 1] = x
    return Dataset.from_arrays(DRAG, list(states + noise * rng.standard_normal(states.shape)), list(drive))


def by_term(model):
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
def test_a_library_has_the_terms_of_pysindys_in_their_order(library, theirs):
    seen = np.random.default_rng(0).uniform(-2.0, 2.0, (30, 3))
    features = Features(DRAG, (0, 0))
    basis = basis_of(library, features)
    inputs = Features(DRAG, (0, 0), basis.functions)(seen[:, :2], seen[:, 2:])
    expected = np.asarray(theirs.fit(seen).transform(seen))
    np.testing.assert_allclose(evaluate(inputs, basis.exponents), expected, atol=1e-12)


def test_functions_that_made_the_data_are_found_among_others():
    library = "identity + fourier(n_frequencies=2, inputs=[speed]) + custom(functions=['x*abs(x)', tanh])"
    model = make_model("sindy", library=library, threshold=0.05, ridge=1e-9, **NO_LAGS).fit(dragged())
    found = by_term(model)
    assert set(found) == {"drive", "(speed |speed|)", "sin(2 speed)", "turn"}
    np.testing.assert_allclose(found["(speed |speed|)"], [-0.8, 0.0], atol=0.03)
    np.testing.assert_allclose(found["sin(2 speed)"], [0.0, 3.0], atol=0.1)
    first, second = model.equations()
    assert "[1/m] (speed |speed|)" in first
    assert "[rad/s^2] sin(2 speed)" in second


def test_of_a_periodic_state_fourier_takes_the_harmonics():
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


@pytest.mark.parametrize(
    "options",
    [
        pytest.param(
            {"library": "fourier(n_frequencies=2)", "optimizer": "SR3(reg_weight_lam=0.1)"}, marks=pytest.mark.nightly
        ),
        {"degree": 2, "optimizer": "EnsembleOptimizer(opt=STLSQ(threshold=0.1), bagging=true, n_models=3)"},
    ],
)
def test_libraries_and_optimisers_keep_the_contract(options, car_data):
    broken = [f"{c.rule}: {c.failure}" for c in MODEL.run("sindy", car_data, **options, **NO_LAGS) if c.failure]
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
def test_an_optimiser_by_name_finds_what_pysindys_own_finds(optimizer, theirs):
    """From rows that were compressed, where its objective allows that."""
    data = dragged()
    model = make_model("sindy_discrete", degree=2, optimizer=optimizer, **NO_LAGS).fit(data)
    library = model.library_of(model.regression(data, (0, 0)), (0, 0), 2)
    steps = data.transitions()
    seen = np.concatenate([steps.carry, steps.control], axis=1)
    terms = evaluate(seen / root_mean_square(seen), library.exponents)
    expected = theirs().fit(terms, steps.after / root_mean_square(steps.after)).coef_.T
    np.testing.assert_allclose(run(make_optimizer(optimizer), library.terms, library.targets, 0), expected, atol=1e-5)


def test_bagging_depends_only_on_the_seed_of_the_fit():
    data = dragged(noise=0.02)
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
        ({"library": "fourier", "degree": 2}, "give it in the library"),
        ({"optimizer": "Adam"}, "expected one of STLSQ"),
        ({"optimizer": "TrappingSR3"}, "is not supported"),
        ({"optimizer": "SR3", "threshold": 0.1}, "give it in the optimizer"),
    ],
)
def test_what_cannot_be_named_is_refused_where_it_is_given(options, said):
    with pytest.raises(InvalidArgument, match=said):
        make_model("sindy", **options)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"optimizer": "SR3(lambda_=1)"}, "has no parameter 'lambda_'"),
        ({"optimizer": "SR3(relax_coeff_nu=-1)"}, "relax_coeff_nu must be positive"),
        ({"library": "fourier(inputs=[height])"}, "expected inputs out of drive"),
    ],
)
def test_what_does_not_fit_the_system_is_refused_before_the_fit(options, said):
    with pytest.raises(InvalidArgument, match=said):
        make_model("sindy", **options).check_system(DRAG)


def test_the_weak_form_sees_through_noise():
    """Differences of noisy states, divided by a short dt, drown the torque that the weak form finds."""
    library = "identity + custom(functions=['x*abs(x)', 'sin(2*x)'], inputs=[speed])"
    weak = f"WeakPDELibrary(function_library={library!r}, H_xt=0.3)"
    off = []
    for text in (library, weak):
        model = make_model("sindy", library=text, threshold=0.0, ridge=1e-6, **NO_LAGS).fit(dragged(noise=0.03))
        found = by_term(model)
        off.append(abs(found["drive"][0] - 4.0) + abs(found["sin(2 speed)"][1] - 3.0))
    assert off[1] < 0.5 * off[0]
    with pytest.raises(InvalidArgument, match="has no weak form"):
        make_model("sindy_discrete", library="WeakPDELibrary")


PLAIN = System((Channel("x"), Channel("y")), (Channel("u", low=-1.0, high=1.0),), dt=0.05)


def moved(matrix, episodes=20, steps=30):
    """Short runs of x' = (I + dt A) x + dt u from rest."""
    rng = np.random.default_rng(0)
    control = np.repeat(rng.uniform(-1.0, 1.0, (episodes, steps // 10, 1)), 10, axis=1)
    states = np.zeros((episodes, steps + 1, 2))
    for k in range(steps):
        states[:, k + 1] = states[:, k] + PLAIN.dt * (states[:, k] @ matrix.T + control[:, k])
    return Dataset.from_arrays(PLAIN, list(states), list(control))


def test_beyond_the_margin_every_state_returns_whatever_the_polynomial_is():
    rng = np.random.default_rng(1)
    states, rates = rng.uniform(-1.0, 1.0, (50, 3)), rng.uniform(-5.0, 5.0, (50, 3))
    bounds = continuation_limits(states, rates, np.array([False, False, True]))
    low, high = states.min(axis=0), states.max(axis=0)
    beyond = np.where(
        rng.random((200, 3)) < 0.5, high + 1.01 * MARGIN * (high - low), low - 1.01 * MARGIN * (high - low)
    )
    pushed = continued(1e3 * rng.standard_normal((200, 3)), rng.standard_normal((200, 3)), beyond, bounds, 0.05)
    assert (pushed[:, :2] * np.sign(beyond[:, :2]) < 0).all()
    assert (np.sign(pushed[:, 2]) != -np.sign(beyond[:, 2])).any()  # a position runs on


def test_inside_the_data_the_continuation_changes_nothing():
    rng = np.random.default_rng(1)
    states, rates, turning = (rng.uniform(-1.0, 1.0, (50, 2)) for _ in range(3))
    bounds = continuation_limits(states, rates, np.array([False, False]))
    np.testing.assert_array_equal(continued(rates, turning, states, bounds, 0.05), rates + turning)


@pytest.mark.parametrize(
    ("car", "duration"), [(2, 60.0), *(pytest.param(n, 360.0, marks=pytest.mark.nightly) for n in range(5))]
)
def test_the_simulation_of_a_cubic_equation_of_a_car_does_not_diverge_in_a_whole_trial(car, duration):
    robot = make_robot(f"emulated_car:{car}" if car else "emulated_car")
    data = robot.record(seed=0, duration=duration).dataset
    model = make_model("sindy", degree=3, threshold=0.01, control_lags=0).fit(data)
    rng = np.random.default_rng(0)
    start = model.training_sample_[rng.integers(len(model.training_sample_), size=100)][:, :3]
    commands = model.system.actuate(rng.uniform(-1.0, 1.0, (100 * 50, 2))).reshape(100, 50, 2)
    runs = model.simulate(start[:, None], None, np.repeat(commands, 10, axis=1))
    low, high = model.state_bounds_
    assert ((runs > low) & (runs < high)).all()
    assert model.stability.escaped == 0.0


def test_growth_is_that_of_the_equation_also_with_lags():
    """Eigenvalues -2 and -3 of a linear equation, found from steps of its carry."""
    matrix = np.array([[-2.0, 1.0], [0.0, -3.0]])
    data = moved(matrix)
    for lags in (0, 1):
        model = make_model("sindy_discrete", degree=1, threshold=1e-6, ridge=0.0, state_lags=lags, control_lags=lags)
        rate = growth(model.fit(data), np.zeros((1, 2)), np.zeros((1, 1)))
        np.testing.assert_allclose(rate, np.log(1.0 - 2.0 * PLAIN.dt) / PLAIN.dt, rtol=1e-3)
        assert model.stability.sentence == ""
        assert model.fit_note == ""


def test_an_equation_that_is_unstable_at_rest_is_reported():
    model = make_model("sindy_discrete", degree=1, threshold=1e-3, **NO_LAGS)
    model.fit(moved(np.array([[2.0, 0.0], [0.0, -3.0]])))
    assert "small disturbances at rest grow by" in model.fit_note
