"""The version of this project, and those of the libraries recorded with results."""

from __future__ import annotations

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version

__version__ = "0.1.0"

RECORDED = ("sysid-evo", "numpy", "scipy", "scikit-learn")


def versions() -> dict[str, str]:
    """Return the versions of Python and of the libraries whose results are stored."""
    return {"python": platform.python_version(), **{name: _installed(name) for name in RECORDED}}


@cache  # a file is read for each, and every cell of a plan is stored with them
def _installed(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
