"""Regressors of scikit-learn, LightGBM and XGBoost: by class name, fitted to several outputs, as bytes in files.

Nothing is unpickled. skops makes objects of the types that a file names only if these are trusted: those that it trusts
itself, and `TRUSTED`, which the regressors of scikit-learn need in addition. The nodes of trees are checked before they
are used. Boosters are stored in the text format of their package.
"""

from __future__ import annotations

import inspect
import io
import json
import re
import warnings
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Literal, TypeAlias

import numpy as np

from sysid_evo.errors import ArtefactError, InvalidArgument, UnknownName, UnknownParameter, did_you_mean
from sysid_evo.extras import missing_extra
from sysid_evo.models import bases_of
from sysid_evo.registry.plugins import PREFIX, named_in_plugin
from sysid_evo.types import Array

MODULES = (
    "ensemble", "linear_model", "neural_network", "neighbors", "svm", "tree", "kernel_ridge", "gaussian_process",
    "cross_decomposition", "dummy", "isotonic", "compose", "multioutput",
)  # fmt: skip
"""Modules of scikit-learn with regressors; ``sklearn.utils.all_estimators`` finds the same, but imports everything."""
BOOSTERS = {"LGBMRegressor": "lightgbm", "XGBRegressor": "xgboost", "XGBRFRegressor": "xgboost"}
"""Regressors of other packages, which are stored in the text format of their package."""
SKOPS = "skops.io"
Format: TypeAlias = Literal["skops", "lightgbm", "xgboost"]
KERNELS = (
    "CompoundKernel", "ConstantKernel", "DotProduct", "ExpSineSquared", "Exponentiation", "Matern", "PairwiseKernel",
    "Product", "RBF", "RationalQuadratic", "Sum", "WhiteKernel",
)  # fmt: skip
LOSSES = (
    "AbsoluteError", "HalfGammaLoss", "HalfPoissonLoss", "HalfSquaredError", "HalfTweedieLoss",
    "HalfTweedieLossIdentity", "HuberLoss", "PinballLoss",
)  # fmt: skip
TRUSTED = frozenset({
    "sklearn.utils._bunch.Bunch",
    "sklearn.feature_selection._mutual_info.mutual_info_regression",
    "sklearn.feature_selection._univariate_selection.f_regression",
    "sklearn.tree._tree.Tree",
    "sklearn.ensemble._hist_gradient_boosting.predictor.TreePredictor",
    "sklearn.neural_network._stochastic_optimizers.AdamOptimizer",
    "sklearn.neural_network._stochastic_optimizers.SGDOptimizer",
    *(f"sklearn.gaussian_process.kernels.{name}" for name in KERNELS),
    *(f"sklearn._loss.loss.{name}" for name in LOSSES),
})  # fmt: skip
"""Types of scikit-learn that skops does not trust by itself. Trees are checked, the others compute in NumPy."""
INSTEAD = {
    "sklearn.neighbors._kd_tree.KDTree": "algorithm='brute'",
    "sklearn.neighbors._ball_tree.BallTree": "algorithm='brute'",
    "sklearn.model_selection._split.KFold": "GridSearchCV(make_pipeline(...), ...), the search around the pipeline,",
}
"""Settings that avoid a type that is not trusted."""
OWN = "A regressor of your own is a class in a plugin file: --plugin FILE, in Python load_plugin"


def estimator_class(name: str) -> Any:
    """Return the regressor called ``name``, of these packages or of a loaded plugin file.

    Raises `UnknownName`, or `MissingExtra` without its package.
    """
    if name in BOOSTERS:
        if find_spec(BOOSTERS[name]) is None:
            raise missing_extra(name, BOOSTERS[name])
        return getattr(import_module(BOOSTERS[name]), name)
    for module in MODULES:
        found = _regressors(module).get(name)
        if found is not None:
            return found
    with suppress(InvalidArgument):
        return named_in_plugin(name, type)
    known = sorted({*BOOSTERS, *(regressor for module in MODULES for regressor in _regressors(module))})
    raise UnknownName(
        f"no regressor of scikit-learn, LightGBM or XGBoost is called {name!r}.{did_you_mean(name, known)} "
        f"Known: {', '.join(known)}. {OWN}"
    )


