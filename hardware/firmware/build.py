"""Compiles the firmware's protocol core into a shared library of the host."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from pathlib import Path

from sysid_evo.errors import InvalidArgument
from sysid_evo.files import cache_folder, write_atomically

FOLDER = Path(__file__).parent
SOURCES = (FOLDER / "rcb.h", FOLDER / "rcb.c")
FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion")


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
    """Return the compiled core, from the cache if the same sources were compiled before.

    Raises `InvalidArgument` if there is no compiler or it fails.
    """
    digest = hashlib.sha256("\0".join(FLAGS).encode())
    for source in SOURCES:
        digest.update(source.read_bytes())
    library = cache_folder("firmware") / f"librcb-{digest.hexdigest()[:24]}.so"
    if not library.is_file():
        write_atomically(library, lambda path: compile_c([SOURCES[1]], path, (*FLAGS, "-shared", "-fPIC")))
    return library


def compile_c(sources: list[Path], out: Path, flags: tuple[str, ...]) -> None:
    """Compile C ``sources``, which may include ``rcb.h``, into the file ``out``. Raises `InvalidArgument`."""
    command = [compiler(), *flags, f"-I{FOLDER}", "-o", str(out), *map(str, sources)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise InvalidArgument(f"{' '.join(command)} failed:\n{done.stderr.strip()}")
