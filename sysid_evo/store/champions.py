"""Evolved controllers on disk."""

from __future__ import annotations

import re
from pathlib import Path

from sysid_evo.errors import ArtefactError, InvalidArgument, ShapeError
from sysid_evo.evolution import Champion
from sysid_evo.store.manifest import read_artefact, write_artefact


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


def champion_file(path: str | Path) -> Path:
    """Return the manifest that ``path`` names: a run's controller may be named without the digest in its file's name.

    So ``controllers/best`` or ``controllers/best.json`` is ``controllers/best-0123abcd.json``, if there is but one.
    Raises `ArtefactError` if there are several; a path of which there is no file comes back.
    """
    path = Path(path)
    stem = path.with_suffix("").name if path.suffix in (".json", ".safetensors") else path.name
    named = path.with_name(f"{stem}.json")
    found = [] if named.is_file() or not path.parent.is_dir() else _of_a_run(path.parent, stem)
    if len(found) > 1:
        raise ArtefactError(
            f"{named}: expected the file of one controller, found {', '.join(file.name for file in found)}: name one"
        )
    return found[0] if found else named


def _of_a_run(folder: Path, name: str) -> list[Path]:
    digest = re.compile(rf"{re.escape(name)}-[0-9a-f]{{8}}\.json")
    return sorted(file for file in folder.iterdir() if digest.fullmatch(file.name))


def load_champion(path: str | Path) -> Champion:
    """Read what `save_champion` wrote, see `champion_file`. Raises `ArtefactError`."""
    path = champion_file(path)
    manifest, tensors = read_artefact(path, "controller")
    try:
        found = {**manifest.learned, "system": manifest.system}
        return Champion.from_dict(found, tensors)
    except (KeyError, TypeError, ValueError, ShapeError, InvalidArgument) as error:
        older = "; another version of this library wrote it: evolve again" if isinstance(error, KeyError) else ""
        raise ArtefactError(f"{path}: not a stored controller: {type(error).__name__}: {error}{older}") from error