@cache
def _regressors(module: str) -> dict[str, Any]:
    from sklearn.base import RegressorMixin

    found = vars(import_module(f"sklearn.{module}"))
    return {name: one for name, one in found.items() if isinstance(one, type) and issubclass(one, RegressorMixin)}


def make_estimator(name: str, settings: Mapping[str, Any]) -> Any:
    """Return the unfitted regressor ``name`` with ``settings``. Raises `UnknownParameter` or `InvalidArgument`."""
    found = estimator_class(name)
    if not (hasattr(found, "predict") and hasattr(found, "get_params")):
        raise InvalidArgument(f"{name}: expected a class of sklearn.base.RegressorMixin and sklearn.base.BaseEstimator")
    parameters = inspect.signature(found).parameters
    needed = [key for key, one in parameters.items() if one.default is one.empty and one.kind is not one.VAR_KEYWORD]
    if needed:
        raise InvalidArgument(
            f"{name} needs {' and '.join(needed)}: pass the regressor itself, in Python, models=[{name}(...)]"
        )
    made = found()
    known = made.get_params()
    for key in settings:
        if key not in known:
            raise UnknownParameter(
                f"{name} has no parameter {key!r}.{did_you_mean(key, known)} It has: {', '.join(known)}"
            )
    return made.set_params(**settings)


def fitted_estimator(unfitted: Any, inputs: Array, targets: Array, seed: int) -> tuple[Any, bool]:
    """Return a copy of ``unfitted`` fitted to ``targets`` (N, n) at ``inputs`` (N, m), and whether it has converged.

    Of a search it is the best estimator.
    One regressor per output is fitted if it cannot predict several. Random states that are None become ``seed``, fits
    run in one thread unless their ``n_jobs`` is given, and neighbours are searched without a tree, which is not stored.
    Raises `InvalidArgument` with the reason of a failure.
    """
    from sklearn.base import clone
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.multioutput import MultiOutputRegressor
    from sklearn.utils import get_tags

    made = clone(unfitted)
    free = [key for key, value in made.get_params().items() if value is None]
    made.set_params(**{key: seed for key in free if key.rpartition("__")[2] == "random_state"})
    made.set_params(**{key: 1 for key in free if key.rpartition("__")[2] == "n_jobs"})
    auto = [key for key, value in made.get_params().items() if isinstance(value, str) and value == "auto"]
    made.set_params(**{key: "brute" for key in auto if key.rpartition("__")[2] == "algorithm"})
    name = type(made).__name__
    if name == "LGBMRegressor" and "verbosity" not in made.get_params():
        made.set_params(verbosity=-1)
    inner = made.estimator if "sklearn.BaseSearchCV" in bases_of(made) else made
    inner = inner.steps[-1][1] if "sklearn.Pipeline" in bases_of(inner) else inner
    tags = get_tags(inner).target_tags
    separate = name in BOOSTERS or not tags.multi_output
    if targets.shape[1] == 1 and tags.single_output and not separate:
        targets = targets[:, 0]
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                made = (MultiOutputRegressor(made) if separate else made).fit(inputs, targets)
            except ValueError:  # a step of a pipeline, such as SelectKBest, may take a single output
                if separate or targets.ndim == 1:
                    raise
                separate, made = True, MultiOutputRegressor(made).fit(inputs, targets)
    except Exception as error:  # a regressor from elsewhere may fail in any way
        raise InvalidArgument(f"{name} cannot be fitted to {len(inputs):,} samples: {error}") from error
    diverged = [one for one in caught if issubclass(one.category, ConvergenceWarning)]
    for one in caught:
        if one not in diverged:
            warnings.warn(one.message, stacklevel=2)
    if separate:
        made.estimators_ = [getattr(one, "best_estimator_", one) for one in made.estimators_]
        made.estimator = clone(made.estimators_[0])
    return getattr(made, "best_estimator_", made), not diverged


