"""Cache and state folders, reading of TOML, atomic writing of files."""

from __future__ import annotations

import hashlib
import os
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any


def cache_folder(kind: str) -> Path:
    """Return the folder of compiled code of this ``kind`` (``SYSID_EVO_CACHE`` overrides it)."""
    base = os.environ.get("SYSID_EVO_CACHE") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "sysid-evo" / kind


def state_folder(kind: str) -> Path:
    """Return the folder of the user's decisions of this ``kind`` (in ``XDG_STATE_HOME``, if it is set)."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "sysid-evo" / kind


def file_digest(path: str) -> str:
    """Return the SHA-256 digest of a file, "" if there is none."""
    try:
        with Path(path).expanduser().open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return ""


DEEPEST, LONGEST = 12, 2**20
"""Largest depth of nested tables and lists (readers are recursive), and of characters, of a TOML file."""


def parsed_toml(text: str) -> dict[str, Any]:
    """Return the content of a TOML text. Raises ValueError with the reason if it cannot be read."""
    if len(text) > LONGEST:
        raise ValueError(f"expected at most {LONGEST} characters, got {len(text)}")
    too_deep = f"expected at most {DEEPEST} nested tables and lists, got more"
    try:
        found = tomllib.loads(text)
    except RecursionError:
        raise ValueError(too_deep) from None
    inside: list[Any] = [found]
    for _ in range(DEEPEST):
        parts = [item for one in inside for item in (one.values() if isinstance(one, dict) else one)]
        inside = [item for item in parts if isinstance(item, (dict, list))]
    if inside:
        raise ValueError(too_deep)
    return found


def write_atomically(path: Path, write: Callable[[Path], object]) -> Path:
    """Write a temporary file with ``write``, sync it, and rename it to ``path``, which a crash cannot damage."""
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
