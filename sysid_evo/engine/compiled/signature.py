"""The arguments of a compiled function, said once: its type for Numba, and the order in which it is called."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from enum import Enum
from typing import Any, TypeAlias

from sysid_evo.errors import InvalidArgument


class Kind(Enum):
    """What an argument is, in the words of a generated file: R, I and types."""

    REALS = "R"
    WHOLES = "I"
    NUMBER = "types.int64"


REALS, WHOLES, NUMBER = Kind.REALS, Kind.WHOLES, Kind.NUMBER


class Signature:
    """Named arguments in order, each a `Kind` or the signature of a function that is passed; nothing comes back.

    ``REALS`` is an array of the kernel's own precision, ``WHOLES`` one of int64, ``NUMBER`` an int64.
    """

    def __init__(self, **arguments: Argument) -> None:
        self.arguments = arguments

    @classmethod
    def of(cls, function: Callable[..., Any], **others: Argument) -> Signature:
        """Return that of ``function``, whose arguments are ``REALS`` except for the ``others``."""
        names = tuple(inspect.signature(function).parameters)
        unknown = [name for name in others if name not in names]
        if unknown:
            raise InvalidArgument(f"signature of {function.__qualname__}: no argument is called {', '.join(unknown)}")
        return cls(**{name: others.get(name, REALS) for name in names})

    def ordered(self, **given: Any) -> tuple[Any, ...]:
        """Return what is ``given`` by name in the order of the arguments. Raises `InvalidArgument` for other names."""
        if given.keys() != self.arguments.keys():
            missing = ", ".join(self.arguments.keys() - given.keys()) or "none"
            unknown = ", ".join(given.keys() - self.arguments.keys()) or "none"
            raise InvalidArgument(f"call of a kernel: missing arguments: {missing}; unknown ones: {unknown}")
        return tuple(given[name] for name in self.arguments)

    def check(self, function: Callable[..., Any]) -> None:
        """Raise `InvalidArgument` if ``function`` takes another number of arguments."""
        names = tuple(inspect.signature(function).parameters)
        if len(names) != len(self.arguments):
            raise InvalidArgument(
                f"kernel function {function.__module__}.{function.__qualname__}: expected {len(self.arguments)} "
                f"arguments ({', '.join(self.arguments)}), got {len(names)} ({', '.join(names)})"
            )

    def __str__(self) -> str:
        """Return the type as the text of a generated file."""
        kinds = [
            kind.value if isinstance(kind, Kind) else f"types.FunctionType({kind.of_pointers()})"
            for kind in self.arguments.values()
        ]
        return f"types.void({', '.join(kinds)})"

    def of_pointers(self) -> str:
        """Return the type as the text of a generated file, of a function that is passed: addresses of its arrays."""
        return f"types.void({', '.join(f'types.CPointer({kind}.dtype)' for kind in self._arrays())})"

    def _arrays(self) -> list[str]:
        others = [name for name, kind in self.arguments.items() if kind not in (Kind.REALS, Kind.WHOLES)]
        if others:
            raise InvalidArgument(f"a kernel that is passed takes arrays alone, got {', '.join(others)}")
        return [kind.value for kind in self.arguments.values() if isinstance(kind, Kind)]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Signature) and list(self.arguments.items()) == list(other.arguments.items())

    def __hash__(self) -> int:
        return hash(tuple(self.arguments.items()))


Argument: TypeAlias = Kind | Signature
