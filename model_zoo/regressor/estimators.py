"""Regressors of scikit-learn, LightGBM and XGBoost: by class name, with settings, for several outputs."""

from __future__ import annotations

import importlib
import inspect
import warnings
from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec
from typing import Any

from sysid_evo.errors import InvalidArgument, UnknownName, UnknownParameter, did_you_mean
from sysid_evo.extras import missing_extra
from sysid_evo.models import bases_of
from sysid_evo.types import Array

MODULES = (
    "ensemble", "linear_model", "neural_network", "neighbors", "svm", "tree", "kernel_ridge", "gaussian_process",
    "cross_decomposition", "dummy", "isotonic", "compose", "multioutput",
)  # fmt: skip
"""Modules of scikit-learn with regressors; ``sklearn.utils.all_estimators`` finds the same, but imports everything."""
BOOSTERS = {"LGBMRegressor": "lightgbm", "XGBRegressor": "xgboost"}
"""Regressors of other packages, which are stored in the text format of their package."""


def estimator_class(name: str) -> Any:
    """Return the regressor called ``name``. Raises `UnknownName`, or `MissingExtra` without its package."""
    if name in BOOSTERS:
        if find_spec(BOOSTERS[name]) is None:
            raise missing_extra(name, BOOSTERS[name])
        return getattr(importlib.import_module(BOOSTERS[name]), name)
    for module in MODULES:
        found = _regressors(module).get(name)
        if found is not None:
            return found
    known = sorted({*BOOSTERS, *(regressor for module in MODULES for regressor in _regressors(module))})
    raise UnknownName(
        f"no regressor of scikit-learn, LightGBM or XGBoost is called {name!r}.{did_you_mean(name, known)} "
        f"Known: {', '.join(known)}. A regressor of your own is passed in Python: models=[{name}()]"
    )


@cache
def _regressors(module: str) -> dict[str, Any]:
    from sklearn.base import RegressorMixin

    found = vars(importlib.import_module(f"sklearn.{module}"))
    return {name: one for name, one in found.items() if isinstance(one, type) and issubclass(one, RegressorMixin)}


def make_estimator(name: str, settings: Mapping[str, Any]) -> Any:
    """Return the unfitted regressor ``name`` with ``settings``. Raises `UnknownParameter` or `InvalidArgument`."""
    found = estimator_class(name)
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
    One regressor per output is fitted if it cannot predict several. Random states that are None become ``seed``, and
    fits run in one thread unless their ``n_jobs`` is given. Raises `InvalidArgument` with the reason of a failure.
    """
    from sklearn.base import clone
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.multioutput import MultiOutputRegressor
    from sklearn.utils import get_tags

    made = clone(unfitted)
    free = [key for key, value in made.get_params().items() if value is None]
    made.set_params(**{key: seed for key in free if key.rpartition("__")[2] == "random_state"})
    made.set_params(**{key: 1 for key in free if key.rpartition("__")[2] == "n_jobs"})
    name = type(made).__name__
    if name == "LGBMRegressor" and "verbosity" not in made.get_params():
        made.set_params(verbosity=-1)
    inner = made.estimator if "sklearn.BaseSearchCV" in bases_of(made) else made
    separate = name in BOOSTERS or not get_tags(inner).target_tags.multi_output
    if separate:
        made = MultiOutputRegressor(made)
    elif targets.shape[1] == 1:
        targets = targets[:, 0]
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            made.fit(inputs, targets)
    except (ValueError, TypeError, ArithmeticError) as error:
        raise InvalidArgument(f"{name} cannot be fitted to {len(inputs):,} samples: {error}") from error
    diverged = [one for one in caught if issubclass(one.category, ConvergenceWarning)]
    for one in caught:
        if one not in diverged:
            warnings.warn(one.message, stacklevel=2)
    if separate:
        made.estimators_ = [getattr(one, "best_estimator_", one) for one in made.estimators_]
        made.estimator = clone(made.estimators_[0])
    return getattr(made, "best_estimator_", made), not diverged
