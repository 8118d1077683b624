"""Checkpoints on disk: one safetensors file, which is the old one or the new one after a crash, never half of one."""

from __future__ import annotations

import hashlib
import json
import time
import warnings
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from sysid_evo.checkpoint import State
from sysid_evo.errors import ArtefactError, CheckpointWarning, InvalidArgument
from sysid_evo.files import write_atomically

SCHEMA: Literal["sysid-evo/checkpoint/2"] = "sysid-evo/checkpoint/2"
CONTENT = "sysid-evo"
SHARE = 0.01
"""The most that saving takes of the time."""


class _Content(BaseModel):
    """What stands in the header of the file, beside the arrays: the rest of the state, and its digest.

    ``numbers`` names the arrays that are plain numbers.
    """

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    schema_: Literal["sysid-evo/checkpoint/2"] = SCHEMA
    identity: str
    numbers: list[str]
    others: dict[str, int | str]
    sha256: str


class CheckpointFile:
    """Keeps the state of long work in the file ``path``: a `Checkpoint` for `evolve_controller` and for models.

    It is due every ``every`` s, less often where saving takes long: never more than a hundredth of the time.
    A file that is damaged, or belongs to other work, is a `CheckpointWarning` and counts as none.
    """

    def __init__(self, path: str | Path, *, every: float = 1.0) -> None:
        if not every >= 0.0:
            raise InvalidArgument(f"checkpoint: expected every >= 0 s, got {every}")
        self.path, self.every = Path(path), every
        self._saved = time.monotonic()
        self._took = 0.0

    def load(self, identity: str) -> State | None:
        """Return what was saved under this ``identity``, None if there is nothing that can be used."""
        if not self.path.is_file():
            return None
        try:
            owner, state = read_checkpoint(self.path)
        except ArtefactError as error:
            warnings.warn(f"{error}; it is ignored, and all is computed again", CheckpointWarning, stacklevel=2)
            return None
        if owner != identity:
            warnings.warn(
                f"{self.path}: the checkpoint of other work (other models, settings, seed or versions); it is ignored, "
                "and all is computed again",
                CheckpointWarning,
                stacklevel=2,
            )
            return None
        return state

    def due(self) -> bool:
        """Whether it is time to save again."""
        return time.monotonic() - self._saved >= max(self.every, self._took / SHARE)

    def save(self, identity: str, state: State) -> None:
        """Write ``state`` in place of what was kept before. Raises `OSError`."""
        began = time.monotonic()
        write_checkpoint(self.path, identity, state)
        self._saved = time.monotonic()
        self._took = self._saved - began


def write_checkpoint(path: Path, identity: str, state: State) -> None:
    """Write ``state`` to the file ``path``. Raises `OSError`."""
    numbers = [name for name, value in state.items() if isinstance(value, (float, np.floating))]
    tensors = {
        name: np.array(value, dtype=np.float64, order="C")
        for name, value in state.items()
        if name in numbers or isinstance(value, np.ndarray)
    }
    others = {
        name: value if isinstance(value, str) else int(value) for name, value in state.items() if name not in tensors
    }
    content = _Content(identity=identity, numbers=numbers, others=others, sha256="")
    content.sha256 = _digest(tensors, content)
    payload = save(tensors, {CONTENT: content.model_dump_json()})
    write_atomically(path, lambda file: file.write_bytes(payload))


def read_checkpoint(path: Path) -> tuple[str, State]:
    """Return identity and state in the file ``path``. Raises `ArtefactError` if it is damaged or something else."""
    try:
        with safe_open(path, framework="numpy") as file:
            content = _Content.model_validate_json((file.metadata() or {})[CONTENT])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  # it is no mapping
    except (SafetensorError, OSError, KeyError, ValueError, TypeError) as error:
        reason = str(error).partition("\n")[0]
        raise ArtefactError(f"{path}: expected a checkpoint, but it cannot be read ({reason})") from error
    if _digest(tensors, content) != content.sha256:
        raise ArtefactError(f"{path}: expected a checkpoint, but it is damaged: its SHA-256 differs")
    plain = {name: float(value) if name in content.numbers else value for name, value in tensors.items()}
    return content.identity, {**plain, **content.others}


def _digest(tensors: dict[str, np.ndarray[Any, Any]], content: _Content) -> str:
    """Return the SHA-256 of all that a checkpoint holds."""
    rest = json.dumps([content.identity, content.numbers, content.others], sort_keys=True)
    return hashlib.sha256(save(tensors) + rest.encode()).hexdigest()
