"""Arrays without names, given to `fit` as pysindy takes them."""

import numpy as np
import pytest

from sysid_evo import Dataset, make_model
from sysid_evo.data.dataset import from_samples
from sysid_evo.errors import InvalidArgument, InvalidData, ShapeError

TIMES = 0.05 * np.arange(21)
X = np.stack([np.exp(-TIMES), np.cos(TIMES)], axis=1)
U = np.sin(3 * TIMES)[:, None]


def test_columns_are_numbered_and_the_step_is_that_of_the_times():
    data = from_samples(X, TIMES, U)
    assert data.system.state_names == ("x0", "x1")
    assert data.system.control_names == ("u0",)
    assert data.system.dt == pytest.approx(0.05)
    np.testing.assert_array_equal(data.episodes[0].states, X)
    np.testing.assert_array_equal(data.episodes[0].controls, U[:-1])


def test_a_fit_to_arrays_is_the_fit_to_their_data_set():
    there = make_model("linear").fit(X, t=0.05, u=U)
    here = make_model("linear").fit(Dataset.from_arrays(there.system, X, U))
    np.testing.assert_array_equal(there.coefficients_, here.coefficients_)


def test_names_may_be_given_as_to_pysindy():
    """Of the states, then of the controls; a data set has its own."""
    times = 0.05 * np.arange(81)
    x, u = np.stack([np.exp(-times), np.cos(times)], axis=1), np.sin(3 * times)
    model = make_model("narx", degree=1, terms=4, state_lags=0, control_lags=0)
    model.fit(x, t=times, u=u, feature_names=["decay", "swing", "push"])
    assert (model.system.state_names, model.system.control_names) == (("decay", "swing"), ("push",))
    decay, swing = model.equations()
    assert decay.startswith("decay[+1] = ")
    assert model.coefficients().shape == (2, len(model.exponents_))
    for row, line in zip(model.coefficients(), (decay, swing), strict=True):
        assert all(f"{abs(one):.4g}" in line for one in row if one)
    with pytest.raises(InvalidArgument, match="feature_names: expected 3 names, for x0, x1, u0, got 2"):
        from_samples(x, 0.05, u, ["decay", "swing"])
    with pytest.raises(InvalidArgument, match="a Dataset has its own"):
        model.fit(from_samples(x, 0.05, u), feature_names=["decay", "swing", "push"])


@pytest.mark.parametrize("u", [None, [U, U[:9, 0]]])
def test_a_list_holds_one_array_for_each_trajectory(u):
    data = from_samples([X, X[:9]], [TIMES, TIMES[:9]], u)
    assert [len(episode) for episode in data] == [20, 8]
    assert data.system.nu == (0 if u is None else 1)


def test_a_list_of_numbers_is_one_flat_state():
    assert from_samples([0.0, 1.0, 3.0], np.float32(0.5)).episodes[0].states.tolist() == [[0.0], [1.0], [3.0]]


def test_uneven_times_are_refused_with_the_step_that_differs():
    uneven = TIMES.copy()
    uneven[10:] += 0.02
    with pytest.raises(InvalidData, match=r"equally spaced times, got steps of 0.051 s in the mean and one of 0.07 s"):
        from_samples(X, uneven)
    nearly = TIMES + 1e-6 * np.sin(np.arange(21))
    assert from_samples(X, nearly).system.dt == pytest.approx(0.05, rel=1e-4)


def test_times_of_another_length_are_refused():
    with pytest.raises(InvalidData, match=r"one time for each sample \(21, 9\).*got 21, 8"):
        from_samples([X, X[:9]], [TIMES, TIMES[:8]])


def test_a_data_set_needs_no_times_and_controls_alone_do_not_do():
    data = from_samples(X, 0.05)
    for given in (data, [data]):
        with pytest.raises(InvalidArgument, match="expected a Dataset alone"):
            make_model("linear").fit(given, t=0.05)
    with pytest.raises(InvalidArgument, match=r"Linear\.fit: expected the time step.*fit\(x, t=0.05, u=u\)"):
        make_model("linear").fit(X, u=U)


def test_arrays_of_other_shapes_are_refused():
    with pytest.raises(ShapeError, match=r"x: expected \(samples, columns\).*got \(2, 3, 4\)"):
        from_samples(np.zeros((2, 3, 4)), 0.05)
