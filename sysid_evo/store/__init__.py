"""Artefacts on disk: safetensors and a strict JSON manifest; nothing is ever unpickled."""

from sysid_evo.store.champions import champion_file, load_champion, save_champion
from sysid_evo.store.checkpoints import CheckpointFile
from sysid_evo.store.manifest import versions
from sysid_evo.store.models import family_name, load_model, save_model

__all__ = [
    "CheckpointFile",
    "champion_file",
    "family_name",
    "load_champion",
    "load_model",
    "save_champion",
    "save_model",
    "versions",
]
