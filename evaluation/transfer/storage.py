"""A cell of the matrix on disk: the recorded trials in safetensors, the rest in strict JSON."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from evaluation.transfer.cell import Cell
from sysid_evo.errors import ArtefactError
from sysid_evo.files import write_atomically

LONG = ("states", "controls", "pose")
"""What there is of each trace at every step: as text it would take fifty times as long."""


def save_cell(cell: Cell, path: Path) -> list[Path]:
    """Write a cell to ``path`` with two suffixes; return the files."""
    value = cell.to_dict()
    tensors = {}
    for i, trace in enumerate(value["traces"]):
        for name in LONG:
            numbers = trace.pop(name)
            if numbers is not None:
                tensors[f"trace.{i}.{name}"] = np.asarray(numbers)
    payload, text = save(tensors), json.dumps(value, allow_nan=False)
    return [
        write_atomically(_with(path, ".safetensors"), lambda file: file.write_bytes(payload)),
        write_atomically(_with(path, ".json"), lambda file: file.write_text(text, encoding="utf-8")),
    ]


def load_cell(path: Path) -> Cell:
    """Read what `save_cell` wrote. Raises `ArtefactError`."""
    try:
        value = json.loads(_with(path, ".json").read_text(encoding="utf-8"))
        tensors = load_file(_with(path, ".safetensors"))
        for i, trace in enumerate(value["traces"]):
            trace.update({name: tensors.get(f"trace.{i}.{name}") for name in LONG})
        return Cell.from_dict(value)
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
        raise ArtefactError(f"{path}: not a cell of a transfer matrix: {error}") from error


def _with(path: Path, suffix: str) -> Path:
    return path.with_name(path.name + suffix)
