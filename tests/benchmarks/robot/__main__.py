"""Tests of the robot's fail-safes under faults: ``python -m tests.benchmarks.robot NAME``.

Each test runs an emulated car on a pseudo-terminal, with the firmware compiled from C, and a host with the control loop
in its own process. It prints a table and writes JSON; exit code 1 if a requirement is not fulfilled. ``all`` runs all
tests except the long ones.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from tests.benchmarks.markdown import add_markdown, print_tables
from tests.benchmarks.robot.blinding import blind
from tests.benchmarks.robot.cutting import cut
from tests.benchmarks.robot.killing import kill
from tests.benchmarks.robot.outcome import Row, save, table_of
from tests.benchmarks.robot.pacing import pace_busy, pace_disk, pace_idle
from tests.benchmarks.robot.stopping import stop
from tests.benchmarks.robot.suspending import suspend

REPEATED: dict[str, tuple[Callable[..., list[Row]], int]] = {
    "kill": (kill, 100),
    "stop": (stop, 20),
    "suspend": (suspend, 10),
    "cut": (cut, 50),
    "blind": (blind, 20),
}
LASTING: dict[str, Callable[..., list[Row]]] = {"pace-idle": pace_idle, "pace-busy": pace_busy, "pace-disk": pace_disk}
DURATION = 600.0  # s
SEED = 20070707


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.robot", description=__doc__)
    parser.add_argument("name", choices=[*REPEATED, *LASTING, "all"])
    parser.add_argument("--repeats", type=int, help="instead of the number the test is meant for")
    parser.add_argument("--duration", type=float, default=DURATION, help="of the runs that last, in s")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--json", type=Path, default=Path("robot-stress.json"))
    add_markdown(parser)
    options = parser.parse_args()
    rows: list[Row] = []
    for name in REPEATED if options.name == "all" else [options.name]:
        with tempfile.TemporaryDirectory(prefix="robot-stress-") as folder:
            if name in LASTING:
                rows += LASTING[name](Path(folder), duration=options.duration, seed=options.seed)
            else:
                test, repeats = REPEATED[name]
                rows += test(Path(folder), repeats=options.repeats or repeats, seed=options.seed)
    print_tables([table_of(rows)], options.markdown)
    save(rows, options.json)
    return 0 if all(row.holds for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
