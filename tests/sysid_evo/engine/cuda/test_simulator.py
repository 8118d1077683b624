"""The tests of the device, in Numba's simulator: it must be chosen before `numba.cuda` is imported."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


def test_rollouts_on_a_simulated_device_are_those_of_the_processor(request: pytest.FixtureRequest) -> None:
    pytest.importorskip("numba_cuda", reason="needs numba-cuda: pip install 'sysid-evo[dev]'")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(Path(__file__).parent / "simulated")]
    done = subprocess.run(
        [*command, *(["--slow"] if request.config.getoption("--slow") else [])],
        env={**os.environ, "NUMBA_ENABLE_CUDASIM": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
