"""What the tests of the command line share: recordings on disk, and a caller."""

from __future__ import annotations

from pathlib import Path

import pytest

from sysid_evo.testing import example_dataset
from tests.fixtures.commands import Caller


@pytest.fixture(scope="session")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a small data set of the made-up car."""
    return example_dataset().save(tmp_path_factory.mktemp("logs") / "car")


@pytest.fixture
def call(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Caller:
    """Calls the command line in this process, in the test's own folder."""
    return Caller(tmp_path, capsys)
