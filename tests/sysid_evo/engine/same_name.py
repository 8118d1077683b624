"""A second module with functions called as those of the dialect's tests."""

from __future__ import annotations

from tests.sysid_evo.engine import other_name


def helper(x):  # type: ignore[no-untyped-def]  # read by Numba
    """Ten times what a function of the same name in a third module says."""
    return 10.0 * other_name.helper(x)
