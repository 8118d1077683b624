"""Compiled forms of fitted regressors equal their `predict`."""

import numpy as np
import pytest
from sklearn.compose import TransformedTargetRegressor
from sklearn.ensemble import (
    ExtraTreesRegressor,
    GradientBoostingRegressor,
    HistGradientBoostingRegressor,
    RandomForestRegressor,
)
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, Matern, WhiteKernel
from sklearn.kernel_ridge import KernelRidge
from sklearn.linear_model import GammaRegressor, LassoCV, Ridge
from sklearn.model_selection import GridSearchCV
from sklearn.multioutput import MultiOutputRegressor
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import (
    MinMaxScaler,
    PolynomialFeatures,
    QuantileTransformer,
    RobustScaler,
    StandardScaler,
)
from sklearn.svm import SVR
from sklearn.tree import DecisionTreeRegressor

from model_zoo.compiled_forms import compiled_form
from model_zoo.tree_ensembles import ensemble_of
from sysid_evo.errors import InvalidArgument, ShapeError
from sysid_evo.kernels import LANES
from sysid_evo.models.base import make_model
from sysid_evo.models.kernels.trees import Tree, tree_predictor
from sysid_evo.testing.models import kernel_step
from tests.fixtures.lanes import predictions

N_CARRY, N_CONTROL = 3, 2


