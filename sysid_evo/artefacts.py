"""Artefacts on disk: safetensors with a strict JSON manifest, and checkpoints; nothing is unpickled."""

from __future__ import annotations

import hashlib
import json
import math
import re
import time
import warnings
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError
from safetensors import SafetensorError, safe_open
from safetensors.numpy import load_file, save

from sysid_evo.errors import ArtefactError, CheckpointWarning, InvalidArgument, closest
from sysid_evo.files import write_atomically
from sysid_evo.progress import CheckpointState
from sysid_evo.version import versions

SCHEMA: Literal["sysid-evo/artefact/4"] = "sysid-evo/artefact/4"

SUFFIXES = (".json", ".safetensors")

MAX_MANIFEST_BYTES, MAX_HEADER_BYTES, MAX_TENSOR_BYTES = 4 * 2**20, 2**20, 2**31


def strict_json(value: Any) -> Any:
    """Return ``value`` if strict JSON can hold it, else raise ValueError, also for nan and infinity."""
    if isinstance(value, dict):
        odd = [key for key in value if not isinstance(key, str)]
        if odd:
            raise ValueError(f"expected text as a key, got {odd[0]!r}")
        strict_json(list(value.values()))
    elif isinstance(value, (list, tuple)):
        for item in value:
            strict_json(item)
    elif isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"expected finite numbers, got {value}")
    elif not (value is None or isinstance(value, (bool, int, float, str))):
        raise ValueError(f"expected text, numbers, or lists and tables of these, got a {type(value).__name__}")
    return value


StrictJson: TypeAlias = Annotated[dict[str, Any], AfterValidator(strict_json)]


class Manifest(BaseModel):
    """Content of ``<artefact>.json``: kind, origin, parameters, learned values and the digest of the tensors.

    Unknown keys are refused.
    """

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    schema_: Literal["sysid-evo/artefact/4"] = SCHEMA
    kind: Literal["model", "controller"]
    name: str
    module: str
    parameters: StrictJson
    learned: StrictJson
    system: StrictJson | None
    seed: int | None
    data: str | None
    versions: dict[str, str]
    timings: dict[str, float] = {}
    tensors: dict[str, list[int]]
    sha256: str


def write_artefact(path: Path, tensors: dict[str, np.ndarray[Any, Any]], fields: dict[str, Any]) -> Path:
    """Write ``<path>.safetensors`` and ``<path>.json``; return the path of the manifest.

    Raises `InvalidArgument`, before anything is written, if JSON cannot hold one of ``fields``.
    """
    tensors = {name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()}
    payload = save(tensors)
    try:
        manifest = Manifest(
            versions=versions(),
            tensors={name: list(tensor.shape) for name, tensor in tensors.items()},
            sha256=hashlib.sha256(payload).hexdigest(),
            **fields,
        )
    except ValidationError as error:
        raise InvalidArgument(f"{path}: cannot be stored: {_first(error)}") from error
    text = manifest.model_dump_json(indent=1)
    write_atomically(_with(path, ".safetensors"), lambda temporary: temporary.write_bytes(payload))
    return write_atomically(_with(path, ".json"), lambda temporary: temporary.write_text(text))


def stored_file(path: str | Path, kind: Literal["model", "controller"]) -> Path:
    """Return the manifest named by ``path``; in a run folder the digest in the file's name may be left out.

    ``models/linear`` or ``models/linear.json`` is ``models/linear-0123abcd.json`` if there is only one. A path without
    a file is returned unchanged. Raises `ArtefactError` if there are several, or if the path has no name.
    """
    path = Path(path)
    stem = path.with_suffix("").name if path.suffix in SUFFIXES else path.name
    named = _with(path, ".json")
    digest = re.compile(rf"{re.escape(stem)}-[0-9a-f]{{8}}\.json")
    folder = path.parent if not named.is_file() and path.parent.is_dir() else None
    found = [] if folder is None else sorted(file for file in folder.iterdir() if digest.fullmatch(file.name))
    if len(found) > 1:
        raise ArtefactError(
            f"{named}: expected the file of one {kind}, found {', '.join(file.name for file in found)}: name one"
        )
    return found[0] if found else named


