"""Errors and warnings of the library, suggestions for wrong names, printable text, checks of conflicting settings.

Each error is a `SysidEvoError` and a builtin exception.
"""

from __future__ import annotations

import difflib
import sysconfig
import traceback
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


class SysidEvoError(Exception):
    """The base of all errors of this library."""


class ShapeError(SysidEvoError, ValueError):
    """An array has the wrong shape or type."""


class InvalidSystem(SysidEvoError, ValueError):
    """A channel, a system or a motion is inconsistent."""


class IncompatibleSystem(SysidEvoError, ValueError):
    """A model family cannot describe this system."""


class IncompatibleTask(SysidEvoError, ValueError):
    """A task needs a role that the system lacks."""


class InvalidData(SysidEvoError, ValueError):
    """A recording cannot be used."""


class NotFitted(SysidEvoError, AttributeError):
    """A model was used before `fit`."""


class InvalidArgument(SysidEvoError, ValueError):
    """An argument is out of its range."""


class UnknownParameter(InvalidArgument, TypeError):
    """A constructor has no parameter of this name."""


class UnknownName(SysidEvoError, KeyError):
    """A registry has no entry of this name."""

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""


class RegistrationError(SysidEvoError, ValueError):
    """A name is registered twice, or differs from that of its entry point."""


class PluginError(SysidEvoError, ImportError):
    """A plugin's module cannot be imported."""


class MissingExtra(PluginError):
    """A plugin needs an optional dependency that is not installed."""


class LinkLost(SysidEvoError, ConnectionError):
    """A robot or its tracker is silent, or the connection is closed."""


class SchedulerLost(SysidEvoError, ConnectionError):
    """The scheduler of a cluster does not answer."""


class IncompatibleRobot(SysidEvoError, ConnectionError):
    """A robot uses another version of the link's protocol."""


class ContractViolation(SysidEvoError, AssertionError):
    """An implementation violates the contract of its base class."""


class ArtefactError(SysidEvoError, ValueError):
    """A stored file is damaged, of another version, or of another kind."""


class Blocked(SysidEvoError, RuntimeError):
    """A step could not run because a step that it depends on failed."""


class PluginWarning(UserWarning):
    """A plugin was left out of a list because it cannot be loaded."""


class DataWarning(UserWarning):
    """A possible problem of a recording."""


class CheckpointWarning(UserWarning):
    """A checkpoint was ignored, because it is damaged or belongs to other work, or could not be written."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a hint for a ``name`` that is not ``known``: the closest one, "" if none is similar."""
    close = closest(name, known)
    return f" Did you mean {close!r}?" if close else ""


def closest(name: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """Return the ``known`` name that is most similar to ``name``, by at least ``cutoff`` (0 to 1), else ""."""
    return next(iter(difflib.get_close_matches(name, list(known), n=1, cutoff=cutoff)), "")


UNSEEN = {number: None for number in (*range(32), *range(127, 160), *range(0x202A, 0x202F), *range(0x2066, 0x206A))
          if chr(number) not in "\t\n"}  # fmt: skip
"""Characters that are not printed: control characters, which command terminals, and changes of the text direction."""


def printable(text: str) -> str:
    """Return ``text``, which may contain names from foreign files, made safe for a terminal."""
    return text.translate(UNSEEN)


def described(error: Exception) -> str:
    """Return class and message of an error, and the line of the plugin that caused it."""
    here = Path(__file__).parent  # this package and the harness are not plugins
    ours = (str(here.parent / name) for name in ("evaluation", "hardware", "model_zoo"))
    others = (str(here), *ours, *map(sysconfig.get_path, ("stdlib", "purelib")), "<")
    own = [frame for frame in traceback.extract_tb(error.__traceback__) if not frame.filename.startswith(others)]
    where = f" ({Path(own[-1].filename).name}, line {own[-1].lineno}: {own[-1].line})" if own else ""
    return f"{type(error).__name__}: {error}{where}"


@dataclass(frozen=True)
class Meaningless:
    """A rule: ``settings`` have no effect if all of ``when`` are given and none of ``unless`` is.

    Each name in ``when`` has a tuple of values to which the rule applies; an empty tuple means any value.
    """

    settings: tuple[str, ...]
    why: str
    when: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    unless: tuple[str, ...] = ()


def meaningless(
    rules: Iterable[Meaningless], given: Mapping[str, Any], among: Mapping[str, Any]
) -> dict[str, Meaningless]:
    """Return the settings ``given`` that have no effect ``among`` all, with their rule; empty values are unset."""
    set_names = {name for name, value in among.items() if value}
    holding = [
        rule
        for rule in rules
        if set_names.isdisjoint(rule.unless)
        and all(name in set_names and (not values or among[name] in values) for name, values in rule.when.items())
    ]
    return {name: rule for rule in holding for name in rule.settings if given.get(name)}


def as_setting(name: str, value: Any = None) -> str:
    """Return a setting as it is written in Python and TOML: ``stop_after = 'fit'``."""
    return f"{name} = {value!r}" if isinstance(value, str) else name


def refuse_meaningless(
    rules: Iterable[Meaningless],
    given: Mapping[str, Any],
    among: Mapping[str, Any],
    named: Callable[..., str] = as_setting,
) -> None:
    """Raise `InvalidArgument` for the first of the settings ``given`` that others ``among`` all make meaningless."""
    for name, rule in meaningless(rules, given, among).items():
        parts = [f"with {named(other, among[other] if values else None)}" for other, values in rule.when.items()]
        parts += [f"without {' or '.join(map(named, rule.unless))}"] if rule.unless else []
        remedy = "change that, or leave it out" if rule.unless else "leave one of them out"
        raise InvalidArgument(f"{named(name)} has no effect {' and '.join(parts)}: {rule.why}; {remedy}")
