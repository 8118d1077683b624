"""The kernel library's predictors against plain NumPy, over random shapes and parameters."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import LANES
from sysid_evo.models.kernels import (
    added,
    command_network_predictor,
    neighbour_predictor,
    neighbours,
    network_predictor,
    polynomial_predictor,
)
from tests.fixtures.lanes import OWN_FIRST, RTOL, predictions

few = settings(max_examples=5, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


def agree(predicted, expected, precision):
    tolerance = RTOL[precision]
    np.testing.assert_allclose(predicted, expected, rtol=tolerance, atol=tolerance)


def test_networks_of_different_shapes_are_refused():
    one, two = [(np.zeros((3, 2)), np.zeros(2))], [(np.zeros((3, 1)), np.zeros(1))]
    with pytest.raises(InvalidArgument, match="equal shapes"):
        network_predictor([one, two], 2, 1)
    with pytest.raises(InvalidArgument, match=r"expected 2 \+ 2 inputs"):
        network_predictor([one], 2, 2)


@pytest.mark.parametrize("precision", OWN_FIRST)
@few
@given(
    seed=seeds,
    terms=st.integers(1, 30),
    n_carry=st.integers(1, 7),
    n_control=st.integers(0, 3),
    n_out=st.integers(1, 4),
)
def test_polynomials_are_the_sum_of_their_terms(precision, seed, terms, n_carry, n_control, n_out):
    rng = np.random.default_rng(seed)
    powers = rng.integers(0, 4, (terms, n_carry + n_control))
    coefficients = rng.normal(size=(terms, n_out)) * (rng.random((terms, n_out)) < 0.5)
    x, u = rng.uniform(-1.2, 1.2, (LANES, n_carry)), rng.uniform(-1, 1, (LANES, n_control))
    z = np.concatenate([x, u], axis=1)
    expected = np.prod(z[:, None] ** powers, axis=2) @ coefficients
    agree(predictions(polynomial_predictor(powers, coefficients, n_carry, n_control), x, u, n_out, precision),
          expected, precision)  # fmt: skip


def test_a_polynomial_of_wrong_exponents_is_refused():
    with pytest.raises(InvalidArgument, match="exponents >= 0"):
        polynomial_predictor([[1, -1]], np.ones((1, 1)), 1, 1)
    with pytest.raises(InvalidArgument, match=r"2 \+ 1 variables"):
        polynomial_predictor([[1, 1]], np.ones((1, 1)), 2, 1)


def cell_of(u, midpoints):
    cell = np.zeros(len(u), dtype=np.int64)
    for i, between in enumerate(midpoints):
        cell = cell * (len(between) + 1) + np.searchsorted(between, u[:, i])
    return cell


def some_grid(rng, n_controls):
    midpoints = [np.sort(rng.uniform(-1, 1, rng.integers(1, 4))) for _ in range(n_controls)]
    return midpoints, int(np.prod([len(m) + 1 for m in midpoints]))


def some_exact(rng, n_controls, n_in):
    """Return which controls are inputs, and how many states are the others."""
    exact = np.flatnonzero(rng.random(n_controls) < 0.5).tolist()[: n_in - 1]
    return exact, n_in - len(exact)


def sizes(names, often, *others):
    """Each is compiled for itself: one by day."""
    return pytest.mark.parametrize(names, [often, *(pytest.param(*one, marks=pytest.mark.nightly) for one in others)])


@pytest.mark.parametrize("precision", OWN_FIRST)
@sizes("n_in, hidden, n_out", (3, 7, 2), (1, 1, 1), (7, 12, 3), (4, 5, 1))
@few
@given(seed=seeds, n_controls=st.integers(1, 3))
def test_the_networks_of_the_command_in_force_answer(precision, n_in, hidden, n_out, seed, n_controls):
    rng = np.random.default_rng(seed)
    midpoints, cells = some_grid(rng, n_controls)
    (exact, n_states), commands = some_exact(rng, n_controls, n_in), max(1, cells // 2)
    serving = rng.integers(0, commands, cells)
    first, first_bias = rng.normal(size=(commands, n_out, n_in, hidden)), rng.normal(size=(commands, n_out, hidden))
    second, second_bias = rng.normal(size=(commands, n_out, hidden)) / hidden, rng.normal(size=(commands, n_out))
    predictor = command_network_predictor(first, first_bias, second, second_bias, serving, midpoints, exact, n_states)
    x, u = rng.normal(size=(LANES, n_states)), rng.uniform(-1.5, 1.5, (LANES, n_controls))
    x, u = x.astype(np.float32).astype(float), u.astype(np.float32).astype(float)
    command = serving[cell_of(u, midpoints)]
    z = np.concatenate([x, u[:, exact]], axis=1)
    units = np.tanh(np.einsum("bi,bkih->bkh", z, first[command]) + first_bias[command])
    expected = np.einsum("bkh,bkh->bk", units, second[command]) + second_bias[command]
    agree(predictions(predictor, x, u, n_out, precision), expected, precision)


@pytest.mark.parametrize("precision", OWN_FIRST)
@sizes("sides", 3, (1,), (2,), (6,))
@settings(max_examples=10, deadline=None, derandomize=True)
@given(
    seed=seeds,
    n_controls=st.integers(1, 2),
    n_out=st.integers(1, 3),
    most=st.sampled_from([1, 3, 17, 400, 3000]),
    reach=st.sampled_from([1.0, 100.0]),
)
def test_the_nearest_of_all_points_under_the_command_answers(precision, sides, seed, n_controls, n_out, most, reach):
    """Also with a single point, with far queries, with exact controls, with cells that have no points."""
    rng = np.random.default_rng(seed)
    midpoints, cells = some_grid(rng, n_controls)
    (exact, n_states), n_tables = some_exact(rng, n_controls, sides), max(1, cells // 2)
    serving = rng.integers(0, n_tables, cells)
    tables = []
    for _ in range(n_tables):
        points = rng.normal(size=(rng.integers(1, most + 1), sides)).astype(np.float32).astype(float)
        tables.append((points, rng.normal(size=(len(points), n_out))))
    x, u = reach * rng.normal(size=(LANES, n_states)), rng.uniform(-1.5, 1.5, (LANES, n_controls))
    x, u = x.astype(np.float32).astype(float), u.astype(np.float32).astype(float)
    predictor = neighbour_predictor(tables, serving, midpoints, exact, n_states)
    predicted = predictions(predictor, x, u, n_out, precision)
    query, table = np.concatenate([x, u[:, exact]], axis=1), serving[cell_of(u, midpoints)]
    for lane in range(LANES):
        points, values = tables[table[lane]]
        squares = ((points - query[lane]) ** 2).sum(axis=1)
        nearest = np.argmin(squares)
        tied = squares <= squares[nearest] * (1 + (1e-12 if precision == "float64" else 2e-6))
        assert any(np.allclose(predicted[lane], value, rtol=1e-6) for value in values[tied])


@pytest.mark.parametrize("precision", OWN_FIRST)
def test_a_point_that_was_recorded_finds_itself_among_many_equal_coordinates(precision):
    rng = np.random.default_rng(4)
    points = np.unique(rng.integers(0, 9, (2000, 3)), axis=0).astype(float)
    points = points[rng.permutation(len(points))]
    values = np.arange(len(points), dtype=float)[:, None]
    predictor = neighbour_predictor([(points, values)], np.array([0, 0]), [np.array([0.0])], [], 3)
    asked = rng.choice(len(points), LANES, replace=False)
    found = predictions(predictor, points[asked], np.zeros((LANES, 1)), 1, precision)
    np.testing.assert_array_equal(found[:, 0], asked)


@pytest.mark.parametrize("precision", OWN_FIRST)
def test_a_query_that_is_not_a_number_or_infinitely_far_still_ends(precision):
    rng = np.random.default_rng(4)
    points, values = rng.normal(size=(900, 3)), rng.normal(size=(900, 2))
    predictor = neighbour_predictor([(points, values)], np.array([0, 0]), [np.array([0.0])], [0], 2)
    x, u = rng.normal(size=(LANES, 2)), rng.uniform(-1, 1, (LANES, 1))
    x[0], x[1], x[2], u[3], u[4] = np.nan, np.inf, 1e30, np.nan, -np.inf
    found = predictions(predictor, x, u, 2, precision)
    assert np.isfinite(found).all()
    query = np.concatenate([x, u], axis=1)[5:]
    nearest = np.argmin(((points - query[:, None]) ** 2).sum(axis=2), axis=1)
    np.testing.assert_allclose(found[5:], values[nearest], rtol=1e-6)


@pytest.mark.parametrize("precision", OWN_FIRST)
def test_asking_groups_of_buckets_first_finds_the_same_point(precision, monkeypatch):
    """Also in tables of few points, in one of a single group, far away, and where a query is not a number."""
    rng = np.random.default_rng(5)
    sizes = (9000, 5, 1, 300, 4096)
    tables = [(rng.normal(size=(n, 3)).astype(np.float32).astype(float), rng.normal(size=(n, 2))) for n in sizes]
    midpoints, serving = [np.array([-0.6, -0.2, 0.2, 0.6])], np.arange(5)

    def found(x, u):
        return predictions(neighbour_predictor(tables, serving, midpoints, [0], 2), x, u, 2, precision)

    u = rng.uniform(-1.0, 1.0, (LANES, 1))
    for reach in (0.3, 3.0, 1000.0):
        x = reach * rng.normal(size=(LANES, 2))
        x[0] = np.nan if reach > 100.0 else x[0]
        monkeypatch.setattr(neighbours, "MANY", 10**9)
        plain = found(x, u)
        monkeypatch.setattr(neighbours, "MANY", 1)
        by_groups = found(x, u)
        np.testing.assert_array_equal(by_groups[1:], plain[1:])
        assert np.isfinite(by_groups).all()


def test_more_points_than_the_compiled_form_can_address_are_refused(monkeypatch):
    monkeypatch.setattr(neighbours, "EXACT_INTEGERS", 1000)
    points = np.zeros((400, 1))
    with pytest.raises(InvalidArgument, match="use fewer points"):
        neighbour_predictor([(points, np.zeros((len(points), 3)))], np.array([0, 0]), [np.array([0.0])], [], 1)


@pytest.mark.parametrize("precision", OWN_FIRST)
def test_a_sum_prepares_both_of_its_parts(precision):
    rng = np.random.default_rng(6)
    x, u = rng.uniform(-1, 1, (LANES, 3)), rng.uniform(-1, 1, (LANES, 2))
    parts = [polynomial_predictor(rng.integers(0, 3, (n, 5)), rng.normal(size=(n, 3)), 3, 2) for n in (4, 7)]
    expected = sum(predictions(part, x, u, 3, precision) for part in parts)
    agree(predictions(added(parts[0], parts[1], 3), x, u, 3, precision), expected, precision)
