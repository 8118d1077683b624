"""Evolved controllers on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sysid_evo.errors import ArtefactError, ShapeError
from sysid_evo.evolution import Champion
from sysid_evo.store.manifest import read_artefact, write_artefact


def save_champion(champion: Champion, path: str | Path, *, data: str | None = None) -> Path:
    """Write ``<path>.safetensors`` and ``<path>.json``; return the path of the manifest."""
    learned = {
        "name": champion.name,
        "against": list(champion.against),
        "aggregate": champion.aggregate,
        "task": champion.task,
        "task_parameters": dict(champion.task_parameters),
        "estimator_delay": champion.estimator_delay,
    }
    fields = {
        "kind": "controller",
        "name": champion.controller,
        "module": Champion.__module__,
        "parameters": dict(champion.controller_parameters),
        "learned": learned,
        "system": None,
        "seed": champion.seed,
        "data": data,
    }
    return write_artefact(Path(path), {"parameters": champion.parameters, "history": champion.history}, fields)


def load_champion(path: str | Path) -> Champion:
    """Read what `save_champion` wrote. Raises `ArtefactError`."""
    path = Path(path)
    manifest, tensors = read_artefact(path, "controller")
    learned = manifest.learned
    try:
        return Champion(
            name=learned["name"],
            parameters=tensors["parameters"].astype(np.float64),
            against=tuple(learned["against"]),
            aggregate=learned["aggregate"],
            seed=manifest.seed or 0,
            history=tensors["history"],
            controller=manifest.name,
            controller_parameters=manifest.parameters,
            task=learned["task"],
            task_parameters=learned["task_parameters"],
            estimator_delay=learned.get("estimator_delay", 0.0),
        )
    except (KeyError, TypeError, ShapeError) as error:
        raise ArtefactError(f"{path}: not a stored controller: {type(error).__name__}: {error}") from error
