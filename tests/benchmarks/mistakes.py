"""How long a user waits for the error after a mistake: ``python -m tests.benchmarks.mistakes``.

Each command runs in its own process, ``--times`` times (3). The table shows the mistake, the exit code, the median of
the wall time and of the processor time in s; on a busy machine the processor time is the better measure. Exit code 1 if
a command takes 3 s of processor time or more, has another exit code than 2, or writes, changes or removes a file.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import sys
import tempfile
import time
from pathlib import Path

from tests.fixtures.commands import run
from tests.fixtures.mistakes import MISTAKES, Mistake, prepare

LIMIT = 3.0  # s
EXPECTED = 2


def measured(mistake: Mistake, folder: Path, times: int) -> tuple[int, float, float]:
    """Return the exit code, and the medians of seconds and of processor seconds.

    Raises `RuntimeError` for another error message.
    """
    seconds, busy = [], []
    for _ in range(times):
        began, before = time.perf_counter(), processor_seconds()
        done = run(*mistake.arguments, cwd=folder)
        seconds.append(time.perf_counter() - began)
        busy.append(processor_seconds() - before)
        if "".join(mistake.said.split()) not in "".join(done.stderr.split()):
            raise RuntimeError(f"{mistake.what}: expected {mistake.said!r}, got {done.stderr}")
    return done.returncode, statistics.median(seconds), statistics.median(busy)


def processor_seconds() -> float:
    """Return the processor time of all commands that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def content(folder: Path) -> dict[Path, bytes | None]:
    """Return the content of every file in a folder."""
    return {path: path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))}


def main() -> int:
    """Print the table; return 1 if one of the mistakes is not reported as it should be."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=3, help="runs of each command (3)")
    parser.add_argument(
        "--first", type=int, default=len(MISTAKES), help="number of mistakes, from the first (default: all)"
    )
    arguments = parser.parse_args()
    write, wrong = sys.stdout.write, 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        before = content(folder)
        write(f"{'mistake':42} {'code':>4} {'s':>5} {'cpu':>5}   command\n")
        for mistake in MISTAKES[: arguments.first]:
            code, seconds, busy = measured(mistake, folder, arguments.times)
            lost = content(folder) != before
            wrong += code != EXPECTED or busy >= LIMIT or lost
            what = f"{mistake.what:42} {code:4d} {seconds:5.2f} {busy:5.2f}{' CHANGED FILES' if lost else ''}"
            write(f"{what}   sysid-evo {' '.join(mistake.arguments)}\n")
            sys.stdout.flush()
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