def sample(seed=0, count=400, inputs=N_CARRY + N_CONTROL):
    """Return inputs of single precision, and two outputs."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(count, inputs)).astype(np.float32).astype(float)
    y = np.stack([np.sin(2 * x[:, 0]) + x[:, 1] * x[:, 3], 3.0 + x[:, 2] ** 2 + x[:, 4]], axis=1)
    return x, y + 0.05 * rng.normal(size=y.shape)


def agree(estimator, x, tolerance, n_carry=N_CARRY):
    """The compiled form equals `predict` within a tolerance, a hundredth for those of double precision."""
    x = x[:LANES]
    predictor, precision = compiled_form(estimator, n_carry, x.shape[1] - n_carry)
    found = predictions(predictor, x[:, :n_carry], x[:, n_carry:], predictor.writes, precision)
    tolerance *= 1e-2 if precision == "float64" else 1.0
    np.testing.assert_allclose(found, np.reshape(estimator.predict(x), found.shape), rtol=tolerance, atol=tolerance)


def lightgbm(**settings):
    return pytest.importorskip("lightgbm").LGBMRegressor(n_estimators=20, verbose=-1, n_jobs=1, **settings)


def xgboost(**settings):
    return pytest.importorskip("xgboost").XGBRegressor(n_estimators=20, n_jobs=1, **settings)


def network(hidden, **settings):
    return MLPRegressor(hidden_layer_sizes=hidden, max_iter=60, random_state=0, **settings)


TREES = {
    "decision tree": lambda: DecisionTreeRegressor(random_state=0),
    "stump": lambda: DecisionTreeRegressor(max_depth=1),
    "leaf": lambda: DecisionTreeRegressor(min_samples_leaf=300),
    "forest": lambda: RandomForestRegressor(7, random_state=0),
    "forest of small trees": lambda: RandomForestRegressor(7, max_depth=5, random_state=0),
    "extra trees": lambda: ExtraTreesRegressor(5, random_state=0),
    "boosting": lambda: MultiOutputRegressor(GradientBoostingRegressor(n_estimators=20, random_state=0)),
    "deep boosting": lambda: MultiOutputRegressor(
        GradientBoostingRegressor(init="zero", n_estimators=3, max_depth=None)
    ),
    "histogram boosting": lambda: MultiOutputRegressor(HistGradientBoostingRegressor(max_iter=20)),
    "lightgbm": lambda: MultiOutputRegressor(lightgbm()),
    "xgboost": xgboost,
    "xgboost of absolute errors": lambda: MultiOutputRegressor(xgboost(objective="reg:absoluteerror")),
}

OTHERS = {
    "ridge": Ridge,
    "lasso": lambda: MultiOutputRegressor(LassoCV()),
    "network of rectified units": lambda: network((9, 6)),
    "network of logistic units": lambda: network((9, 6), activation="logistic"),
    "network of tanh units": lambda: network((9,), activation="tanh"),
    "linear network": lambda: network((9, 6), activation="identity"),
    "scaled network": lambda: TransformedTargetRegressor(
        make_pipeline(StandardScaler(), network((9, 6))), transformer=StandardScaler()
    ),
    "scaled trees": lambda: make_pipeline(RobustScaler(), Ridge()),
    "polynomial": lambda: make_pipeline(StandardScaler(), PolynomialFeatures(3), StandardScaler(), Ridge()),
    "clipped": lambda: make_pipeline(MinMaxScaler((-0.3, 0.4), clip=True), KernelRidge(kernel="rbf")),
    "kernel ridge": lambda: KernelRidge(kernel="rbf", gamma=0.3),
    "linear kernel ridge": KernelRidge,
    "support vectors": lambda: MultiOutputRegressor(make_pipeline(StandardScaler(), SVR())),
    "gaussian process": lambda: GaussianProcessRegressor(2.0 * RBF([1.0] * 5) + WhiteKernel(), normalize_y=True),
    "nearest neighbour": lambda: KNeighborsRegressor(1),
    "search": lambda: GridSearchCV(Ridge(), {"alpha": [0.1, 1.0]}),
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", TREES)
def test_trees_equal_predict_up_to_the_rounding_of_their_sum(name):
    x, y = sample()
    agree(TREES[name]().fit(x, y), x, 3e-6)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", OTHERS)
def test_other_regressors_equal_predict_up_to_rounding(name):
    x, y = sample()
    agree(OTHERS[name]().fit(x, y), x, 2e-5)


COMPARISONS = {
    "scikit-learn": lambda: RandomForestRegressor(3, random_state=0),
    "histograms": lambda: HistGradientBoostingRegressor(max_iter=5),
    "lightgbm": lightgbm,
    "xgboost": xgboost,
}


@pytest.mark.parametrize("name", COMPARISONS)
def test_trees_branch_as_predict_at_their_thresholds(name):
    """Inputs are thresholds, rounded to single precision, and their neighbours on both sides."""
    x, y = sample()
    estimator = COMPARISONS[name]().fit(x, y[:, 0])
    found, _ = ensemble_of(estimator)
    at = [np.concatenate([tree.threshold[tree.inner & (tree.feature == i)] for tree in found]) for i in range(5)]
    rng = np.random.default_rng(1)
    near = np.stack([rng.choice(one, LANES) for one in at], axis=1).astype(np.float32)
    sides = np.nextafter(near, np.float32(-np.inf)), near, np.nextafter(near, np.float32(np.inf))
    agree(estimator, np.choose(rng.integers(3, size=near.shape), sides).astype(float), 3e-6)


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_trees_of_a_model_branch_as_its_step_at_recorded_states(precision, throttle_car_data):
    """Thresholds of histograms are recorded values, to which the inputs are equal."""
    pytest.importorskip("skops")
    model = make_model("regressor(max_iter=5, state_lags=0, control_lags=0)").fit(throttle_car_data)
    run = throttle_car_data.episodes[0]
    stepped = model.step(run.states[:-1], run.controls)
    compiled = kernel_step(model.kernel(), run.states[:-1], run.controls, None, precision=precision)
    np.testing.assert_allclose(compiled, stepped, atol=1e-5)


def test_trees_of_many_inputs_find_theirs():
    x, y = sample(inputs=40)
    agree(RandomForestRegressor(3, random_state=0).fit(x, y + x[:, [17, 38]]), x, 3e-6, n_carry=30)


def counts(x):
    return (100 * np.abs(x[:, 0])).astype(int)


REFUSED = {
    "a sum that is no prediction": lambda x, y: HistGradientBoostingRegressor(loss="poisson", max_iter=3).fit(
        x, counts(x)
    ),
    "categories": lambda x, y: HistGradientBoostingRegressor(categorical_features=[0], max_iter=3).fit(
        np.column_stack([counts(x) % 7, x[:, 1:]]), counts(x) % 7
    ),
    "linear leaves": lambda x, y: lightgbm(linear_tree=True).fit(x, y[:, 0]),
    "lightgbm's averages": lambda x, y: lightgbm(boosting_type="rf", bagging_freq=1, bagging_fraction=0.5).fit(
        x, y[:, 0]
    ),
    "lightgbm's logarithms": lambda x, y: lightgbm(objective="poisson").fit(x, counts(x)),
    "lightgbm's missing zeros": lambda x, y: lightgbm(zero_as_missing=True).fit(x, y[:, 0]),
    "xgboost's logarithms": lambda x, y: xgboost(objective="count:poisson").fit(x, counts(x)),
    "trees that are dropped": lambda x, y: xgboost(booster="dart").fit(x, y[:, 0]),
    "another start": lambda x, y: GradientBoostingRegressor(n_estimators=3, init=Ridge()).fit(x, y[:, 0]),
    "a linear function inside another": lambda x, y: GammaRegressor().fit(x, 1.0 + counts(x)),
    "another kernel": lambda x, y: GaussianProcessRegressor(Matern()).fit(x, y),
    "several neighbours": lambda x, y: KNeighborsRegressor().fit(x, y),
    "one of several outputs": lambda x, y: MultiOutputRegressor(KNeighborsRegressor()).fit(x, y),
    "unknown features": lambda x, y: make_pipeline(QuantileTransformer(n_quantiles=9), Ridge()).fit(x, y),
    "a subclass": lambda x, y: type("Mine", (RandomForestRegressor,), {})(3).fit(x, y),
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_compiled_has_no_form(name):
    assert compiled_form(REFUSED[name](*sample()), N_CARRY, N_CONTROL) is None


def test_another_number_of_inputs_is_refused():
    x, y = sample()
    with pytest.raises(InvalidArgument, match="4 inputs, 2 of the carry and 2 of the control, got one with 5"):
        compiled_form(Ridge().fit(x, y), 2, 2)


def stump(**changes):
    arrays = {
        "feature": np.array([0, 0, 0]),
        "threshold": np.zeros(3),
        "left": np.array([1, -1, -1]),
        "right": np.array([2, -1, -1]),
        "values": np.array([[0.0], [1.0], [2.0]]),
    }
    return Tree(**{**arrays, **changes})


@pytest.mark.parametrize(
    "changes",
    [
        {"left": np.array([0, -1, -1])},
        {"left": np.array([7, -1, -1])},
        {"right": np.array([1, -1, -1])},
        {"right": np.array([2, -1])},
        {"feature": np.array([3, 0, 0])},
        {"threshold": np.array([np.nan, 0.0, 0.0])},
        {"values": np.array([[0.0], [np.inf], [2.0]])},
        {"values": np.zeros((3, 2))},
        {"output": 1},
    ],
)
def test_arrays_that_are_no_tree_are_refused(changes):
    with pytest.raises(ShapeError):
        tree_predictor([stump(**changes)], np.zeros(1), 2, 1)


def test_nan_goes_left():
    x = np.full((LANES, 2), np.nan)
    predicted = predictions(tree_predictor([stump()], np.ones(1), 1, 1), x[:, :1], x[:, 1:], 1, "float32")
    np.testing.assert_array_equal(predicted, 2.0)