def predicted(estimator: Any, inputs: Array) -> Array:
    """Return the outputs of a fitted ``estimator`` at finite ``inputs`` (B, m), columns without names.

    An output is nan where a `RadiusNeighborsRegressor` has no neighbours.
    """
    from sklearn import config_context

    with config_context(assume_finite=True, skip_parameter_validation=True), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "X does not have valid feature names|One or more samples have no neigh")
        return np.asarray(estimator.predict(inputs), dtype=np.float64)


class Boosters:
    """Fitted boosters of LightGBM or XGBoost, one for each output."""

    def __init__(self, package: str, boosters: list[Any]) -> None:
        self.package, self.boosters = package, boosters

    @property
    def n_features_in_(self) -> int:
        """Number of inputs."""
        first = self.boosters[0]
        return int(first.num_feature() if self.package == "lightgbm" else first.num_features())

    def predict(self, inputs: Array) -> Array:
        """Return the outputs (B, n) at ``inputs`` (B, m)."""
        if self.package == "lightgbm":
            columns = [booster.predict(inputs, num_threads=1) for booster in self.boosters]
        else:
            matrix = import_module("xgboost").DMatrix(inputs)  # boosters of linear functions take no arrays
            columns = [booster.predict(matrix) for booster in self.boosters]
        return np.column_stack(columns).astype(np.float64)


def written(estimator: Any) -> tuple[Format, bytes]:
    """Return format and bytes of a fitted regressor. Raises `InvalidArgument` if it cannot be stored."""
    inner = getattr(estimator, "estimators_", [estimator])
    name = type(inner[0]).__name__ if len(inner) else ""
    if name == "LGBMRegressor":
        return "lightgbm", json.dumps([one.booster_.model_to_string() for one in inner]).encode()
    if BOOSTERS.get(name) == "xgboost":
        return "xgboost", json.dumps([xgboost_text(one.get_booster()) for one in inner]).encode()
    try:
        data = _without_addresses(import_module(SKOPS).dumps(estimator))
        refused = _refused(data)
    except Exception as error:  # an object within the regressor may fail in any way
        raise InvalidArgument(f"{type(estimator).__name__} cannot be stored by skops: {error}") from error
    if refused:
        boosters = [one for one in BOOSTERS if any(type_.endswith(f".{one}") for type_ in refused)]
        instead = next((INSTEAD[one] for one in refused if one in INSTEAD), None)
        hint = f". Pass {boosters[0]} itself: inputs and outputs are scaled anyway" if boosters else ""
        hint = f". {OWN}" if any(one.startswith("__main__.") for one in refused) else hint
        hint = f". {instead} avoids it" if instead else hint
        raise InvalidArgument(
            f"{type(estimator).__name__} cannot be stored: {', '.join(refused)} is not among the trusted types{hint}"
        )
    return "skops", data


def xgboost_text(booster: Any) -> str:
    """Return the trees of ``booster`` that predict: with early stopping those up to the best iteration."""
    if "best_iteration" in booster.attributes():
        booster = booster[: booster.best_iteration + 1]
    return bytes(booster.save_raw("json")).decode()


ADDRESS = re.compile(r'(?<="__id__": )\d+|(?<="file": ")\d+')


def _without_addresses(data: bytes) -> bytes:
    """Return the archive of skops without addresses in memory and times: the same for equal regressors."""
    numbers: dict[str, str] = {}
    target = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as source, zipfile.ZipFile(target, "w") as changed:
        schema = source.read("schema.json").decode()
        schema = ADDRESS.sub(lambda found: numbers.setdefault(found[0], str(len(numbers))), schema)
        changed.writestr(zipfile.ZipInfo("schema.json"), schema)
        for name in source.namelist():
            stem, dot, suffix = name.partition(".")
            if name != "schema.json":
                changed.writestr(zipfile.ZipInfo(numbers.get(stem, stem) + dot + suffix), source.read(name))
    return target.getvalue()


def read(format_: str, data: bytes) -> Any:
    """Return the regressor of these bytes. Raises `ArtefactError`, with the types that are not trusted."""
    try:
        if format_ == "skops":
            return _by_skops(data)
        if format_ in ("lightgbm", "xgboost"):
            return _boosters(format_, json.loads(data))
    except ArtefactError:
        raise
    except Exception as error:  # a damaged file may fail anywhere
        raise ArtefactError(f"the stored regressor cannot be read: {type(error).__name__}: {error}") from error
    raise ArtefactError(f"the stored regressor: expected the format skops, lightgbm or xgboost, got {format_!r}")


