"""Where files are kept, and how they are written: a crash leaves the old one or the new one, never half of one."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path


def cache_folder(kind: str) -> Path:
    """Return where compiled things of this ``kind`` are kept from run to run (``SYSID_EVO_CACHE`` overrides it)."""
    base = os.environ.get("SYSID_EVO_CACHE") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "sysid-evo" / kind


def state_folder(kind: str) -> Path:
    """Return where this user's decisions of this ``kind`` are kept (below ``XDG_STATE_HOME``, if it is set)."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "sysid-evo" / kind


def write_atomically(path: Path, write: Callable[[Path], object]) -> Path:
    """Let ``write`` fill a temporary file beside ``path``, sync it, and rename it to ``path``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        write(temporary)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    return path
