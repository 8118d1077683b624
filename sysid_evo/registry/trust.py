"""Whether Python that a stored file names may run: only what this user has run here before, unchanged since.

SECURITY.md states the rule for every kind of file. A user's folder holds one small file for each plugin that was run:
its SHA-256 and its path.
"""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from pathlib import Path

from sysid_evo.files import state_folder, write_atomically


def remember(plugin: Path, source: bytes) -> None:
    """Note that the user has asked for the file ``plugin``, an absolute path, while it held ``source``."""
    if distrust(plugin, source):
        line = hashlib.sha256(source).hexdigest().encode() + b"  " + os.fsencode(plugin) + b"\n"
        with suppress(OSError):  # in a home that cannot be written nothing is remembered: it is asked for again
            write_atomically(_note(plugin), lambda file: file.write_bytes(line))


def distrust(plugin: Path, source: bytes) -> str:
    """Return why ``plugin`` may not run unless the user asks for it; empty if it may."""
    try:
        known = _note(plugin).read_bytes().split(b" ")[0].decode(errors="replace")
    except OSError:
        return "has not run here yet"
    return "" if known == hashlib.sha256(source).hexdigest() else "has changed since it ran here"


def _note(plugin: Path) -> Path:
    # by path as well as by content: the same text elsewhere may read or import other files beside it
    return state_folder("plugins") / hashlib.sha256(os.fsencode(plugin)).hexdigest()
