"""Artefacts on disk: safetensors and a strict JSON manifest; nothing is ever unpickled."""

from sysid_evo.store.champions import load_champion, save_champion
from sysid_evo.store.checkpoints import CheckpointFile
from sysid_evo.store.manifest import is_stored, stored_file, versions
from sysid_evo.store.models import family_name, load_model, save_model

__all__ = [
    "CheckpointFile",
    "family_name",
    "is_stored",
    "load_champion",
    "load_model",
    "save_champion",
    "save_model",
    "stored_file",
    "versions",
]
