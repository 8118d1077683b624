"""The trees of fitted forests and boosted ensembles of scikit-learn, LightGBM and XGBoost, as arrays.

Thresholds are exact for inputs of single precision: scikit-learn's forests and XGBoost compare in single precision,
HistGradientBoosting, GradientBoosting and LightGBM in double. Missing values need no branch of their own, because no
simulation contains any: nan goes left. Splits by categories, linear leaves, and losses whose prediction is a function
of the sum (Poisson, gamma, Tweedie) have no compiled form.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np
from sklearn.dummy import DummyRegressor

from model_zoo.estimators import xgboost_text
from sysid_evo.models.kernels.trees import Tree
from sysid_evo.types import Array

Ensemble: TypeAlias = tuple[list[Tree], Array]
"""Trees, and the numbers (n_out,) to which their values are added."""


def ensemble_of(estimator: Any) -> Ensemble | None:
    """Return the trees of a fitted ``estimator``; None if its prediction is not the sum of their values."""
    read = READERS.get(_name(estimator))
    return None if read is None else read(estimator)


def has_trees(estimator: Any) -> bool:
    """Whether the class of ``estimator``, fitted or not, is among those that `ensemble_of` reads."""
    return _name(estimator) in READERS


def _name(estimator: Any) -> str:
    return f"{type(estimator).__module__.split('.')[0]}.{type(estimator).__name__}"


def _sklearn_tree(tree: Any, factor: float = 1.0) -> Tree:
    left, right = tree.children_left.astype(np.int64), tree.children_right.astype(np.int64)
    return Tree(tree.feature.astype(np.int64), tree.threshold, left, right, tree.value[:, :, 0] * factor)


def _single_tree(estimator: Any) -> Ensemble:
    return [_sklearn_tree(estimator.tree_)], np.zeros(estimator.n_outputs_)


def _forest(estimator: Any) -> Ensemble:
    trees = estimator.estimators_
    return [_sklearn_tree(one.tree_, 1.0 / len(trees)) for one in trees], np.zeros(estimator.n_outputs_)


def _gradient_boosting(estimator: Any) -> Ensemble | None:
    if type(estimator.init_) is DummyRegressor:
        start = np.ravel(estimator.init_.constant_)
    elif estimator.init_ == "zero":
        start = np.zeros(1)
    else:
        return None
    return [_sklearn_tree(one.tree_, estimator.learning_rate) for one in estimator.estimators_[:, 0]], start


IDENTITY_LOSSES = ("squared_error", "absolute_error", "quantile")


def _hist_gradient_boosting(estimator: Any) -> Ensemble | None:
    trees = []
    if estimator.loss not in IDENTITY_LOSSES:
        return None
    for (predictor,) in estimator._predictors:
        nodes = predictor.nodes
        if nodes["is_categorical"].any():
            return None
        leaf = nodes["is_leaf"].astype(bool)
        left, right = (np.where(leaf, -1, nodes[side].astype(np.int64)) for side in ("left", "right"))
        feature, threshold = nodes["feature_idx"].astype(np.int64), nodes["num_threshold"].astype(np.float64)
        trees.append(Tree(feature, threshold, left, right, nodes["value"][:, None].astype(np.float64)))
    return trees, np.ravel(estimator._baseline_prediction).astype(np.float64)


IDENTITY_OBJECTIVES = ("regression", "regression_l1", "huber", "fair", "quantile", "mape")


def _lightgbm(estimator: Any) -> Ensemble | None:
    booster = getattr(estimator, "booster_", estimator)
    dump, head = booster.dump_model(), booster.model_to_string(num_iteration=1)
    objective = dump.get("objective", "").split()
    if not objective or objective[0] not in IDENTITY_OBJECTIVES or "sqrt" in objective or "average_output" in head:
        return None
    trees = [_lightgbm_tree(tree["tree_structure"]) for tree in dump["tree_info"]]
    found = [tree for tree in trees if tree is not None]
    return (found, np.zeros(1)) if len(found) == len(trees) else None


def _lightgbm_tree(root: Mapping[str, Any]) -> Tree | None:
    nodes, children = [root], list[tuple[int, int]]()
    for node in nodes:  # grows while it is read
        if "leaf_coeff" in node or node.get("decision_type", "<=") != "<=" or node.get("missing_type") == "Zero":
            return None
        inner = "split_feature" in node
        children.append((len(nodes), len(nodes) + 1) if inner else (-1, -1))
        nodes += [node["left_child"], node["right_child"]] if inner else []
    left, right = np.array(children).T
    feature = np.array([node.get("split_feature", 0) for node in nodes])
    threshold = np.array([float(node.get("threshold", 0.0)) for node in nodes])
    return Tree(feature, threshold, left, right, np.array([[node.get("leaf_value", 0.0)] for node in nodes]))


IDENTITY_XGBOOST = ("reg:squarederror", "reg:absoluteerror", "reg:pseudohubererror", "reg:quantileerror")


def _xgboost(estimator: Any) -> Ensemble | None:
    booster = estimator.get_booster() if hasattr(estimator, "get_booster") else estimator
    learner = json.loads(xgboost_text(booster))["learner"]
    if learner["objective"]["name"] not in IDENTITY_XGBOOST or learner["gradient_booster"]["name"] != "gbtree":
        return None
    model, settings = learner["gradient_booster"]["model"], learner["learner_model_param"]
    base = json.loads(settings["base_score"])
    start = np.full(max(1, int(settings["num_target"])), base[0] if isinstance(base, list) and len(base) == 1 else base)
    trees = []
    for tree, output in zip(model["trees"], model["tree_info"], strict=True):
        if any(tree["split_type"]) or int(tree["tree_param"]["size_leaf_vector"]) > 1:
            return None
        number = np.array(tree["split_conditions"], dtype=np.float32)
        below = np.nextafter(number, np.float32(-np.inf)).astype(np.float64)  # left is below the threshold, not at it
        left, right, feature = (
            np.array(tree[name], dtype=np.int64) for name in ("left_children", "right_children", "split_indices")
        )
        trees.append(Tree(feature, below, left, right, number[:, None].astype(np.float64), output))
    return trees, start


READERS: Mapping[str, Callable[[Any], Ensemble | None]] = {
    "sklearn.DecisionTreeRegressor": _single_tree,
    "sklearn.ExtraTreeRegressor": _single_tree,
    "sklearn.RandomForestRegressor": _forest,
    "sklearn.ExtraTreesRegressor": _forest,
    "sklearn.GradientBoostingRegressor": _gradient_boosting,
    "sklearn.HistGradientBoostingRegressor": _hist_gradient_boosting,
    "lightgbm.Booster": _lightgbm,
    "lightgbm.LGBMRegressor": _lightgbm,
    "xgboost.Booster": _xgboost,
    "xgboost.XGBRegressor": _xgboost,
    "xgboost.XGBRFRegressor": _xgboost,
}
"""By package and name of the class; a subclass may predict otherwise."""
