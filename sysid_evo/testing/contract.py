"""Contracts as tables of checks, and helper functions of checks.

A check is a function of the tested object. Its docstring is the rule, and it raises `ContractViolation` with a reason
if the rule is broken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, TypeAlias, TypeVar

import numpy as np

from sysid_evo.errors import ContractViolation, SysidEvoError, described
from sysid_evo.processors import ENGINE_VARIABLE, resolve
from sysid_evo.registry.registry import Registry
from sysid_evo.types import Array, BoolArray

Check: TypeAlias = Callable[..., None]

MADE = "It can be made from its name and parameters"


@dataclass(frozen=True)
class CheckResult:
    """Result of one check: its rule, the reason of a failure or None, the reason if it does not apply (``idle``)."""

    rule: str
    failure: str | None
    idle: str = ""


class NotApplicable(Exception):
    """Raised by a check that does not apply to its subject; the message gives the reason."""


@dataclass(frozen=True)
class Contract:
    """The contract of one kind of plugin: its registry and its checks.

    ``prepare(name, ...)`` makes the arguments of all checks from a registered name, further arguments of the kind, and
    parameters. If the ``decisive`` check fails, later checks are skipped.
    """

    registry: Registry[Any]
    prepare: Callable[..., tuple[Any, ...]]
    checks: tuple[Check, ...]
    decisive: Check | None = None

    def run(self, name: str, *given: Any, **parameters: Any) -> Iterator[CheckResult]:
        """Yield the result of making the plugin ``name``, then the results of all checks that apply.

        If it cannot be made, that is the only result. Errors of this library in the preparation (an unknown name, a
        parameter out of range) are errors of the caller and are raised.
        """
        try:
            subject = self.prepare(name, *given, **parameters)
        except ContractViolation as error:
            yield CheckResult(MADE, str(error))
            return
        except SysidEvoError:
            raise
        except Exception as error:  # a plugin may fail in any way, and the check reports it
            yield CheckResult(MADE, described(error))
            return
        yield CheckResult(MADE, None)
        for check in self.checks:
            with suppress(NotApplicable):
                yield (result := verdict(check, subject))
                if check is self.decisive and result.failure is not None:
                    return

    def check(self, name: str, *given: Any, **parameters: Any) -> None:
        """Raise `ContractViolation` with all rules that the plugin ``name`` breaks, if any."""
        broken = [result for result in self.run(name, *given, **parameters) if result.failure is not None]
        if broken:
            lines = "\n".join(f"- {result.rule}: {result.failure}" for result in broken)
            kind = self.registry.kind
            raise ContractViolation(f"{kind} {name!r} breaks rules of the contract ({len(broken)}):\n{lines}")


def rule_of(check: Check) -> str:
    """Return the rule that ``check`` tests."""
    return (check.__doc__ or check.__name__).strip()


def verdict(check: Check, subject: tuple[Any, ...]) -> CheckResult:
    """Run one check on ``subject`` and return its result. Raises `NotApplicable` only if it has no reason."""
    rule = rule_of(check)
    try:
        check(*subject)
    except NotApplicable as error:
        if not error.args:
            raise
        return CheckResult(rule, None, idle=str(error))
    except ContractViolation as error:
        return CheckResult(rule, str(error))
    except Exception as error:  # a plugin may fail in any way, and the check reports it
        return CheckResult(rule, described(error))
    return CheckResult(rule, None)


def expect(holds: Any, reason: str) -> None:
    """Raise `ContractViolation` with ``reason`` unless ``holds``."""
    if not holds:
        raise ContractViolation(reason)


Result = TypeVar("Result")
Failure = TypeVar("Failure", bound=Exception)


def expect_error(
    kind: type[Failure], when: str, function: Callable[..., Any], *arguments: Any, **options: Any
) -> Failure:
    """Call ``function`` and return the error of this ``kind``. Raises `ContractViolation` if there is none."""
    try:
        function(*arguments, **options)
    except kind as error:
        return error
    raise ContractViolation(f"{when}: expected {kind.__name__}, got no error")


Kernel = TypeVar("Kernel")


def expect_kernel(kernel: Kernel | None) -> Kernel:
    """Return the ``kernel``. Raises `NotApplicable` if it is None, or if `SYSID_EVO_ENGINE` selects the reference."""
    if kernel is None:
        raise NotApplicable("it has no compiled form: Python computes every step")
    if resolve() == "reference":
        raise NotApplicable(f"{ENGINE_VARIABLE} is reference: nothing is compiled")
    return kernel


def expect_numbers(name: str, array: Any, shape: tuple[int, ...]) -> None:
    """Raise `ContractViolation` unless ``array`` holds finite float64 numbers of this shape."""
    if not isinstance(array, np.ndarray):
        raise ContractViolation(f"{name}: expected an array {shape} float64, got {type(array).__name__}")
    sound = array.shape == shape and array.dtype == np.float64
    expect(sound, f"{name}: expected {shape} float64, got {array.shape} {array.dtype}")
    if not np.isfinite(array).all():
        raise ContractViolation(f"{name}: expected finite numbers, got {array[~np.isfinite(array)][0]}")


def expect_pure(name: str, function: Callable[..., Result], *arguments: Any) -> Result:
    """Call ``function`` twice and return the result; reasons use the word ``name``.

    Raises `ContractViolation` if it changes its arguments or gives another result the second time.
    """
    arguments_before = [copied(argument) for argument in arguments]
    first = function(*arguments)
    first_before = copied(first)
    second = function(*arguments)
    expect(all(map(same, arguments, arguments_before)), f"{name} overwrites its arguments")
    expect(same(first_before, first), f"a second {name} overwrites the result of the first")
    expect(same(first, second), f"the same {name} twice gives two results")
    return first


def same(first: Any, second: Any) -> bool:
    """Return whether two results are equal; arrays are compared number by number, and nan equals nan."""
    if isinstance(first, (tuple, list)):
        return len(first) == len(second) and all(map(same, first, second))
    if is_dataclass(first):
        return all(same(getattr(first, item.name), getattr(second, item.name)) for item in fields(first))
    if isinstance(first, np.ndarray):
        return np.array_equal(first, second, equal_nan=first.dtype.kind == "f")
    return bool(first == second)


def copied(value: Any) -> Any:
    """Return ``value`` with copies of its arrays, also those within tuples, lists and dataclasses."""
    if isinstance(value, (tuple, list)):
        return type(value)(map(copied, value))
    if isinstance(value, np.ndarray):
        return value.copy()
    if is_dataclass(value) and not isinstance(value, type):
        made = object.__new__(type(value))
        for item in fields(value):
            object.__setattr__(made, item.name, copied(getattr(value, item.name)))
        return made
    return value


def mismatched_rows(found: Array, expected: Array, tolerance: float) -> BoolArray:
    """Return the rows (B,) that differ by more than ``tolerance`` times (the number + the largest of its column)."""
    size = np.abs(expected)
    return (np.abs(found - expected) > tolerance * (size + size.max(axis=0, initial=0.0))).any(axis=1)


def normal(count: int, rows: int, rng: np.random.Generator | None = None) -> Array | None:
    """Return standard normal numbers (rows, count), None if ``count`` is 0."""
    rng = np.random.default_rng(3) if rng is None else rng
    return rng.standard_normal((rows, count)) if count else None
