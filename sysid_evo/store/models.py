"""Fitted models on disk: constructor arguments and scalars in JSON, arrays in safetensors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sysid_evo.dynamics import DynamicsModel
from sysid_evo.errors import ArtefactError, InvalidArgument, NotFitted, PluginError, UnknownName
from sysid_evo.registry import models
from sysid_evo.store.manifest import read_artefact, write_artefact
from sysid_evo.system import System

ENVELOPE = "envelope_"


def save_model(model: DynamicsModel, path: str | Path, *, seed: int | None = None, data: str | None = None) -> Path:
    """Write ``<path>.safetensors`` and ``<path>.json``; return the path of the manifest.

    ``seed`` and ``data`` (the fingerprint of the training set) are recorded. Raises `NotFitted`, or
    `InvalidArgument` if something learned is neither array, number, string nor a list of these.
    """
    name = family_name(model)
    learned = {
        key: value
        for key, value in vars(model).items()
        if key.endswith("_") and not key.startswith("_") and key != "system_"
    }
    if not hasattr(model, "system_"):
        raise NotFitted(f"model {name!r} is not fitted, so there is nothing to store: call fit(dataset, rng=...) first")
    tensors: dict[str, Any] = {}
    scalars: dict[str, Any] = {}
    for key, value in learned.items():
        if isinstance(value, np.ndarray):
            tensors[key] = value
        elif isinstance(value, list) and value and all(isinstance(item, np.ndarray) for item in value):
            tensors.update({f"{key}.{i}": item for i, item in enumerate(value)})
        elif _is_plain(value):
            scalars[key] = value
        else:
            raise InvalidArgument(
                f"model {name!r}: {key} is a {type(value).__name__}; what a model learns must be arrays, numbers, "
                "strings or lists of these, so that it can be stored (derive anything else when it is needed)"
            )
    fields = {
        "kind": "model",
        "name": name,
        "module": type(model).__module__,
        "parameters": model.get_params(deep=False),
        "learned": scalars,
        "system": model.system.to_dict(),
        "seed": seed,
        "data": data,
        "timings": {} if model.fit_seconds is None else {"fit_seconds": model.fit_seconds},
    }
    return write_artefact(Path(path), tensors, fields)


def load_model(path: str | Path) -> DynamicsModel:
    """Read what `save_model` wrote. Raises `ArtefactError`; no code in the file is ever run."""
    path = Path(path)
    manifest, tensors = read_artefact(path, "model")
    try:
        family = models.get(manifest.name)
    except UnknownName as error:
        raise ArtefactError(
            f"{path}: needs the model family {manifest.name!r}, which the module {manifest.module!r} registered when "
            f"it was saved: install its package, or give its file with --plugin. {error}"
        ) from error
    except PluginError as error:
        raise ArtefactError(f"{path}: {error}") from error
    try:
        model: DynamicsModel = family(**manifest.parameters)
        model.system_ = System.from_dict(manifest.system or {})
    except (KeyError, TypeError, ValueError) as error:
        raise ArtefactError(f"{path}: not a stored {manifest.name}: {type(error).__name__}: {error}") from error
    for key, value in manifest.learned.items():
        setattr(model, _checked(path, key), value)
    lists: dict[str, dict[int, Any]] = {}
    for key, tensor in tensors.items():
        base, dot, index = key.partition(".")
        if dot and index.isdecimal():
            lists.setdefault(_checked(path, base), {})[int(index)] = tensor
        else:
            setattr(model, _checked(path, key), tensor)
    for key, items in lists.items():
        setattr(model, key, [items[i] for i in sorted(items)])
    return model


def family_name(model: DynamicsModel) -> str:
    """Return the name under which the class of ``model`` is registered."""
    for name, family in models.loaded.items():
        if family is type(model):
            return name
    raise InvalidArgument(
        f"{type(model).__name__} is not a registered family: decorate it with @register_model(name), "
        "so that it can be found again when it is loaded"
    )


def _is_plain(value: Any) -> bool:
    if isinstance(value, list):
        return all(_is_plain(item) for item in value)
    return value is None or (isinstance(value, (bool, int, float, str)) and not isinstance(value, np.generic))


def _checked(path: Path, key: str) -> str:
    if not (key.isidentifier() and key.endswith("_") and not key.startswith("_")) or key == "system_":
        raise ArtefactError(f"{path}: {key!r} cannot be the name of something learned")
    return key
