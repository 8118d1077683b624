"""Compiles the firmware's protocol core into a shared library of the host."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from pathlib import Path

import hardware
from sysid_evo.errors import InvalidArgument
from sysid_evo.files import cache_folder, write_atomically

FOLDER = Path(hardware.__file__).parent / "firmware"
SOURCES = (FOLDER / "rcb.h", FOLDER / "rcb.c")
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion")


def compiler() -> str:
    """Return the C compiler: the one that ``CC`` names, else cc or gcc. Raises `InvalidArgument` if there is none."""
    names = [os.environ["CC"]] if "CC" in os.environ else ["cc", "gcc"]
    for name in names:
        found = shutil.which(name)
        if found is not None:
            return found
    raise InvalidArgument(
        f"firmware core: expected a C compiler ({' or '.join(names)}), found none; install gcc or set CC"
    )


def build_core() -> Path:
    """Return the core as a shared library. Raises `InvalidArgument` if there is no compiler or it fails."""
    return build_c("rcb.so", (), ("-O2", "-shared", "-fPIC"))


def build_c(name: str, sources: tuple[Path, ...], flags: tuple[str, ...], libraries: tuple[str, ...] = ()) -> Path:
    """Return the core and further C ``sources`` compiled into one file called ``name`` in the cache.

    Nothing is compiled twice from equal sources. Raises `InvalidArgument`.
    """
    command = [compiler(), *WARNINGS, *flags, f"-I{FOLDER}"]
    digest = hashlib.sha256("\0".join([*command, *libraries]).encode())
    for source in (*SOURCES, *sources):
        digest.update(source.read_bytes())
    out = cache_folder("firmware") / digest.hexdigest()[:24] / name
    if not out.is_file():
        inputs = [str(SOURCES[1]), *map(str, sources), *libraries]
        write_atomically(out, lambda path: _run([*command, "-o", str(path), *inputs]))
    return out


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise InvalidArgument(f"{' '.join(command)} failed:\n{done.stderr.strip()}")
