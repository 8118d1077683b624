"""Fitted models on disk: constructor arguments and scalars in JSON, arrays in safetensors."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sysid_evo.artefacts import read_artefact, stored_file, write_artefact
from sysid_evo.errors import ArtefactError, InvalidArgument, NotFitted, PluginError, ShapeError, UnknownName
from sysid_evo.models.adapters import family_name, plain_parameters
from sysid_evo.models.base import DynamicsModel
from sysid_evo.models.learned import check_learned
from sysid_evo.registry.registry import models
from sysid_evo.system import System

NESTED = ("name", "module", "parameters", "learned", "system")


def save_model(model: DynamicsModel, path: str | Path, *, seed: int | None = None, data: str | None = None) -> Path:
    """Write ``<path>.safetensors`` and ``<path>.json``; return the path of the manifest.

    ``seed`` and ``data`` (the fingerprint of the training set) are recorded. Learned models, also in a list, are stored
    with ``model``. Raises `NotFitted`, or `InvalidArgument` if a learned value is neither an array, a number, a string,
    a fitted model nor a list of these.
    """
    tensors: dict[str, Any] = {}
    fields = {
        **_described(model, tensors, ""),
        "kind": "model",
        "seed": seed,
        "data": data,
        "timings": {} if model.fit_seconds is None else {"fit_seconds": model.fit_seconds},
    }
    return write_artefact(Path(path), tensors, fields)


def _described(model: DynamicsModel, tensors: dict[str, Any], place: str) -> dict[str, Any]:
    """Return the JSON part of a model; its arrays are added to ``tensors``, their names prefixed with ``place``."""
    name = family_name(model)
    if not hasattr(model, "system_"):
        raise NotFitted(f"model {name!r} is not fitted, so there is nothing to store: call fit(dataset, rng=...) first")
    try:
        check_learned(model)
    except ShapeError as error:
        raise InvalidArgument(f"model {name!r}: cannot be stored: {error}") from error
    scalars: dict[str, Any] = {}
    for key, value in vars(model).items():
        if not key.endswith("_") or key.startswith("_") or key == "system_":
            continue
        if isinstance(value, np.ndarray):
            tensors[place + key] = value
        elif _all(value, np.ndarray):
            tensors.update({f"{place}{key}.{i}": item for i, item in enumerate(value)})
        elif isinstance(value, DynamicsModel):
            scalars[key] = _described(value, tensors, f"{place}{key}/")
        elif _all(value, DynamicsModel):
            scalars[key] = [_described(item, tensors, f"{place}{key}.{i}/") for i, item in enumerate(value)]
        elif _is_plain(value):
            scalars[key] = value
        else:
            raise InvalidArgument(
                f"model {name!r}: {key} is a {type(value).__name__}; learned values must be arrays, numbers, strings, "
                "fitted models or lists of these, so that they can be stored (derive anything else when it is needed)"
            )
    return {
        "name": name,
        "module": type(model).__module__,
        "parameters": plain_parameters(model),
        "learned": scalars,
        "system": model.system.to_dict(),
    }


def load_model(path: str | Path) -> DynamicsModel:
    """Return the model that `save_model` wrote to ``path``, such as ``runs/mine/models/linear`` (`stored_file`).

    Raises `ArtefactError`. Code in the file is never run.
    """
    path = stored_file(path, "model")
    manifest, tensors = read_artefact(path, "model")
    return _restored(path, {name: getattr(manifest, name) for name in NESTED}, tensors)


def _restored(path: Path, described: Mapping[str, Any], tensors: Mapping[str, Any]) -> DynamicsModel:
    """Return the model that `_described` describes; ``tensors`` are those of this model alone."""
    name, module = described["name"], described["module"]
    try:
        family = models.get(name)
    except UnknownName as error:
        raise ArtefactError(
            f"{path}: needs the model family {name!r}, which the module {module!r} registered when "
            f"it was saved: install its package, or give its file with --plugin. {error}"
        ) from error
    except PluginError as error:
        raise ArtefactError(f"{path}: {error}") from error
    try:
        model: DynamicsModel = family(**described["parameters"])
        model.system_ = System.from_dict(described["system"] or {})
    except (KeyError, TypeError, ValueError) as error:
        raise ArtefactError(f"{path}: not a stored {name}: {type(error).__name__}: {error}") from error
    inner: dict[str, dict[str, Any]] = {}
    lists: dict[str, dict[int, Any]] = {}
    for key, tensor in tensors.items():
        head, slash, rest = key.partition("/")
        base, dot, index = head.partition(".")
        if slash:
            inner.setdefault(head, {})[rest] = tensor
        elif dot and index.isdecimal():
            lists.setdefault(_checked(path, base), {})[int(index)] = tensor
        else:
            setattr(model, _checked(path, key), tensor)
    for key, items in lists.items():
        setattr(model, key, [items[i] for i in sorted(items)])
    for key, value in described["learned"].items():
        setattr(model, _checked(path, key), _learned(path, key, value, inner))
    try:
        check_learned(model)
    except ShapeError as error:
        raise ArtefactError(f"{path}: not a stored {name}: {error}; store it again, or refit it") from error
    except PluginError as error:
        raise ArtefactError(f"{path}: {error}") from error
    return model


def _learned(path: Path, key: str, value: Any, tensors: Mapping[str, Mapping[str, Any]]) -> Any:
    """Return the learned ``value`` of ``key``; a model, or models in a list, are restored from their description."""
    if isinstance(value, dict):
        return _restored(path, _nested(path, key, value), tensors.get(key, {}))
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [
            _restored(path, _nested(path, key, item), tensors.get(f"{key}.{i}", {})) for i, item in enumerate(value)
        ]
    return value


def _nested(path: Path, key: str, value: object) -> dict[str, Any]:
    """Return ``value`` if it describes a nested model, else raise `ArtefactError`."""
    if not isinstance(value, dict) or set(value) != set(NESTED):
        raise ArtefactError(f"{path}: {key}: expected a model with {', '.join(NESTED)}")
    wrong = [
        name
        for name, expected in zip(NESTED, (str, str, dict, dict, dict), strict=True)
        if not isinstance(value[name], expected)
    ]
    if wrong:
        raise ArtefactError(f"{path}: {key}: {wrong[0]} of a model cannot be a {type(value[wrong[0]]).__name__}")
    return value


def _all(value: object, kind: type) -> bool:
    """Whether ``value`` is a non-empty list of instances of ``kind``."""
    return isinstance(value, list) and bool(value) and all(isinstance(item, kind) for item in value)


def _is_plain(value: Any) -> bool:
    if isinstance(value, list):
        return all(_is_plain(item) for item in value)
    return value is None or (isinstance(value, (bool, int, float, str)) and not isinstance(value, np.generic))


def _checked(path: Path, key: str) -> str:
    if not (key.isidentifier() and key.endswith("_") and not key.startswith("_")) or key == "system_":
        raise ArtefactError(f"{path}: {key!r} cannot be the name of something learned")
    return key
