"""Evolved controllers on disk."""

from __future__ import annotations

from pathlib import Path

from sysid_evo.errors import ArtefactError, InvalidArgument, ShapeError
from sysid_evo.evolution import Champion
from sysid_evo.store.manifest import read_artefact, stored_file, write_artefact


def save_champion(champion: Champion, path: str | Path, *, data: str | None = None) -> Path:
    """Write ``<path>.safetensors`` and ``<path>.json``; return the path of the manifest."""
    learned = champion.to_dict()
    fields = {
        "kind": "controller",
        "name": champion.controller.name,
        "module": Champion.__module__,
        "parameters": dict(champion.controller.parameters),
        "system": learned.pop("system"),
        "learned": learned,
        "seed": champion.seed,
        "data": data,
    }
    return write_artefact(Path(path), champion.tensors, fields)


def load_champion(path: str | Path) -> Champion:
    """Read what `save_champion` wrote, see `stored_file`. Raises `ArtefactError`."""
    path = stored_file(path, "controller")
    manifest, tensors = read_artefact(path, "controller")
    try:
        found = {**manifest.learned, "system": manifest.system}
        return Champion.from_dict(found, tensors)
    except (KeyError, TypeError, ValueError, ShapeError, InvalidArgument) as error:
        older = "; another version of this library wrote it: evolve again" if isinstance(error, KeyError) else ""
        raise ArtefactError(f"{path}: not a stored controller: {type(error).__name__}: {error}{older}") from error
