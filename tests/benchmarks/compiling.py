"""List the kernels that a command compiles: ``python -m tests.benchmarks.compiling sysid-evo compare --preset quick``.

The command is run with an empty cache. For each kernel it prints the seconds of compilation, lines, precision and
functions. The last line is the processor time of the whole command in s.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table


@dataclass(frozen=True)
class Compiled:
    """A kernel in the cache."""

    origin: str
    precision: str
    lines: int
    functions: str
    seconds: float


def compiled(cache: Path) -> list[Compiled]:
    """Return the kernels of a cache, those that took longest first."""
    found = [_read(path) for path in cache.glob("sysid-evo/kernels/sysid_evo_kernel_*.py")]
    return sorted(found, key=lambda kernel: -kernel.seconds)


def _read(path: Path) -> Compiled:
    text = path.read_text(encoding="utf-8")
    ready = [file.stat().st_mtime for file in path.parent.glob(f"__pycache__/{path.stem}.*.nbc")]
    precision = re.search(r"float(32|64) as _real", text)
    names = [re.sub(r"_\d+$", "", name) for name in re.findall(r"^def (\w+)", text, re.MULTILINE)]
    return Compiled(
        origin=text.split("from ", 1)[1].split(";", 1)[0],
        precision=precision.group(1) if precision else "",
        lines=text.count("\n"),
        functions=", ".join(dict.fromkeys(name for name in names if name != "entry")),
        seconds=max(ready) - path.stat().st_mtime,
    )


def main() -> None:
    """Run the command and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("command", nargs=argparse.REMAINDER)
    command = parser.parse_args().command
    with tempfile.TemporaryDirectory() as cache:
        done = subprocess.run(command, env={**os.environ, "SYSID_EVO_CACHE": cache}, check=False)
        kernels = compiled(Path(cache))
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    table = Table("s", "lines", "bits", "kernel", "made of")
    for kernel in kernels:
        table.add_row(f"{kernel.seconds:.1f}", str(kernel.lines), kernel.precision, kernel.origin, kernel.functions)
    compiling = sum(kernel.seconds for kernel in kernels)
    console = Console()
    console.print(table)
    console.print(f"{len(kernels)} kernels in {compiling:.0f} s; {used.ru_utime + used.ru_stime:.0f} processor seconds")
    sys.exit(done.returncode)


if __name__ == "__main__":
    main()
