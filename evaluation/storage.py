"""Results on disk: any data class of numbers, texts and arrays, as strict JSON and a file of tensors next to it.

Arrays are among the tensors, named by their places in the data class, such as ``at.0.rmse``. The JSON has null for
them, and for numbers that are not finite. Reading checks every value against the type of its field.
"""

from __future__ import annotations

import json
import math
import types
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from sysid_evo.errors import ArtefactError, InvalidData, SysidEvoError
from sysid_evo.files import write_atomically
from sysid_evo.plan import ResultType
from sysid_evo.types import Array

R = TypeVar("R")


def save_result(value: Any, path: Path) -> list[Path]:
    """Write a data class, or a tuple of some, to ``path`` with one suffix, or two if it has arrays; return the files.

    Raises `InvalidData` for anything but numbers, texts, arrays, and data classes, tuples or mappings of these.
    """
    arrays: dict[str, Array] = {}
    text = json.dumps(plain(value, arrays), allow_nan=False)
    written = []
    if arrays:
        payload = save({name: np.ascontiguousarray(array) for name, array in arrays.items()})
        written.append(write_atomically(_with(path, ".safetensors"), lambda file: file.write_bytes(payload)))
    return [*written, write_atomically(_with(path, ".json"), lambda file: file.write_text(text, encoding="utf-8"))]


def result_of(kind: Any) -> ResultType:
    """Return the storage of cell results of type ``kind``, see `save_result`."""
    return ResultType("results", lambda value, path, _: save_result(value, path), partial(load_result, kind))


def load_result(kind: type[R], path: Path) -> R:
    """Read a result of type ``kind``, such as ``tuple[ModelExploitability, ...]``, written by `save_result`.

    Raises `ArtefactError` that names the file and the field.
    """
    try:
        value = json.loads(_with(path, ".json").read_text(encoding="utf-8"))
        tensors = _with(path, ".safetensors")
        return from_plain(kind, value, load_file(tensors) if tensors.is_file() else {})
    except (OSError, ValueError, KeyError, TypeError, RecursionError, SafetensorError, SysidEvoError) as error:
        name = getattr(kind, "__name__", str(kind))
        raise ArtefactError(f"{path}: not a stored {name}: {type(error).__name__}: {error}") from error


def plain(value: Any, arrays: dict[str, Array] | None = None, place: str = "") -> Any:
    """Return ``value`` as dicts, lists, strings, finite numbers, booleans and None alone.

    Arrays become lists, or are put into ``arrays`` under the names of their places. A class may define its own form,
    `to_dict`. Other values become their text; with ``arrays``, for values to be read again, they raise `InvalidData`.
    """
    if isinstance(value, np.ndarray):
        if arrays is None:
            return plain(value.tolist())
        arrays[place] = value
        return None
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, Mapping):
        return {str(key): plain(item, arrays, _at(place, key)) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item, arrays, _at(place, i)) for i, item in enumerate(value)]
    if is_dataclass(value):
        if hasattr(value, "to_dict"):
            return value.to_dict()
        return {one.name: plain(getattr(value, one.name), arrays, _at(place, one.name)) for one in fields(value)}
    if arrays is not None:
        raise InvalidData(f"{place or 'result'}: expected numbers, texts, arrays or data classes, got {value!r:.60}")
    return str(value)


def from_plain(kind: Any, value: Any, arrays: Mapping[str, Array] | None = None, place: str = "") -> Any:
    """Return the value of type ``kind`` that `plain` converted to ``value`` and ``arrays``, or to lists without them.

    Raises `InvalidData` that names the field, the expected value and the value found.
    """
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):  # always with None
        if value is None and place not in (arrays or {}):
            return None
        (kind,) = (part for part in parts if part is not types.NoneType)
        return from_plain(kind, value, arrays, place)
    if origin is np.ndarray:
        return _array(kind, value, arrays, place)
    if is_dataclass(kind):
        return _object(kind, value, arrays, place)
    if origin is tuple:
        _check(isinstance(value, list), "a list", value, place)
        types_of = [parts[0]] * len(value) if parts[1:] == (...,) else list(parts)
        _check(len(types_of) == len(value), f"{len(types_of)} values", value, place)
        found = [
            from_plain(part, item, arrays, _at(place, i))
            for i, (part, item) in enumerate(zip(types_of, value, strict=True))
        ]
        return tuple(found)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        _check(isinstance(value, dict), "an object", value, place)
        return {key: from_plain(parts[1], item, arrays, _at(place, key)) for key, item in value.items()}
    if origin is Literal:
        _check(value in parts, f"one of {parts}", value, place)
    elif kind is float:
        if value is None:
            return math.nan
        _check(isinstance(value, (int, float)) and not isinstance(value, bool), "a number", value, place)
    else:
        _check(
            isinstance(value, kind) and (kind is not int or not isinstance(value, bool)), kind.__name__, value, place
        )
    return value


def _array(kind: Any, value: Any, arrays: Mapping[str, Array] | None, place: str) -> Array:
    (dtype,) = get_args(get_args(kind)[1])
    if arrays is None:
        _check(isinstance(value, list), "a list of numbers", value, place)
        return np.asarray(value, dtype)
    _check(place in arrays and arrays[place].dtype == dtype, f"an array of {np.dtype(dtype)}", arrays.get(place), place)
    return arrays[place]


def _object(kind: Any, value: Any, arrays: Mapping[str, Array] | None, place: str) -> Any:
    _check(isinstance(value, dict), "an object", value, place)
    if hasattr(kind, "from_dict"):
        return kind.from_dict(value)
    known = {one.name: one.default is MISSING and one.default_factory is MISSING for one in fields(kind)}
    missing = [name for name, needed in known.items() if needed and name not in value]
    _check(value.keys() <= known.keys() and not missing, f"an object with {', '.join(known)}", list(value), place)
    hints = _hints(kind)
    return kind(**{name: from_plain(hints[name], item, arrays, _at(place, name)) for name, item in value.items()})


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)


def _check(holds: bool, expected: str, value: Any, place: str) -> None:
    if not holds:
        raise InvalidData(f"{place or 'result'}: expected {expected}, got {value!r:.60}")


def _at(place: str, key: Any) -> str:
    return f"{place}.{key}" if place else str(key)


def _with(path: Path, suffix: str) -> Path:
    return path.with_name(path.name + suffix)
