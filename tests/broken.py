"""What the tests of the conformance kits ask of verdicts."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from sysid_evo.testing import CheckResult


def broken(results: Iterable[CheckResult]) -> dict[str, str]:
    """The broken sentences of ``results``, with the reasons."""
    return {result.sentence: result.failure for result in results if result.failure is not None}


def sentence(check: Callable[..., Any]) -> str:
    """The sentence of ``check``."""
    assert check.__doc__ is not None
    return check.__doc__.strip()
