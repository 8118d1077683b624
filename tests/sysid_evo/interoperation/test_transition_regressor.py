"""One step of a model family under scikit-learn's own tools."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer
from sklearn.utils.estimator_checks import parametrize_with_checks

from sysid_evo import Dataset, TransitionRegressor, make_model
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.system import System


def swing(steps: int = 120) -> Dataset:
    """A damped pendulum under random torque."""
    rng = np.random.default_rng(5)
    states, torque = np.zeros((steps + 1, 2)), rng.uniform(-1, 1, (steps, 1))
    for k in range(steps):
        angle, rate = states[k]
        states[k + 1] = angle + 0.1 * rate, rate + 0.1 * (5 * torque[k, 0] - 2 * np.sin(angle) - 0.2 * rate)
    return Dataset.from_arrays(System(("angle", "rate"), ("torque",), 0.1), states, torque)


DATA = swing()
X, Y = DATA.transitions().as_arrays()


@parametrize_with_checks(
    [TransitionRegressor(), TransitionRegressor("k_neighbours"), TransitionRegressor("linear", target="change")]
)
def test_it_keeps_scikit_learns_contract(estimator: Any, check: Any) -> None:
    check(estimator)


def test_rows_that_follow_each_other_are_the_recording_again() -> None:
    fitted = TransitionRegressor(make_model("linear"), system=DATA.system).fit(X, Y)
    whole = make_model("linear").set_params(state_lags=0, control_lags=0).fit(DATA)
    np.testing.assert_allclose(fitted.model_.coefficients_, whole.coefficients_, rtol=1e-6)
    np.testing.assert_allclose(fitted.predict(X), whole.step(X[:, :2], X[:, 2:]), atol=1e-9)


def test_a_family_of_free_runs_learns_from_the_runs_between_breaks() -> None:
    seen: list[list[int]] = []

    class Watching(type(make_model("linear"))):  # type: ignore[misc]  # a class that is only known at run time
        def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Any = None) -> Any:
            seen.append([len(episode) for episode in dataset])
            return super().fit(dataset, rng=rng, progress=progress)

    rows = np.r_[0:50, 60:120]
    TransitionRegressor(Watching()).fit(X[rows], Y[rows])
    TransitionRegressor(Watching(), target="change").fit(X[rows], (Y - X[:, :2])[rows])
    met = X[rows]
    met[50, 0] = Y[49, 0]  # by chance one state is where the row before ended, and the other is not
    TransitionRegressor(Watching()).fit(met, Y[rows])
    assert seen == [[50, 60], [50, 60], [50, 60]]


def test_the_change_and_the_state_are_the_same_step() -> None:
    state = TransitionRegressor("sindy", dt=0.1).fit(X, Y).predict(X)
    change = TransitionRegressor("sindy", dt=0.1, target="change").fit(X, Y - X[:, :2]).predict(X)
    np.testing.assert_allclose(state, X[:, :2] + change, atol=1e-6)
    assert np.abs(state - Y).max() < 0.1


def test_one_flat_state_is_predicted_flat() -> None:
    fitted = TransitionRegressor().fit(X[:, 1:], Y[:, 1])
    assert fitted.predict(X[:7, 1:]).shape == (7,)
    assert fitted.model_.system.control_names == ("u0",)


def test_a_grid_searches_the_parameters_of_the_family_in_a_pipeline() -> None:
    steps = make_pipeline(FunctionTransformer(), TransitionRegressor(make_model("sindy"), dt=0.1))
    grid = {"transitionregressor__model__degree": [1, 3]}
    search = GridSearchCV(steps, grid, cv=3).fit(X, Y)
    assert search.best_params_ == {"transitionregressor__model__degree": 3}
    assert clone(search.best_estimator_)[-1].model.degree == 3
    assert search.score(X, Y) > 0.99


def test_the_same_seed_is_the_same_fit() -> None:
    makers = [TransitionRegressor("neural_ode(one_step_updates=5, updates=2)", random_state=seed) for seed in (1, 1, 2)]
    first, same, other = (maker.fit(X, Y).predict(X) for maker in makers)
    np.testing.assert_array_equal(first, same)
    assert np.abs(first - other).max() > 1e-6


def test_lags_that_were_asked_for_are_refused_and_others_left_out() -> None:
    with pytest.raises(InvalidArgument, match=r"Narx\(state_lags=7\): expected no lags, as a row of X is one sample"):
        TransitionRegressor("narx(state_lags=7)").fit(X, Y)
    assert TransitionRegressor("narx").fit(X, Y).model_.n_lags == 0


def test_a_family_that_needs_more_than_one_sample_is_refused() -> None:
    with pytest.raises(
        IncompatibleSystem, match=r"LinearStateSpace looks at more than one sample \(it remembers \d+ num"
    ):
        TransitionRegressor("linear_state_space").fit(X, Y)


def test_columns_that_cannot_be_states_and_controls_are_refused() -> None:
    with pytest.raises(InvalidArgument, match=r"y: expected at most as many columns as X has \(1\), got 2"):
        TransitionRegressor().fit(X[:, :1], Y)
    with pytest.raises(
        IncompatibleSystem, match=r"2 states in y and 2 \+ 1 columns in X, as the system has, got 2 and 2"
    ):
        TransitionRegressor(system=DATA.system).fit(X[:, :2], Y)
    with pytest.raises(InvalidArgument, match="target: expected 'state' or 'change', got 'delta'"):
        TransitionRegressor(target="delta").fit(X, Y)  # type: ignore[arg-type]  # a wrong word is what is tried
