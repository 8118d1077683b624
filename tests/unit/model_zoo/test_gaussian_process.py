"""The likelihood of a Gaussian process, its gradient, its maximum and its inducing points."""

import numpy as np

from model_zoo.gaussian_process import (
    GaussianProcess,
    inducing_rows,
    negative_log_likelihood,
    quadratic_form,
    squared_exponential,
)


def waves():
    """Return inputs (N, n) and targets (N,) that depend on the first input, with noise."""
    rng = np.random.default_rng(0)
    inputs = rng.standard_normal((40, 3))
    return inputs, np.sin(2.0 * inputs[:, 0]) + 0.1 * rng.standard_normal(40)


def test_the_gradient_of_the_likelihood_is_its_derivative():
    inputs, targets = waves()
    at = np.log([1.3, 0.8, 2.0, 3.0, 0.05])
    _, gradient = negative_log_likelihood(at, inputs, targets)
    for place, step in enumerate(1e-6 * np.eye(len(at))):
        ahead, back = (negative_log_likelihood(at + sign * step, inputs, targets)[0] for sign in (1.0, -1.0))
        np.testing.assert_allclose(gradient[place], (ahead - back) / 2e-6, atol=1e-6)


def test_the_squared_exponential_equals_its_formula():
    left, right = np.random.default_rng(1).standard_normal((2, 5, 3))
    apart = left[:, None] - right
    np.testing.assert_allclose(squared_exponential(left, right), np.exp(-0.5 * np.sum(apart**2, axis=2)), rtol=1e-12)


def test_a_quadratic_form_by_half_a_matrix_is_that_of_the_whole():
    rng = np.random.default_rng(2)
    rows, root = rng.standard_normal((7, 5)), rng.standard_normal((5, 5))
    matrix = root + root.T
    np.testing.assert_allclose(quadratic_form(rows, matrix), np.sum((rows @ matrix) * rows, axis=1), atol=1e-12)


def left(inputs, rows, length):
    """Return the variance that points at ``rows`` leave of a process of amplitude 1 everywhere."""

    def covariance(a, b):
        return np.exp(-0.5 * ((a[:, None] - b[None]) ** 2).sum(axis=-1) / length**2)

    cross = covariance(inputs, inputs[rows])
    own = covariance(inputs[rows], inputs[rows]) + 1e-9 * np.eye(len(rows))
    return 1.0 - np.einsum("ij,ji->i", cross, np.linalg.solve(own, cross.T))


def test_rows_are_different_and_sorted_and_as_many_as_asked_for_or_there_are():
    inputs = np.random.default_rng(0).normal(size=(50, 2))
    rows = inducing_rows(inputs, np.ones((1, 2)), 20, np.random.default_rng(1))
    assert len(set(rows.tolist())) == 20
    assert (np.diff(rows) > 0).all()
    assert inducing_rows(inputs, np.ones((1, 2)), 80, np.random.default_rng(1)).tolist() == list(range(50))


def test_inducing_points_leave_less_variance_than_random_ones_where_data_are_sparse():
    rng = np.random.default_rng(0)
    inputs = np.concatenate([rng.normal(0.0, 0.1, (900, 2)), rng.uniform(-3.0, 3.0, (100, 2))])
    length = 1.0
    chosen = inducing_rows(inputs, np.full((2, 2), length), 40, np.random.default_rng(1))
    random = np.sort(np.random.default_rng(1).choice(len(inputs), 40, replace=False))
    assert left(inputs, chosen, length).max() < 0.25 * left(inputs, random, length).max()
    dense = (np.abs(inputs[chosen]) < 0.5).all(axis=1).sum()
    assert 14 <= dense <= 24, "half are at random, which is nine in ten among the many"


def test_each_next_row_is_the_one_of_which_least_is_known_in_all_channels():
    inputs = np.linspace(0.0, 10.0, 200)[:, None]
    lengths = np.array([[1.0], [0.3]])
    rng = np.random.default_rng(3)
    pool = np.random.default_rng(3).choice(200, size=200, replace=False)
    rows = inducing_rows(inputs, lengths, 6, rng)
    begun = sorted(pool[:3].tolist())
    for _ in range(3):
        unknown = sum(left(inputs, np.array(begun), float(length[0])) for length in lengths)
        unknown[begun] = 0.0
        begun = sorted([*begun, int(np.argmax(unknown))])
    np.testing.assert_allclose(inputs[rows, 0], inputs[begun, 0], atol=0.06)


def test_inputs_that_are_all_the_same_are_no_trouble():
    rows = inducing_rows(np.zeros((30, 2)), np.ones((1, 2)), 10, np.random.default_rng(0))
    assert len(set(rows.tolist())) == 10


def test_where_nothing_is_left_unknown_rounding_is_not_taken_for_it():
    """A process that hardly varies is known from few rows: the other one goes on as if it were alone."""
    inputs, lengths = np.random.default_rng(0).uniform(0.0, 1.0, (900, 2)), np.array([[2.0, 2.0], [0.02, 0.02]])
    both = inducing_rows(inputs, lengths, 800, np.random.default_rng(1))
    alone = inducing_rows(inputs, lengths[1:], 800, np.random.default_rng(1))
    assert len(np.intersect1d(both, alone)) > 790


def test_a_gaussian_process_knows_less_far_from_its_data(car_data):
    dataset = car_data[[0]]
    model = GaussianProcess(inducing=40, state_lags=0, control_lags=0).fit(dataset, rng=0)
    known = model.predicted(dataset.episodes[0].states[:50], dataset.episodes[0].controls[:50])[1].mean(axis=0)
    unknown = model.predicted(np.full((1, 3), 30.0), np.ones((1, 2)))[1][0]
    assert (unknown > 1.5 * known).any()
    assert (unknown >= known).all()


def test_few_inducing_points_do_not_make_lengths_uncertain(car_data):
    few, more = (
        GaussianProcess(inducing=count, state_lags=0, control_lags=0).fit(car_data[[0]], rng=0) for count in (20, 60)
    )
    np.testing.assert_array_equal(few.lengths_, more.lengths_)
