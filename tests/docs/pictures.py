"""Makes the pictures of the tutorials and of the README: ``python -m tests.docs.pictures [PAGE ...]``.

Each tutorial is run as it stands, with the budget that it names, in an empty folder. What it shows as
``RUN-FIGURE.svg`` is a figure that ``sysid-evo report runs/RUN --format svg`` has written there, and goes to
``docs/images``. What the README shows is the first screen of the report of ``COMPARISON``, in Chromium. Some minutes a
page. Without a name the README and all tutorials with pictures are run.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from tests.docs.page import IMAGES, PAGES, picture
from tests.fixtures.commands import run_here

README = "README.md"
COMPARISON = ("compare", "--preset", "quick", "--seed", "0")
"""The command whose report the README shows."""
REPORT = IMAGES / "report.png"
SCREEN = 985, 900
"""Width and height of the first screen in pixels."""
COLOURS = 64
"""As many are enough for text and make a third of the bytes."""


def main(arguments: Sequence[str]) -> int:
    """Make the pictures of these pages, and return the exit code."""
    os.environ["COLUMNS"] = "80"
    for page in arguments or [README, *(name for name, page in PAGES.items() if page.pictures)]:
        with tempfile.TemporaryDirectory(prefix="sysid-evo-pictures-") as name:
            made = of_readme(Path(name)) if page == README else of_page(page, Path(name))
        for file in made:
            sys.stdout.write(f"{file}\n")
    return 0


def of_page(page: str, folder: Path) -> list[Path]:
    """Run a page in ``folder``, print what it says, and return its pictures."""
    for printed in PAGES[page].visit(folder, {}):
        sys.stdout.write(f"$ {printed.line}\n{printed.text}\n")
    made = []
    for run, figure in PAGES[page].pictures:
        shutil.copyfile(folder / "runs" / run / "figures" / f"{figure}.svg", picture(run, figure))
        made.append(picture(run, figure))
    return made


def of_readme(folder: Path) -> list[Path]:
    """Run the comparison of the README in ``folder``, and return the picture of its report."""
    done = run_here(*COMPARISON, "--out", "report", cwd=folder)
    if done.returncode != 0:
        raise RuntimeError(f"sysid-evo {' '.join(COMPARISON)} ended with {done.returncode}: {done.stderr}")
    sys.stdout.write(f"$ sysid-evo {' '.join(COMPARISON)}\n{done.stdout}\n")
    first_screen(folder / "report" / "report.html", REPORT)
    return [REPORT]


def first_screen(page: Path, file: Path) -> None:
    """Write what Chromium first shows of ``page`` as a PNG. Raises `FileNotFoundError` without a Chromium."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        raise FileNotFoundError("no chromium is installed, which takes the picture of the report")
    with tempfile.TemporaryDirectory(prefix="sysid-evo-chromium-") as profile:
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={profile}"]
        size = "--window-size={},{}".format(*SCREEN)
        command = [chromium, *options, size, f"--screenshot={file}", page.resolve().as_uri()]
        subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=60.0, check=True)
    fewer_colours(file)


def fewer_colours(png: Path) -> None:
    """Write a picture again with at most ``COLOURS``."""
    with Image.open(png) as whole:
        whole.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(png, optimize=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