def is_stored_artefact(name: str, kind: Literal["model", "controller"]) -> bool:
    """Whether ``name`` is the path of a stored artefact rather than a registered name."""
    return Path(name).suffix in SUFFIXES or (bool(Path(name).name) and stored_file(name, kind).is_file())


LISTED = 6
"""Largest number of stored files that a message names."""


def _stored_nearby(source: Path, kind: str) -> str:
    """Return a hint with the stored artefact that has nearly this name, or with those in the folder or run folder."""
    named = source.with_suffix("")
    folder = named if named.is_dir() else source.parent
    folder = folder / f"{kind}s" if (folder / f"{kind}s").is_dir() else folder
    stored = sorted({re.sub(r"-[0-9a-f]{8}$", "", file.stem) for file in folder.glob("*.safetensors")})
    close = "" if named.is_dir() else closest(source.stem, stored, cutoff=0.5)
    if close or not stored:
        return f". Did you mean {close}?" if close else ""
    more = ", ..." if len(stored) > LISTED else ""
    return f". There are {', '.join(str(folder / name) for name in stored[:LISTED])}{more}"


def read_artefact(path: Path, kind: Literal["model", "controller"]) -> tuple[Manifest, dict[str, np.ndarray[Any, Any]]]:
    """Return manifest and tensors of the artefact that `stored_file` finds.

    Raises `ArtefactError` with the reason if one of them is missing, damaged or of another version.
    """
    path = stored_file(path, kind)
    source, target = _with(path, ".json"), _with(path, ".safetensors")
    if not source.exists() and not target.exists():
        raise ArtefactError(f"{source}: no {kind} is stored there{_stored_nearby(source, kind)}")
    for file in (source, target):
        if not file.is_file():
            raise ArtefactError(f"{file}: expected one half of a stored {kind}, found no such file")
    if source.stat().st_size > MAX_MANIFEST_BYTES:
        raise ArtefactError(f"{source}: a manifest has at most {MAX_MANIFEST_BYTES} bytes, this is larger")
    try:
        manifest = Manifest.model_validate_json(source.read_bytes())
    except ValidationError as error:
        raise ArtefactError(f"{source}: not a manifest of schema {SCHEMA}: {_first(error)}{_older(error)}") from error
    if manifest.kind != kind:
        raise ArtefactError(f"{source}: expected a stored {kind}, got a {manifest.kind}")
    allowed = MAX_HEADER_BYTES + sum(8 * math.prod(shape) for shape in manifest.tensors.values())
    if target.stat().st_size > min(allowed, MAX_TENSOR_BYTES):
        raise ArtefactError(f"{target}: {target.stat().st_size} bytes are more than the tensors in {source.name} take")
    with target.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    if digest != manifest.sha256:
        raise ArtefactError(f"{target}: its SHA-256 is not the one in {source.name}: damaged, or another file")
    try:
        tensors = load_file(target)
    except (SafetensorError, ValueError, KeyError) as error:
        raise ArtefactError(f"{target}: not a safetensors file: {error}") from error
    shapes = {name: list(tensor.shape) for name, tensor in tensors.items()}
    if shapes != manifest.tensors:
        raise ArtefactError(f"{target}: expected the tensors {manifest.tensors}, got {shapes}")
    return manifest, tensors


def _first(error: ValidationError) -> str:
    """Return key and message of the first fault."""
    first = error.errors()[0]
    return f"{'.'.join(map(str, first['loc'])) or 'the file'}: {first['msg']}"


def _older(error: ValidationError) -> str:
    """Return the remedy for an artefact of another version; empty for other faults."""
    of_schema = any(fault["loc"] == ("schema_",) and fault["type"] == "literal_error" for fault in error.errors())
    return "; it was written by another version of this library: fit or evolve again" if of_schema else ""


def _with(path: Path, suffix: str) -> Path:
    """Return ``path`` with another suffix; other dots in the name remain. Raises `ArtefactError` without a name."""
    stem = path.with_suffix("") if path.suffix in SUFFIXES else path
    if not stem.name:
        raise ArtefactError(f"expected the name of a file, such as runs/mine/models/NAME, got {str(path)!r}")
    return stem.with_name(stem.name + suffix)


