"""Commands that the robot accepts from a line that damages bytes: ``python -m tests.benchmarks.link``.

The compiled firmware core receives commands with randomly replaced bytes, including delimiters. A wrong command is an
accepted command that differs in any field from all commands that were sent. The table also shows the number of damaged
frames that pass the checksum, which other checks must reject, and of intact frames after an intact delimiter that were
not accepted.
"""

from __future__ import annotations

import argparse
import subprocess
from dataclasses import dataclass, fields
from pathlib import Path

from rich.table import Table

from tests.benchmarks.markdown import add_markdown, print_tables
from tests.system.rig.build import build_c

SOURCE = Path(__file__).with_name("corruption.c")
RATES = (0.001, 0.01, 0.1)


@dataclass(frozen=True)
class Damage:
    """Counts over one run: frames, of these damaged, accepted, and what the docstring of the module names.

    ``passed`` the checksum though damaged; ``wrong`` were accepted, of these ``wrong_buttons`` with
    other buttons; ``missed`` were intact and refused; ``sessions`` were opened because the robot tripped.
    """

    frames: int
    damaged: int
    accepted: int
    passed: int
    wrong: int
    wrong_buttons: int
    missed: int
    sessions: int


def damage(frames: int, rate: float, seed: int) -> Damage:
    """Send ``frames`` commands over a wire that replaces each byte with probability ``rate``."""
    program = build_c("corruption", (SOURCE,), ("-O2",))
    done = subprocess.run([program, str(frames), str(rate), str(seed)], capture_output=True, text=True, check=True)
    return Damage(frames, *map(int, done.stdout.split()))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=10**7, help="for each rate")
    parser.add_argument("--seed", type=int, default=1)
    add_markdown(parser)
    arguments = parser.parse_args()
    found = [damage(arguments.frames, rate, arguments.seed) for rate in RATES]
    table = Table("bytes damaged", *(f"{rate:.1%}" for rate in RATES))
    for field in fields(Damage):
        table.add_row(field.name.replace("_", " "), *(f"{getattr(one, field.name):,}" for one in found))
    print_tables([table], arguments.markdown)


if __name__ == "__main__":
    main()
