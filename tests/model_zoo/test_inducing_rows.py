"""Inducing points: half at random, half where least is known."""

from __future__ import annotations

import numpy as np

from model_zoo.gaussian_process import inducing_rows
from sysid_evo.types import Array


def left(inputs: Array, rows: Array, length: float) -> Array:
    """Return the variance that points at ``rows`` leave of a process of amplitude 1 everywhere."""

    def covariance(a: Array, b: Array) -> Array:
        return np.exp(-0.5 * ((a[:, None] - b[None]) ** 2).sum(axis=-1) / length**2)

    cross = covariance(inputs, inputs[rows])
    own = covariance(inputs[rows], inputs[rows]) + 1e-9 * np.eye(len(rows))
    return 1.0 - np.einsum("ij,ji->i", cross, np.linalg.solve(own, cross.T))


def test_rows_are_different_and_sorted_and_as_many_as_asked_for_or_there_are() -> None:
    inputs = np.random.default_rng(0).normal(size=(50, 2))
    rows = inducing_rows(inputs, np.ones((1, 2)), 20, np.random.default_rng(1))
    assert len(set(rows.tolist())) == 20
    assert (np.diff(rows) > 0).all()
    assert inducing_rows(inputs, np.ones((1, 2)), 80, np.random.default_rng(1)).tolist() == list(range(50))


def test_they_leave_less_unknown_than_random_ones_where_data_are_thin() -> None:
    rng = np.random.default_rng(0)
    inputs = np.concatenate([rng.normal(0.0, 0.1, (900, 2)), rng.uniform(-3.0, 3.0, (100, 2))])
    length = 1.0
    chosen = inducing_rows(inputs, np.full((2, 2), length), 40, np.random.default_rng(1))
    random = np.sort(np.random.default_rng(1).choice(len(inputs), 40, replace=False))
    assert left(inputs, chosen, length).max() < 0.25 * left(inputs, random, length).max()
    dense = (np.abs(inputs[chosen]) < 0.5).all(axis=1).sum()
    assert 14 <= dense <= 24, "half are at random, which is nine in ten among the many"


def test_each_next_row_is_the_one_of_which_least_is_known_in_all_channels() -> None:
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


def test_inputs_that_are_all_the_same_are_no_trouble() -> None:
    rows = inducing_rows(np.zeros((30, 2)), np.ones((1, 2)), 10, np.random.default_rng(0))
    assert len(set(rows.tolist())) == 10


def test_where_nothing_is_left_unknown_rounding_is_not_taken_for_it() -> None:
    """A process that hardly varies is known from few rows: the other one goes on as if it were alone."""
    inputs, lengths = np.random.default_rng(0).uniform(0.0, 1.0, (900, 2)), np.array([[2.0, 2.0], [0.02, 0.02]])
    both = inducing_rows(inputs, lengths, 800, np.random.default_rng(1))
    alone = inducing_rows(inputs, lengths[1:], 800, np.random.default_rng(1))
    assert len(np.intersect1d(both, alone)) > 790