def _by_skops(data: bytes) -> Any:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        if any(member.compress_type != zipfile.ZIP_STORED for member in archive.infolist()):
            raise ArtefactError("the stored regressor: expected files without compression")
    refused = _refused(data)
    if refused:
        hint = ". A plugin file is given with --plugin FILE" if any(one.startswith(PREFIX) for one in refused) else ""
        raise ArtefactError(
            f"the stored regressor names {', '.join(refused)}, not among the trusted types: not loaded{hint}"
        )
    # none of these types is refused
    found = import_module(SKOPS).loads(data, trusted=import_module(SKOPS).get_untrusted_types(data=data))
    check_trees(found)
    return found


def _refused(data: bytes) -> list[str]:
    """Return the types in ``data`` that are not trusted; none of them is imported.

    Regressors of loaded plugin files are trusted.
    """
    found = sorted(set(import_module(SKOPS).get_untrusted_types(data=data)) - TRUSTED)
    return [one for one in found if not (one.startswith(PREFIX) and _is_loaded(one.removeprefix(PREFIX)))]


def _is_loaded(name: str) -> bool:
    """Whether ``FILE.NAME`` is a regressor of a loaded plugin file."""
    try:
        return hasattr(named_in_plugin(name, type), "get_params")
    except InvalidArgument:
        return False


def _boosters(package: str, texts: list[str]) -> Boosters:
    module = import_module(package)
    if package == "lightgbm":
        for text in texts:
            check_lightgbm(text)
        return Boosters(package, [module.Booster(model_str=text) for text in texts])
    found = [module.Booster({"nthread": 1}) for _ in texts]
    for booster, text in zip(found, texts, strict=True):
        booster.load_model(bytearray(text.encode()))
    return Boosters(package, found)


PER_SPLIT = "split_feature", "threshold", "decision_type", "left_child", "right_child"
PER_SPLIT_OR_NONE = "split_gain", "internal_value", "internal_weight", "internal_count"
PER_LEAF_OR_NONE = "leaf_weight", "leaf_count"
OF_TREES = {
    *PER_SPLIT, *PER_SPLIT_OR_NONE, *PER_LEAF_OR_NONE, "Tree", "num_leaves", "num_cat", "leaf_value", "is_linear",
    "leaf_const", "num_features", "leaf_features", "leaf_coeff", "shrinkage",
}  # fmt: skip
NUMBER = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d{1,3})?|nan|[-+]?inf")


def check_lightgbm(text: str) -> None:
    """Raise `ArtefactError` unless all lists in LightGBM's ``text`` have their lengths, and nodes refer to later ones.

    LightGBM itself trusts these lengths, and would read and write beyond its arrays.
    """
    head, begin, trees = text.partition("\nTree=")
    header = _lightgbm_values(head)
    inputs, sizes = int(header["max_feature_idx"]) + 1, [int(size) for size in header["tree_sizes"].split()]
    ends, trees = np.cumsum(sizes), begin[1:] + trees
    wanted = text.isascii() and "\r" not in text and header["num_class"] == header["num_tree_per_iteration"] == "1"
    named = len(header["feature_names"].split()) == len(header["feature_infos"].split()) == inputs
    inside = min(sizes) > 0 and ends[-1] <= len(trees)
    blocks = [trees[end - size : end] for size, end in zip(sizes, ends, strict=True)] if inside else []
    each = (block.startswith(f"Tree={i}\n") and _is_tree(block, inputs) for i, block in enumerate(blocks))
    if not (wanted and named and inside and all(each)):
        raise ArtefactError("the stored regressor: expected the text of trees of LightGBM, without categories")


