"""Compiled forms of fitted regressors of scikit-learn, LightGBM and XGBoost.

They equal `predict` up to rounding in the precision of the form. Trees take the same branches for inputs of single
precision, see `tree_ensembles`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from itertools import dropwhile, takewhile
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from sklearn.compose import TransformedTargetRegressor
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Product, Sum, WhiteKernel
from sklearn.kernel_ridge import KernelRidge
from sklearn.model_selection import GridSearchCV, RandomizedSearchCV
from sklearn.multioutput import MultiOutputRegressor
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import MaxAbsScaler, MinMaxScaler, PolynomialFeatures, RobustScaler, StandardScaler
from sklearn.svm import SVR

from model_zoo.estimators import predicted
from model_zoo.tree_ensembles import Ensemble, ensemble_of
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import Precision, Predictor
from sysid_evo.models.kernels import gaussian_predictor, neighbour_predictor, network_predictor, polynomial_predictor
from sysid_evo.models.kernels.shells import SeenRow, concatenated, of_functions, scaled_outputs
from sysid_evo.models.kernels.trees import tree_predictor
from sysid_evo.types import Array

Sizes: TypeAlias = tuple[int, int]
"""Number of inputs from the carry and from the control."""


class CompiledForm(NamedTuple):
    """The predictor of an estimator, and the lowest precision that is exact enough."""

    predictor: Predictor
    precision: Precision = "float32"


def compiled_form(estimator: Any, n_carry: int, n_control: int) -> CompiledForm | None:
    """Return the compiled form of ``predict`` of a fitted ``estimator``; None if it has none.

    The columns of its input are ``n_carry`` rows of the carry, then ``n_control`` of the control. There are forms of
    decision trees, forests and boosted trees, `MLPRegressor`, linear models, kernel ridge, support vectors and Gaussian
    processes with a squared-exponential kernel, the nearest neighbour; of pipelines of scalers, polynomial features and
    one of these; of `MultiOutputRegressor`, `TransformedTargetRegressor` and a finished search around these.
    Raises `InvalidArgument` if the number of inputs is another.
    """
    found = getattr(estimator, "n_features_in_", n_carry + n_control)
    if found != n_carry + n_control:
        raise InvalidArgument(
            f"{type(estimator).__name__}: expected an estimator with {n_carry + n_control} inputs, "
            f"{n_carry} of the carry and {n_control} of the control, got one with {found}"
        )
    ensemble = _joined_ensemble(estimator)
    if ensemble is not None:
        return CompiledForm(tree_predictor(*ensemble, n_carry, n_control))
    linear = _linear(estimator, n_carry + n_control)
    if linear is not None:
        return CompiledForm(network_predictor([[linear]], n_carry, n_control))
    form = FORMS.get(type(estimator))
    return None if form is None else form(estimator, (n_carry, n_control))


def _joined_ensemble(estimator: Any) -> Ensemble | None:
    """Return the trees of ``estimator``, or of one estimator for each output."""
    if type(estimator) is not MultiOutputRegressor:
        return ensemble_of(estimator)
    parts = [ensemble_of(one) for one in estimator.estimators_]
    found = [part for part in parts if part is not None]
    if len(found) < len(parts):
        return None
    trees = [tree.at(output) for output, (own, _) in enumerate(found) for tree in own]
    return trees, np.concatenate([start for _, start in found])


def _linear(estimator: Any, n_inputs: int) -> tuple[Array, Array] | None:
    """Return coefficients (n_inputs, n_out) and intercepts (n_out,) if ``predict`` is linear in them."""
    if not hasattr(estimator, "predict"):
        return None
    try:
        coefficients = np.atleast_2d(np.asarray(estimator.coef_, dtype=np.float64)).T
        intercept = np.ravel(estimator.intercept_).astype(np.float64)
    except (AttributeError, TypeError, ValueError):  # XGBoost has the names, but no such values of trees
        return None
    if coefficients.shape[0] != n_inputs or len(intercept) not in (1, coefficients.shape[1]):
        return None
    intercept = np.broadcast_to(intercept, coefficients.shape[1])
    inputs = np.random.default_rng(0).standard_normal((n_inputs + 2, n_inputs))
    expected = inputs @ coefficients + intercept
    with np.errstate(all="ignore"):
        same = np.allclose(predicted(estimator, inputs).reshape(expected.shape), expected, rtol=1e-6, atol=1e-9)
    return (coefficients, intercept) if same else None


def _network(estimator: MLPRegressor, sizes: Sizes) -> CompiledForm | None:
    if estimator.out_activation_ != "identity":
        return None
    layers = list(zip(estimator.coefs_, estimator.intercepts_, strict=True))
    if estimator.activation == "identity":
        layers = [reduce(lambda a, b: (a[0] @ b[0], a[1] @ b[0] + b[1]), layers)]
    elif estimator.activation == "logistic":  # 1 / (1 + exp(-z)) = (1 + tanh(z / 2)) / 2
        halves = [(0.5 * weights, 0.5 * bias) for weights, bias in layers[:-1]]
        layers = [*halves, layers[-1]]
        for place, (weights, bias) in enumerate(layers[1:], 1):
            added = 0.5 * weights.sum(axis=0)
            layers[place] = 0.5 * weights, bias + added
    return CompiledForm(network_predictor([layers], *sizes, rectified=estimator.activation == "relu"))


def _gaussians(points: Array, lengths: Array, weights: Array, intercept: Array, sizes: Sizes) -> CompiledForm:
    """Return the sum of bumps of ``lengths`` (n,) with ``weights`` (points, n_out) around ``points``."""
    n, n_out = points.shape[1], weights.shape[1]
    slope = np.zeros((n, n_out))
    lengths = np.broadcast_to(lengths, (n_out, n))
    predictor = gaussian_predictor(points, lengths, weights.T, slope, np.broadcast_to(intercept, n_out), sizes[0])
    return CompiledForm(predictor, "float64")  # large weights cancel


def _kernel_ridge(estimator: KernelRidge, sizes: Sizes) -> CompiledForm | None:
    points, weights = estimator.X_fit_, estimator.dual_coef_.reshape(len(estimator.X_fit_), -1)
    if estimator.kernel == "linear":
        return CompiledForm(network_predictor([[(points.T @ weights, np.zeros(weights.shape[1]))]], *sizes))
    if estimator.kernel != "rbf":
        return None
    gamma = 1.0 / points.shape[1] if estimator.gamma is None else estimator.gamma
    return _gaussians(points, np.array(0.5 / gamma) ** 0.5, weights, np.zeros(1), sizes)


def _support_vectors(estimator: SVR, sizes: Sizes) -> CompiledForm | None:
    if estimator.kernel != "rbf":
        return None
    lengths = np.array(0.5 / estimator._gamma) ** 0.5
    return _gaussians(estimator.support_vectors_, lengths, estimator.dual_coef_.T, estimator.intercept_, sizes)


def _gaussian_process(estimator: GaussianProcessRegressor, sizes: Sizes) -> CompiledForm | None:
    squared = _squared_exponential(estimator.kernel_)
    if squared is None:
        return None
    amplitude, lengths = squared
    weights = estimator.alpha_.reshape(len(estimator.alpha_), -1) * amplitude * estimator._y_train_std
    return _gaussians(estimator.X_train_, lengths, weights, np.ravel(estimator._y_train_mean), sizes)


def _squared_exponential(kernel: Any) -> tuple[float, Array] | None:
    """Return amplitude^2 and lengths of a constant times a squared exponential, plus white noise; None for others."""
    if type(kernel) is RBF:
        return 1.0, np.asarray(kernel.length_scale)
    if type(kernel) is Sum and WhiteKernel in (type(kernel.k1), type(kernel.k2)):
        return _squared_exponential(kernel.k1 if type(kernel.k2) is WhiteKernel else kernel.k2)
    if type(kernel) is Product:
        for constant, other in ((kernel.k1, kernel.k2), (kernel.k2, kernel.k1)):
            inner = _squared_exponential(other) if type(constant) is ConstantKernel else None
            if inner is not None:
                return constant.constant_value * inner[0], inner[1]
    return None


def _neighbours(estimator: KNeighborsRegressor, sizes: Sizes) -> CompiledForm | None:
    if estimator.n_neighbors != 1 or estimator.effective_metric_ != "euclidean":
        return None
    values = np.reshape(estimator._y, (len(estimator._y), -1)).astype(np.float64)
    table, controls = (np.asarray(estimator._fit_X, dtype=np.float64), values), list(range(sizes[1]))
    return CompiledForm(neighbour_predictor([table], np.zeros(1, dtype=np.int64), [], controls, sizes[0]))


def _pipeline(estimator: Pipeline, sizes: Sizes) -> CompiledForm | None:
    steps = [step for _, step in estimator.steps[:-1] if step not in (None, "passthrough")]
    last = estimator.steps[-1][1]
    scalers = list(takewhile(lambda step: type(step) in SCALERS, steps))
    rest = list(dropwhile(lambda step: type(step) in SCALERS, steps))
    inner = _of_features(rest, last, sizes) if rest else compiled_form(last, *sizes)
    return None if inner is None else reduce(lambda form, scaler: _scaled(form, scaler, sizes), scalers[::-1], inner)


def _scaled(form: CompiledForm, scaler: Any, sizes: Sizes) -> CompiledForm:
    """Return ``form`` behind ``scaler``."""
    limits = scaler.feature_range if getattr(scaler, "clip", False) else (-np.inf, np.inf)
    return form._replace(predictor=of_scaled(form.predictor, sizes[0], *_scaling(scaler, sum(sizes)), limits))


def of_scaled(
    inner: Predictor, n_carry: int, factors: Array, offsets: Array, limits: tuple[float, float] = (-np.inf, np.inf)
) -> Predictor:
    """Return ``inner`` with the inputs factor (x - offset), those of the carry first, clipped to ``limits``."""
    rows = [
        SeenRow("", place - n_carry * (place >= n_carry), factor, offset, *limits)
        for place, (factor, offset) in enumerate(zip(factors, offsets, strict=True))
    ]
    return of_functions(inner, rows[:n_carry], rows[n_carry:])


def _of_features(rest: list[Any], last: Any, sizes: Sizes) -> CompiledForm | None:
    """Return a linear model of polynomial features, perhaps scaled."""
    first, *scalers = rest
    if type(first) is not PolynomialFeatures or any(type(scaler) not in SCALERS for scaler in scalers):
        return None
    linear = _linear(last, len(first.powers_))
    if linear is None or any(getattr(scaler, "clip", False) for scaler in scalers):
        return None
    coefficients, intercept = linear
    for scaler in reversed(scalers):
        factor, offset = _scaling(scaler, len(coefficients))
        coefficients = coefficients * factor[:, None]
        intercept = intercept - offset @ coefficients
    powers = np.concatenate([first.powers_, np.zeros((1, sum(sizes)), dtype=np.int64)])
    return CompiledForm(polynomial_predictor(powers, np.vstack([coefficients, intercept]), *sizes))


def _scaling(scaler: Any, count: int) -> tuple[Array, Array]:
    """Return factor and offset (count,): the scaler gives factor (x - offset)."""
    one, zero = np.ones(count), np.zeros(count)
    if type(scaler) is MinMaxScaler:
        return scaler.scale_, -scaler.min_ / scaler.scale_
    centre = getattr(scaler, "mean_" if type(scaler) is StandardScaler else "center_", None)
    if getattr(scaler, "with_mean", True) is False:
        centre = None
    return one / (one if scaler.scale_ is None else scaler.scale_), zero if centre is None else centre


SCALERS = (StandardScaler, MinMaxScaler, MaxAbsScaler, RobustScaler)


def _several(estimator: MultiOutputRegressor, sizes: Sizes) -> CompiledForm | None:
    forms = [compiled_form(one, *sizes) for one in estimator.estimators_]
    found = [form for form in forms if form is not None]
    if len(found) < len(forms):
        return None
    precision: Precision = "float64" if any(form.precision == "float64" for form in found) else "float32"
    return CompiledForm(reduce(concatenated, [form.predictor for form in found]), precision)


def _of_target(estimator: TransformedTargetRegressor, sizes: Sizes) -> CompiledForm | None:
    inner, scaler = compiled_form(estimator.regressor_, *sizes), estimator.transformer_
    if inner is None or type(scaler) not in SCALERS or getattr(scaler, "clip", False):
        return None
    assert inner.predictor.writes is not None
    factor, offset = _scaling(scaler, inner.predictor.writes)
    return inner._replace(predictor=scaled_outputs(inner.predictor, 1.0 / factor, offset))


def _best(estimator: Any, sizes: Sizes) -> CompiledForm | None:
    return compiled_form(estimator.best_estimator_, *sizes) if estimator.refit else None


FORMS: dict[type, Callable[[Any, Sizes], CompiledForm | None]] = {
    MLPRegressor: _network,
    KernelRidge: _kernel_ridge,
    SVR: _support_vectors,
    GaussianProcessRegressor: _gaussian_process,
    KNeighborsRegressor: _neighbours,
    Pipeline: _pipeline,
    MultiOutputRegressor: _several,
    TransformedTargetRegressor: _of_target,
    GridSearchCV: _best,
    RandomizedSearchCV: _best,
}
"""By class: a subclass may predict otherwise."""