CHECKPOINT_SCHEMA: Literal["sysid-evo/checkpoint/3"] = "sysid-evo/checkpoint/3"

CONTENT = "sysid-evo"
SHARE = 0.01
"""Largest share of the time that saving may take."""


class _Content(BaseModel):
    """Header of a checkpoint: the values other than arrays, and the digest.

    ``numbers`` names the arrays that are plain numbers.
    """

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    schema_: Literal["sysid-evo/checkpoint/3"] = CHECKPOINT_SCHEMA
    identity: str
    numbers: list[str]
    others: dict[str, int | str]
    sha256: str


class CheckpointFile:
    """Stores the state of long work in the file ``path``: a `Checkpoint` for `evolve_controller` and for models.

    It is one safetensors file, written atomically. It is saved every ``every`` s, less often if saving takes more than
    one per cent of the time. A damaged file, or one of other work, is ignored with a `CheckpointWarning`. If a file
    cannot be written, for example on a full disk, there is such a warning too, and the work continues.
    """

    def __init__(self, path: str | Path, *, every: float = 1.0) -> None:
        if not every >= 0.0:
            raise InvalidArgument(f"checkpoint: expected every >= 0 s, got {every}")
        self.path, self.every = Path(path), every
        self._saved = time.monotonic()
        self._took = 0.0
        self._fails = False

    def load(self, identity: str) -> CheckpointState | None:
        """Return the state saved with this ``identity``, or None."""
        if not self.path.is_file():
            return None
        try:
            owner, state = read_checkpoint(self.path)
        except ArtefactError as error:
            warnings.warn(f"{error}; it is ignored, and everything is computed again", CheckpointWarning, stacklevel=2)
            return None
        if owner != identity:
            warnings.warn(
                f"{self.path}: a checkpoint of other work (other models, settings, seed, engine or versions); it is "
                "ignored, and everything is computed again",
                CheckpointWarning,
                stacklevel=2,
            )
            return None
        return state

    def due(self) -> bool:
        """Whether it is time to save again."""
        return time.monotonic() - self._saved >= max(self.every, self._took / SHARE)

    def save(self, identity: str, state: CheckpointState) -> None:
        """Replace the saved state by ``state``; if that fails, warn once and keep the old file."""
        began, failed = time.monotonic(), self._fails
        try:
            write_checkpoint(self.path, identity, state)
            self._fails = False
        except OSError as error:  # results are smaller than checkpoints, and may still fit
            self._fails = True
            if not failed:
                warnings.warn(
                    f"{self.path}: cannot be written ({error.strerror or error}). The work continues; if it is "
                    "interrupted now, it resumes from the previous checkpoint",
                    CheckpointWarning,
                    stacklevel=2,
                )
        self._saved = time.monotonic()
        self._took = self._saved - began


def write_checkpoint(path: Path, identity: str, state: CheckpointState) -> None:
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


def read_checkpoint(path: Path) -> tuple[str, CheckpointState]:
    """Return identity and state in the file ``path``. Raises `ArtefactError` if it is not a valid checkpoint."""
    try:
        with safe_open(path, framework="numpy") as file:
            content = _Content.model_validate_json((file.metadata() or {})[CONTENT])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  # not a mapping
    except (SafetensorError, OSError, KeyError, ValueError, TypeError) as error:
        reason = str(error).partition("\n")[0]
        raise ArtefactError(f"{path}: expected a checkpoint, but it cannot be read ({reason})") from error
    if _digest(tensors, content) != content.sha256:
        raise ArtefactError(f"{path}: expected a checkpoint, but it is damaged: its SHA-256 differs")
    plain = {name: float(value) if name in content.numbers else value for name, value in tensors.items()}
    return content.identity, {**plain, **content.others}


def _digest(tensors: dict[str, np.ndarray[Any, Any]], content: _Content) -> str:
    """Return the SHA-256 of the content of a checkpoint."""
    rest = json.dumps([content.identity, content.numbers, content.others], sort_keys=True)
    return hashlib.sha256(save(tensors) + rest.encode()).hexdigest()
