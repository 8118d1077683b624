"""These tests run in Numba's simulator of CUDA, in a process of their own: see `test_simulator`."""

from __future__ import annotations

import os

if os.environ.get("NUMBA_ENABLE_CUDASIM") != "1":
    collect_ignore_glob = ["test_*.py"]
