"""These tests run in Numba's simulator of CUDA, in a process of their own: see `test_simulator`."""

from __future__ import annotations

import os

import pytest

if os.environ.get("NUMBA_ENABLE_CUDASIM") != "1":
    collect_ignore_glob = ["test_*.py"]


@pytest.fixture(autouse=True)
def small_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """A device of one multiprocessor, so that few rollouts share a block."""
    from sysid_evo.engine.cuda import run

    monkeypatch.setattr(run, "MULTIPROCESSORS", 1)
