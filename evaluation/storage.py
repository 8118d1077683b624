"""Results on disk: strict JSON, and arrays in a file of tensors beside it.

What a class stores stands beside that class: `save_prediction`, `save_cell`, `exploitability_to_json`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from sysid_evo.files import write_atomically
from sysid_evo.types import Array

DAMAGED = (OSError, ValueError, KeyError, TypeError, SafetensorError)
"""What reading a result raises whose files are missing, damaged, or hold something else."""


def write_json(value: Any, path: Path) -> list[Path]:
    """Write strict JSON to ``path`` with the suffix; return the file."""
    text = json.dumps(value, allow_nan=False)
    return [write_atomically(_with(path, ".json"), lambda file: file.write_text(text, encoding="utf-8"))]


def read_json(path: Path) -> Any:
    """Read what `write_json` wrote."""
    return json.loads(_with(path, ".json").read_text(encoding="utf-8"))


def write_with_arrays(value: Any, arrays: Mapping[str, Array], path: Path) -> list[Path]:
    """Write ``value`` as strict JSON and ``arrays`` as safetensors to ``path`` with two suffixes; return the files."""
    payload = save({name: np.ascontiguousarray(array) for name, array in arrays.items()})
    tensors = write_atomically(_with(path, ".safetensors"), lambda file: file.write_bytes(payload))
    return [tensors, *write_json(value, path)]


def read_with_arrays(path: Path) -> tuple[Any, dict[str, Array]]:
    """Read what `write_with_arrays` wrote. Raises `DAMAGED`."""
    return read_json(path), load_file(_with(path, ".safetensors"))


def plain(value: Any) -> Any:
    """Return ``value`` made of dicts, lists, strings, finite numbers, booleans and None alone."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int, str)):
        return value
    return str(value)


def _with(path: Path, suffix: str) -> Path:
    return path.with_name(path.name + suffix)
