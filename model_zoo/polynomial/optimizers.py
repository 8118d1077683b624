"""pysindy's optimisers by name with arguments, such as ``SR3(reg_weight_lam=0.1)``, and how one is run."""

from __future__ import annotations

import importlib
import inspect
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from sysid_evo.errors import InvalidArgument
from sysid_evo.registry.grammar import Spec
from sysid_evo.types import Array

NAMES = (
    "STLSQ", "SR3", "FROLS", "SSR", "MIOSR", "SBR", "EnsembleOptimizer", "WrappedOptimizer",
)  # fmt: skip
NEEDS: Mapping[str, str] = {"MIOSR": "gurobipy", "SBR": "numpyro"}
"""Packages required in addition to pysindy."""
REFUSED: Mapping[str, str] = {
    "StableLinearSR3": "its guarantee does not hold for states in different units and with controls",
    "TrappingSR3": "its guarantee holds only for quadratic systems without controls",
    "SINDyPI": "an implicit equation cannot be stepped",
}
ROWS_COUNT = ("EnsembleOptimizer", "SBR", "WrappedOptimizer")
"""Optimisers that draw single samples, or whose penalty depends on the number of samples."""
AGGREGATORS = {"mean": lambda fits: np.mean(fits, axis=0), "median": lambda fits: np.median(fits, axis=0)}
NEGLIGIBLE = 1e-6
"""Size of a zero coefficient after a solver, for quantities divided by their RMS."""


def read_optimizer(text: str) -> Spec:
    """Return the name, as pysindy writes it, and the arguments. Raises `InvalidArgument`; imports nothing."""
    spec = Spec.parse(text)
    if spec.name in REFUSED:
        raise InvalidArgument(f"optimizer: {spec.name} is not supported: {REFUSED[spec.name]}")
    for name in NAMES:
        if name.lower() == spec.name.lower():
            return Spec(name, spec.parameters)
    raise InvalidArgument(f"optimizer: expected one of {', '.join(NAMES)}, got {spec.name!r}")


def make_optimizer(text: str) -> Any:
    """Return pysindy's optimiser. Raises `InvalidArgument` if its arguments are wrong, or a package is missing."""
    spec = read_optimizer(text)
    needed = NEEDS.get(spec.name)
    try:
        if needed is not None:
            importlib.import_module(needed)
        family = getattr(importlib.import_module("pysindy.optimizers"), spec.name)
    except (ImportError, AttributeError) as error:
        raise InvalidArgument(
            f"optimizer: {spec.name} needs the package {needed}: pip install {needed}, or use one of "
            f"{', '.join(name for name in NAMES if name not in NEEDS)}"
        ) from error
    given = {name: _value(spec, name, value) for name, value in spec.parameters.items()}
    known = [name for name in inspect.signature(family).parameters if name not in ("args", "kwargs")]
    unknown = [name for name in given if name not in known]
    if unknown:
        raise InvalidArgument(f"optimizer: {spec.name} has no parameter {unknown[0]!r}; it has {', '.join(known)}")
    try:
        return family(**given)
    except (TypeError, ValueError, NotImplementedError) as error:
        raise InvalidArgument(f"optimizer: {spec.text}: {error}") from error


def _value(spec: Spec, name: str, value: Any) -> Any:
    """Return an argument; an optimiser, an estimator of scikit-learn and an aggregator are given by name."""
    if name.startswith("constraint_") or name in ("initial_guess", "sparse_ind"):
        raise InvalidArgument(f"optimizer: {spec.name}: {name} is an array, which a text cannot hold")
    if name == "opt" and isinstance(value, str):
        return make_optimizer(value)
    if name == "ensemble_aggregator" and value is not None:
        if value not in AGGREGATORS:
            raise InvalidArgument(f"optimizer: ensemble_aggregator: expected mean or median, got {value!r}")
        return AGGREGATORS[value]
    if name == "optimizer" and isinstance(value, str):
        from sklearn import linear_model

        inner = Spec.parse(value)
        estimator = getattr(linear_model, inner.name, None) if inner.name in linear_model.__all__ else None
        if not inspect.isclass(estimator):
            raise InvalidArgument(f"optimizer: expected an estimator of sklearn.linear_model, got {inner.name!r}")
        try:
            return estimator(**{"fit_intercept": False, **inner.parameters})
        except TypeError as error:
            raise InvalidArgument(f"optimizer: {inner.text}: {error}") from error
    return value


def counts_rows(text: str) -> bool:
    """Whether the result depends on single rows, not only on the products of columns."""
    spec = read_optimizer(text)
    return spec.name in ROWS_COUNT or bool(spec.parameters.get("trimming_fraction"))


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Seed NumPy's global generator, since pysindy has no other, and restore it afterwards; ignore warnings."""
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed)  # noqa: NPY002
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an empty equation is a valid result
            yield
    finally:
        np.random.set_state(before)  # noqa: NPY002


def run(optimizer: Any, terms: Array, targets: Array, seed: int) -> Array:
    """Return the result of pysindy's ``optimizer``, (T, nx)."""
    try:
        with seeded(seed):
            optimizer.fit(terms, targets)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise InvalidArgument(f"optimizer: {type(optimizer).__name__} fails on these terms: {error}") from error
    found = np.asarray(optimizer.coef_, dtype=np.float64).T
    return np.where(np.abs(found) > NEGLIGIBLE, found, 0.0)
