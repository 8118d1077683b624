"""pysindy's own libraries and optimisers, handed over in Python, as the text that names them."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np

from model_zoo.sparse.libraries import joined
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry.spec import Spec

KNOWN_FUNCTIONS: dict[Callable[..., Any], str] = {
    np.sin: "sin", np.cos: "cos", np.tanh: "tanh", np.exp: "exp", np.abs: "abs", np.sign: "sign",
}  # fmt: skip


def named_library(given: Any) -> str:
    """Return the text of a library of pysindy; text is returned as it is. Raises `InvalidArgument`."""
    if isinstance(given, str):
        return given
    name = type(given).__name__
    if name in ("ConcatLibrary", "TensoredLibrary"):
        if getattr(given, "inputs_per_library", None) is not None:
            raise _nameless("library", name, "inputs_per_library", "write inputs=[CHANNEL, ...] into a text")
        sign = "+" if name == "ConcatLibrary" else "*"
        return joined([named_library(part) for part in given.libraries], sign)
    if name == "CustomLibrary":
        if not all(function in KNOWN_FUNCTIONS for function in given.functions):
            raise _nameless("library", name, "a function", "name functions: custom(functions=[tanh, x*abs(x)])")
        functions = [KNOWN_FUNCTIONS[function] for function in given.functions]
        bias = {"include_bias": True} if given.include_bias else {}
        return Spec("custom", {"functions": functions, **bias}).text
    short = {"PolynomialLibrary": "polynomial", "FourierLibrary": "fourier", "IdentityLibrary": "identity"}
    if not type(given).__module__.startswith("pysindy.") or name not in short:
        raise InvalidArgument(
            f"library: expected a text or one of pysindy's {', '.join(short)}, CustomLibrary, ConcatLibrary, "
            f"TensoredLibrary; got a {name}"
        )
    ignored = {"order"}
    return Spec(short[name], {k: v for k, v in _changed("library", given).items() if k not in ignored}).text


def named_optimizer(given: Any) -> str:
    """Return the text of an optimiser of pysindy; text is returned as it is. Raises `InvalidArgument`."""
    if isinstance(given, str):
        return given
    if not type(given).__module__.startswith("pysindy."):
        raise InvalidArgument(f"optimizer: expected a text or an optimiser of pysindy, got a {type(given).__name__}")
    return Spec(type(given).__name__, _changed("optimizer", given)).text


def _changed(kind: str, given: Any) -> dict[str, Any]:
    """Return the arguments that differ from their defaults. Raises `InvalidArgument` for what has no name."""
    found: dict[str, Any] = {}
    for name, parameter in inspect.signature(type(given)).parameters.items():
        value = getattr(given, name, parameter.default)
        if name == "opt" and type(value).__module__.startswith("pysindy."):
            found[name] = named_optimizer(value)
        elif value is parameter.default or (np.ndim(value) == 0 and value == parameter.default):
            continue
        elif name == "ensemble_aggregator" and value in (np.mean, np.median):
            found[name] = value.__name__
        elif isinstance(value, (bool, int, float, str)):
            found[name] = value
        elif name == "optimizer" and hasattr(value, "estimator"):
            found[name] = _estimator(value.estimator)
        else:
            why = "say constraints=['TERM in STATE <= 0']" if "constraint" in name else "leave it at its default"
            raise _nameless(kind, type(given).__name__, name, why)
    return found


def _estimator(given: Any) -> str:
    """Return the text of an estimator of scikit-learn's linear models."""
    usual = type(given)().get_params()
    changed = {k: v for k, v in given.get_params().items() if v != usual[k] and k != "fit_intercept"}
    return Spec(type(given).__name__, changed).text


def _nameless(kind: str, owner: str, what: str, instead: str) -> InvalidArgument:
    return InvalidArgument(f"{kind}: {what} of {owner} has no name, so that it could not be stored: {instead}")
