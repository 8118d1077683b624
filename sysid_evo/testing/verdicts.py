"""Sentences and verdicts: what every conformance kit is made of.

A kit is a list of checks. A check is a function of what it looks at; its docstring is the sentence
that must hold, and it raises `ContractViolation` with a reason where the sentence is broken.
"""

from __future__ import annotations

import sysconfig
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from sysid_evo.errors import ContractViolation, SysidEvoError

Subject = TypeVar("Subject")
Check: TypeAlias = Callable[[Subject], None]

NOT_THE_PLUGINS = (str(Path(__file__).parents[1]), *(sysconfig.get_path(name) for name in ("stdlib", "purelib")))
"""Folders whose files are nobody's plugin: this package, Python and what is installed beside it."""
MADE = "It is made from its name and parameters"


@dataclass(frozen=True)
class CheckResult:
    """One check: its sentence, and why it failed (None if it holds)."""

    sentence: str
    failure: str | None


class DoesNotApply(Exception):
    """What a check raises whose sentence says nothing about its subject."""


def verdict(check: Callable[..., None], *subject: Any) -> CheckResult:
    """Run one check on ``subject`` and return its result, whatever it raises but `DoesNotApply`."""
    sentence = (check.__doc__ or check.__name__).strip()
    try:
        check(*subject)
    except DoesNotApply:
        raise
    except ContractViolation as error:
        return CheckResult(sentence, str(error))
    except Exception as error:  # a plugin may fail in any way: that is what is being found out
        return CheckResult(sentence, described(error))
    return CheckResult(sentence, None)


def verdicts(make: Callable[[], Subject], checks: Iterable[Check[Subject]]) -> Iterator[CheckResult]:
    """Yield the result of making a subject and of every check that applies to it.

    If it cannot be made, that is the only result. Errors of this library that are raised while it is
    made (an unknown name, a parameter out of range) are the caller's, and are passed on.
    """
    try:
        subject = make()
    except ContractViolation as error:
        yield CheckResult(MADE, str(error))
        return
    except SysidEvoError:
        raise
    except Exception as error:  # a plugin may fail in any way: that is what is being found out
        yield CheckResult(MADE, described(error))
        return
    yield CheckResult(MADE, None)
    for check in checks:
        with suppress(DoesNotApply):
            yield verdict(check, subject)


def raise_broken(kind: str, name: str, results: Iterable[CheckResult]) -> None:
    """Raise `ContractViolation` listing every broken sentence of ``results``, if there is one."""
    broken = [result for result in results if result.failure is not None]
    if broken:
        lines = "\n".join(f"- {result.sentence}: {result.failure}" for result in broken)
        raise ContractViolation(f"{kind} {name!r} breaks {len(broken)} of the contract's sentences:\n{lines}")


def expect(holds: Any, reason: str) -> None:
    """Raise `ContractViolation` with ``reason`` unless ``holds``."""
    if not holds:
        raise ContractViolation(reason)


def described(error: Exception) -> str:
    """Return an error's class and message, and the line of the plugin that raised it or led to it."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if not frame.filename.startswith((*NOT_THE_PLUGINS, "<"))]
    where = f" ({Path(own[-1].filename).name}, line {own[-1].lineno}: {own[-1].line})" if own else ""
    return f"{type(error).__name__}: {error}{where}"
