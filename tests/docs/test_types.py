"""What the pages show passes ``mypy --strict``, as in a project that uses the package; what they warn of does not."""

import sys
from pathlib import Path

from mypy import api

from tests.docs.page import PAGES, ROOT

STRICTER = "# mypy: warn-return-any, no-warn-unreachable\n"
"""What ``mypy --strict`` asks of a user beyond our own settings."""
WITHOUT_TYPES = """
[[tool.mypy.overrides]]
module = ["recommended"]
ignore_missing_imports = true
"""
"""An exported file."""
HAS = """
import numpy as np
import pandas as pd

states: np.ndarray
controls: np.ndarray
frame: pd.DataFrame
"""
"""The arrays and the table that a reader of some pages has already, see `test_pages.given`."""
WRONG = """
from evaluation import compare
from sysid_evo import Dataset, System, make_model

data = Dataset.from_arrays(System(["x"], ["u"], dt=0.1), [0.0, 1.0], [0.0])
compare(data, generatons=3)
compare(data, generations="three")
make_model("linear").fit(data, rng="seed")
System(1, ["u"], dt=0.1)
"""


def errors_in(folder, texts):
    """Return the file, line and text of each error that mypy finds in these modules.

    Our settings and our cache, which `make lint` fills, so that the product is not checked again.
    """
    (folder / "mypy.toml").write_text((ROOT / "pyproject.toml").read_text() + WITHOUT_TYPES)
    for name, text in texts.items():
        (folder / f"{name}.py").write_text(STRICTER + text)
    options = [
        "--config-file",
        str(folder / "mypy.toml"),
        "--cache-dir",
        str(ROOT / ".mypy_cache"),
        "--no-error-summary",
    ]
    said, failed, _ = api.run(
        [*options, "--python-executable", sys.executable, *(str(folder / f"{name}.py") for name in texts)]
    )
    assert not failed, failed
    lines = [line.split(":", 2) for line in said.splitlines() if ": note:" not in line]
    return [(Path(file).name, int(line), text) for file, line, text in lines]  # the cache remembers another folder


def test_the_python_of_all_pages_passes_a_strict_type_checker(tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    texts = {"has": HAS, "wrong": WRONG}
    for page in PAGES.values():
        if page.blocks("python"):
            text = page.program()
            if "states, controls)" in text:
                text = text.replace("\n", "from has import controls, frame, states\n", 1)
            texts[f"page_{page.identifier}"] = text
    found = errors_in(tmp_path, texts)
    assert [(file, line) for file, line, _ in found] == [("wrong.py", line) for line in (7, 8, 9, 10)], found