def _is_tree(block: str, inputs: int) -> bool:
    """Whether all lists of a tree have their lengths, and its nodes refer to later ones and to its inputs."""
    lines = block.partition("\n\n")[0]
    values = {name: value.split() for name, value in _lightgbm_values(lines).items()}
    leaves, linear = int(*values["num_leaves"]), values.get("is_linear") == ["1"]
    splits = leaves - 1
    lengths = dict.fromkeys(("leaf_value", *(("leaf_const", "num_features") if linear else ())), leaves)
    lengths |= dict.fromkeys(PER_SPLIT, splits)
    known = set(values) <= OF_TREES and all(NUMBER.fullmatch(one) for numbers in values.values() for one in numbers)
    known &= all(len(values[name]) == length for name, length in lengths.items())
    known &= all(len(values.get(name, ())) in (0, leaves) for name in PER_LEAF_OR_NONE)
    known &= all(len(values.get(name, ())) in (0, splits) for name in PER_SPLIT_OR_NONE)
    if not known or values["num_cat"] != ["0"] or leaves < 1:
        return False
    features, left, right, kinds = (
        np.array(values[name], dtype=int) for name in ("split_feature", "left_child", "right_child", "decision_type")
    )
    if linear:
        counts, used = (np.array(values[name], dtype=int) for name in ("num_features", "leaf_features"))
        if (counts < 0).any() or not counts.sum() == len(used) == len(values["leaf_coeff"]):
            return False
        features = np.concatenate([features, used])
    places = np.arange(splits)
    later = all(((-leaves <= one) & (one < 0) | (places < one) & (one < splits)).all() for one in (left, right))
    return bool(later and (kinds % 2 == 0).all() and (features >= 0).all() and (features < inputs).all())


def _lightgbm_values(text: str) -> dict[str, str]:
    """Return the values of lines ``name=value``. Raises `ArtefactError` if a name occurs twice."""
    pairs = [line.partition("=")[::2] for line in text.split("\n")]
    if len({name for name, _ in pairs}) < len(pairs):
        raise ArtefactError("the stored regressor: a value is given twice")
    return dict(pairs)


def check_trees(estimator: Any) -> None:
    """Raise `ArtefactError` unless the nodes of all trees of a regressor refer to later nodes and to its inputs."""
    open_, seen = [(estimator, 0)], set()
    while open_:
        thing, inputs = open_.pop()
        if isinstance(thing, (str, bytes, int, float, type(None))) or id(thing) in seen:
            continue
        seen.add(id(thing))
        kind = type(thing).__name__
        if kind == "Tree":
            inner = thing.children_left >= 0
            children = (thing.children_left[inner], thing.children_right[inner])
            _check_nodes(children, thing.feature[inner], inner, thing.n_features, inputs)
        elif kind == "TreePredictor":
            inner = thing.nodes["is_leaf"] == 0
            nodes = thing.nodes[inner]
            _check_nodes((nodes["left"], nodes["right"]), nodes["feature_idx"], inner, inputs, inputs)
            if thing.nodes["is_categorical"].any():
                raise ArtefactError("the stored regressor: expected trees without categories")
        elif isinstance(thing, dict):
            open_ += [(value, inputs) for value in thing.values()]
        elif isinstance(thing, (list, tuple)) or (isinstance(thing, np.ndarray) and thing.dtype == object):
            open_ += [(value, inputs) for value in np.asarray(thing, dtype=object).ravel()]
        elif hasattr(thing, "__dict__"):
            own = int(getattr(thing, "n_features_in_", inputs))
            parts = thing.__dict__.get("estimators_")
            if parts is not None and "estimators_features_" not in thing.__dict__:
                trees = [one for one in np.asarray(parts, dtype=object).ravel() if hasattr(one, "tree_")]
                if any(one.tree_.n_features != own for one in trees):
                    raise ArtefactError(f"the stored regressor: expected trees of {own} inputs")
            open_ += [(value, own) for value in thing.__dict__.values()]


def _check_nodes(children: tuple[Any, Any], features: Any, inner: Any, n_features: int, inputs: int) -> None:
    places, count = np.flatnonzero(inner), len(inner)
    later = all(((one > places) & (one < count)).all() for one in children)
    if not (count and later and n_features == inputs and ((features >= 0) & (features < inputs)).all()):
        raise ArtefactError("the stored regressor: expected trees whose nodes refer to later nodes and to its inputs")
