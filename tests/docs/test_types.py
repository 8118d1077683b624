"""What the pages show passes ``mypy --strict``, as in a project that uses the package; what they warn of does not."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from mypy import api

from tests.docs.blocks import PAGES, blocks, program

PYTHON = [page for page in PAGES if blocks(page, "python")]
SETTINGS = """
[mypy]
strict = true
follow_imports = silent

[mypy-cma.*,sklearn.*,recommended]
ignore_missing_imports = true
"""
"""Of a user: what our own modules do is not their concern; two libraries and an exported file have no types."""
HAS = """
import numpy as np
import pandas as pd

states: np.ndarray
controls: np.ndarray
frame: pd.DataFrame
"""
"""The arrays and the table that a reader of some pages has already, see `test_pages.what_a_user_has`."""
WRONG = """
from evaluation import compare
from sysid_evo import Dataset, System, make_model

data = Dataset.from_arrays(System(["x"], ["u"], dt=0.1), [0.0, 1.0], [0.0])
compare(data, generatons=3)
compare(data, generations="three")
make_model("linear").fit(data, rng="seed")
System(1, ["u"], dt=0.1)
"""


def checked(folder: Path, cache: Path, texts: dict[str, str]) -> list[str]:
    """Return the errors that mypy finds in these modules, with the name of each; the cache makes it quick."""
    (folder / "mypy.ini").write_text(SETTINGS)
    for name, text in texts.items():
        (folder / f"{name}.py").write_text(text)
    options = ["--config-file", str(folder / "mypy.ini"), "--cache-dir", str(cache), "--no-error-summary"]
    said, failed, _ = api.run(
        [*options, "--python-executable", sys.executable, *(str(folder / f"{name}.py") for name in texts)]
    )
    assert not failed, failed
    return [line.removeprefix(f"{folder}/") for line in said.splitlines() if ": note:" not in line]


def test_the_python_of_all_pages_passes_a_strict_type_checker(tmp_path: Path, pytestconfig: pytest.Config) -> None:
    assert pytestconfig.cache is not None
    texts = {"has": HAS}
    for page in PYTHON:
        text, name = program(page), f"page_{page.removesuffix('.md').replace('/', '_').lower()}"
        texts[name] = (
            text.replace("\n", "from has import controls, frame, states\n", 1) if "states, controls)" in text else text
        )
    cache = pytestconfig.cache.mkdir("mypy")
    assert checked(tmp_path, cache, texts) == []
    refused = checked(tmp_path, cache, {"wrong": WRONG})
    assert [line.split(":")[1] for line in refused] == ["6", "7", "8", "9"], refused
