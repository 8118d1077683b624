"""The innermost of three functions of one name."""

from __future__ import annotations


def helper(x):  # type: ignore[no-untyped-def]  # read by Numba
    """One more."""
    return x + 1.0
