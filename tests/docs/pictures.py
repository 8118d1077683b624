"""Makes the pictures of the tutorials, by the commands of their text: ``python -m tests.docs.pictures [PAGE ...]``.

Each page is run as it stands, with the budget that it names, in an empty folder. What it shows as ``RUN-FIGURE.svg`` is
a figure that ``sysid-evo report runs/RUN --format svg`` has written there, and goes to ``docs/images``. Some minutes a
page. Without a name all tutorials with pictures are run.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.docs.blocks import PAGES
from tests.docs.running import picture, run_page, shown_on


def main(arguments: Sequence[str]) -> int:
    """Make the pictures of these pages, and return the exit code."""
    os.environ["COLUMNS"] = "80"
    for page in arguments or [page for page in PAGES if shown_on(page)]:
        with tempfile.TemporaryDirectory(prefix="sysid-evo-pictures-") as name:
            folder = Path(name)
            for said in run_page(page, folder, {}):
                sys.stdout.write(f"$ {said.line}\n{said.printed}\n")
            for run, figure in shown_on(page):
                shutil.copyfile(folder / "runs" / run / "figures" / f"{figure}.svg", picture(run, figure))
                sys.stdout.write(f"{picture(run, figure)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
