"""The distribution, built as for a package index, and an environment that holds the wheel without extras."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
PYTHON = os.environ.get("PYTHON", sys.executable)
"""The interpreter that the wheel is tried with; another one is named as for make: ``PYTHON=python3.13``."""


@dataclass(frozen=True)
class Environment:
    """A virtual environment of its own, and a folder outside the checkout that commands run in."""

    folder: Path
    work: Path

    def python(self, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
        """Run its interpreter in the working folder; nothing of this test's own environment is seen there."""
        hidden = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
        return subprocess.run(
            [self.folder / "bin" / "python", *arguments],
            cwd=self.work,
            env={name: value for name, value in os.environ.items() if name not in hidden},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
        )

    def install(self, *requirements: str | Path) -> None:
        """Install with pip from wherever it is configured to look."""
        done = self.python("-m", "pip", "install", "--quiet", "--disable-pip-version-check", *requirements)
        assert done.returncode == 0, done.stderr


def environment(folder: Path) -> Environment:
    """Make an empty virtual environment."""
    subprocess.run([PYTHON, "-m", "venv", folder / "venv"], check=True)
    (folder / "work").mkdir()
    return Environment(folder / "venv", folder / "work")


@pytest.fixture(scope="session")
def project() -> dict[str, Any]:
    """What stands in pyproject.toml."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def builder(tmp_path_factory: pytest.TempPathFactory, project: dict[str, Any]) -> Environment:
    """An environment with what builds the distribution."""
    found = environment(tmp_path_factory.mktemp("builder"))
    found.install(*project["build-system"]["requires"])
    return found


def build(builder: Environment, source: Path, out: Path) -> dict[str, Path]:
    """Build wheel and sdist of the tree ``source``; return them by those names."""
    done = subprocess.run(
        [builder.folder / "bin" / "python", "-m", "hatchling", "build", "-d", out],
        cwd=source,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return {"wheel": next(out.glob("*.whl")), "sdist": next(out.glob("*.tar.gz"))}


@pytest.fixture(scope="session")
def distribution(builder: Environment, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Wheel and sdist of this tree."""
    return build(builder, ROOT, tmp_path_factory.mktemp("distribution"))


@pytest.fixture(scope="session")
def bare(distribution: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Environment:
    """An environment that holds the wheel and what it cannot do without."""
    found = environment(tmp_path_factory.mktemp("bare"))
    found.install("-c", ROOT / "constraints.txt", distribution["wheel"])
    return found
