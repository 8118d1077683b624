"""What is sent from one run folder to another: files as they stand, and when they were written."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TypeAlias

from sysid_evo.errors import ArtefactError
from sysid_evo.files import write_atomically

Parcel: TypeAlias = tuple[tuple[str, int, bytes], ...]
"""Files by their path below a folder: path, time of the last change in ns (what is older comes first), content."""


def packed(folder: Path, names: Iterable[str]) -> Parcel:
    """Return the files called ``names`` below ``folder``. Raises OSError if one is not there."""
    files = ((name, folder / name) for name in names)
    return tuple((name, file.stat().st_mtime_ns, file.read_bytes()) for name, file in files)


def unpack(parcel: Parcel, folder: Path) -> list[Path]:
    """Write the files of ``parcel`` below ``folder``, and return them. Raises `ArtefactError` for one outside it."""
    written = []
    for name, time, content in parcel:
        if not is_inside(name):
            raise ArtefactError(f"{name} lies outside the folder that it is sent to")
        file = write_atomically(folder / name, partial(Path.write_bytes, data=content))
        os.utime(file, ns=(time, time))
        written.append(file)
    return written


def is_inside(name: str) -> bool:
    """Whether a relative path stays below the folder that it is relative to."""
    path = Path(name)
    return not path.is_absolute() and ".." not in path.parts


def digest_of(parcel: Parcel) -> str:
    """Return the SHA-256 of all that a parcel holds."""
    digest = hashlib.sha256()
    for name, time, content in parcel:
        digest.update(f"{name}\0{time}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()
